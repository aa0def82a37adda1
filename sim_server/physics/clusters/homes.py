"""Which cells there are, and who lives in each: what never moves in all, and the rest in one."""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.clusters.cells import Cells
from zensim.sim_server.physics.clusters.dealing import Room
from zensim.sim_server.physics.clusters.discs import IntArray
from zensim.sim_server.physics.clusters.members import EVERYWHERE, Members
from zensim.sim_server.physics.clusters.reach import Reach, moves
from zensim.sim_server.physics.clusters.routes import Lineup
from zensim.sim_server.physics.engine import (
    BodyStates,
    Engine,
    FloatArray,
    SupportsHiding,
    as_async,
    as_hiding,
)

READY_AT = 0.8
"""Of the bodies that one cell has before there are several: from then on workers start."""


class Homes:
    """Cells by number; the first is always there.

    Attributes:
        members: All bodies.
        engines: By number of the cell.
    """

    def __init__(self, cells: Cells, alone: int, room: Room) -> None:
        self._cells = cells
        self._alone = alone
        self._room = room
        self.members = Members()
        self._taken: Model | None = None
        self.engines: dict[int, Engine] = {0: cells.make()}

    @property
    def is_one(self) -> bool:
        """Whether there is no need for a second cell."""
        return len(self.engines) == 1 and self.members.moving_count <= self._alone

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`; who trusts others that took the model is not waited for."""
        is_taken = model is self._taken
        return all(
            (is_taken and as_async(engine) is not None) or engine.prepare(model)
            for engine in self.engines.values()
        )

    def add(self, model: Model, reach: Reach, base: FloatArray) -> int:
        """Make a body where it may live; raises EngineRefused."""
        if not moves(model):
            copies = {cell: engine.add(model, base) for cell, engine in self.engines.items()}
            number = self.members.admit(model, reach, cell=EVERYWHERE, inner=-1)
            self.members.by_number[number].copies = copies
            self.note_still(number)
            return number
        if self.members.moving_count > self._alone * READY_AT:
            self._cells.start()
        cell = self._cell_near(base)
        inner = self._trusting(cell, model).add(model, base)
        self._taken = model
        return self.members.admit(model, reach, cell=cell, inner=inner)

    def remove(self, body: int) -> None:
        """Take a body out of wherever it is."""
        for engine, inner in self.of(body):
            engine.remove(inner)
        self.members.dismiss(body)

    def hide(self, body: int) -> None:
        """Let a body wait; one whose engine cannot do that stands where it will be."""
        for engine, inner in self.of(body):
            if (hiding := as_hiding(engine)) is not None:
                hiding.hide(inner)
                self.members.show(body, is_concealed=True)

    def show(self, bodies: Iterable[int]) -> None:
        """Let bodies that wait take part."""
        homes: dict[int, tuple[SupportsHiding, list[int]]] = {}
        for body in bodies:
            for engine, inner in self.of(body) if body in self.members.concealed else ():
                if (waiting := as_hiding(engine)) is not None:
                    homes.setdefault(id(engine), (waiting, []))[1].append(inner)
            self.members.show(body, is_concealed=False)
        for waiting, inners in homes.values():
            waiting.show(inners)

    def read_apart(self, bodies: Iterable[int]) -> BodyStates:
        """Read bodies one by one: also those that are in no lineup."""
        each = [engine.read([inner]) for engine, inner in (self.of(body)[0] for body in bodies)]
        return BodyStates(
            np.concatenate([one.base for one in each]),
            np.concatenate([one.joint_positions for one in each]),
            np.concatenate([one.joint_velocities for one in each]),
        )

    def of(self, body: int) -> Sequence[tuple[Engine, int]]:
        """List the engines that have a body, and its number there."""
        if copies := self.members.by_number[body].copies:
            return [(self.engines[cell], inner) for cell, inner in copies.items()]
        cell, inner = int(self.members.cell[body]), int(self.members.inner[body])
        return [(self.engines[cell], inner)]

    def note_still(self, body: int) -> None:
        """Remember where something that never moves is."""
        engine, inner = self.of(body)[0]
        self.members.by_number[body].base = engine.read([inner]).base[0]
        self.members.version += 1

    def engine(self, cell: int) -> Engine:
        """Find the engine of a cell; a new one gets all that never moves."""
        if (known := self.engines.get(cell)) is not None:
            return known
        made = self.engines[cell] = self._cells.make()
        for member in self.members.by_number.values():
            if member.base is not None:
                member.copies[cell] = made.add(member.model, member.base)
        return made

    def find_overlaps(self, body: int) -> list[int]:
        """Name the other bodies that a body reaches into, in the cells where it is."""
        members = self.members
        homes = members.by_number[body].copies or {int(members.cell[body]): members.inner[body]}
        found: set[int] = set()
        for cell, inner in homes.items():
            found.update(self._numbers(cell, set(self.engines[cell].find_overlaps(int(inner)))))
        return sorted(found)

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Patient.overlapping_soon`."""
        cell, inner = int(self.members.cell[body]), int(self.members.inner[body])
        if cell < 0 or (engine := as_async(self.engines[cell])) is None:
            found = self.find_overlaps(body)
            return lambda: found
        soon = engine.find_overlaps_async(inner)
        return lambda: sorted(self._numbers(cell, set(soon())))

    def is_idle(self) -> bool:
        """See `Patient.is_settled`."""
        waiting = [as_async(engine) for engine in self.engines.values()]
        return all(engine is None or engine.is_idle() for engine in waiting)

    def move(self, lineup: Lineup, now: BodyStates, cells: IntArray) -> bool:
        """Move bodies that are to be in other cells, as they are now.

        Args:
            lineup: All that moves.
            now: The reading of it.
            cells: (n,) where each is to be.

        Returns:
            Whether anybody moved.
        """
        members = self.members
        rows = np.flatnonzero(cells != members.cell[lineup.numbers]).tolist()
        for row in rows:
            number, cell = int(lineup.numbers[row]), int(cells[row])
            joints = slice(lineup.joint_start[row], lineup.joint_start[row + 1])
            self.engines[int(members.cell[number])].remove(int(members.inner[number]))
            engine = self._trusting(cell, members.by_number[number].model)
            inner = engine.add(members.by_number[number].model, now.base[row])
            positions, velocities = now.joint_positions[joints], now.joint_velocities[joints]
            engine.put(inner, now.base[row], positions, velocities)
            members.move(number, cell=cell, inner=inner)
        return bool(rows)

    def forget_removed(self) -> None:
        """Make cells that nobody is in anew when they are needed again."""
        members = self.members
        lived_in = set(members.cell[members.moving].tolist())
        for cell in [cell for cell in self.engines if cell and cell not in lived_in]:
            self._cells.end(self.engines.pop(cell))
            for member in members.by_number.values():
                member.copies.pop(cell, None)
        for engine in self.engines.values():
            engine.forget_removed()
        members.forget_gone()

    def close(self) -> None:
        """Close all cells."""
        for engine in self.engines.values():
            engine.close()
        self._cells.close()

    def _trusting(self, cell: int, model: Model) -> Engine:
        """Find the engine of a cell; it knows whether others have taken a model."""
        engine = self.engine(cell)
        if model is self._taken and (trusting := as_async(engine)) is not None:
            trusting.skip_validation(model)
        return engine

    def _cell_near(self, base: FloatArray) -> int:
        """Find a cell with room for a new body: the one where its nearest fellow is."""
        if len(self.engines) == 1 and self.members.moving_count < self._alone:
            return 0
        moving = self.members.moving
        cells = self.members.cell[moving]
        counts = np.bincount(cells, minlength=1)
        has_room = counts[cells] < self._room.of(len(moving))
        if not has_room.any():
            return int(np.append(counts, 0).argmin())
        apart = np.linalg.norm(self.members.place[moving] - base[:2], axis=1)
        return int(cells[np.where(has_room, apart, np.inf).argmin()])

    def _numbers(self, cell: int, inner: set[int]) -> Iterator[int]:
        """Find whom a cell means."""
        if not inner:
            return
        members = self.members
        for number in np.flatnonzero(members.cell == cell).tolist():
            if int(members.inner[number]) in inner:
                yield number
        for number, member in members.by_number.items():
            if member.copies.get(cell) in inner:
                yield number
