"""Which body is in which cell, and when that is looked at again."""

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.body_reach import BodyReach
from zensim.sim_server.physics.cells.cell_assignment import CellCapacity
from zensim.sim_server.physics.cells.cell_bodies import ALL_CELLS, CellBodyOrder, CellBodyTable
from zensim.sim_server.physics.cells.cell_executor import CellExecutor
from zensim.sim_server.physics.engine import (
    BodyStates,
    Engine,
    EngineRefused,
    FloatArray,
    Place,
    can_move,
)
from zensim.sim_server.scene.broad_phase import IntArray

LOG = logging.getLogger(__name__)
CELL_START_RATIO = 0.8
"""Share of the bodies that the cells hold at which one more is prepared."""


class ExpectedBody(NamedTuple):
    """A body that is announced, and its future cell."""

    model: Model
    place: Place
    cell: int


@dataclass(frozen=True)
class PlannedCells:
    """The cells of the expected bodies of a model, by their place."""

    model: Model
    """Model of the cells; kept, as another one must not get its identity."""
    by_place: dict[Place, int] = field(default_factory=dict)


class CellMap:
    """Engines by number of their cell, and the bodies in them; cell 0 always exists."""

    def __init__(
        self, cells: CellExecutor, single_cell_bodies: int, capacity: CellCapacity
    ) -> None:
        self._cells = cells
        self._single_cell_bodies = single_cell_bodies
        self._capacity = capacity
        self.members = CellBodyTable()
        self._accepted: Model | None = None
        self._stuck: set[int] = set()
        """Bodies that another cell refused."""
        self._planned: dict[int, PlannedCells] = {}
        """Planned cells by the identity of the model of the expected bodies."""
        self.engines: dict[int, Engine] = {0: cells.make()}

    @property
    def is_single_cell(self) -> bool:
        """Whether one cell is enough."""
        return len(self.engines) == 1 and self.members.moving_count <= self._single_cell_bodies

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`; remote engines skip a model that another engine has accepted."""
        is_accepted = model is self._accepted
        return all(
            (is_accepted and engine.capabilities.is_remote) or engine.prepare(model)
            for engine in self._list_receivers(model)
        )

    def _list_receivers(self, model: Model) -> list[Engine]:
        """List the engines that may get a body of a model: a full cell gets no more that move."""
        if planned := self._planned.get(id(model)):
            return [self.engines[cell] for cell in dict.fromkeys(planned.by_place.values())]
        if not can_move(model) or self._has_room_in_single_cell:
            return list(self.engines.values())
        moving = self.members.moving
        counts = np.bincount(self.members.cell[moving], minlength=max(self.engines) + 1)
        most = self._capacity.max_bodies(len(moving))
        return [engine for cell, engine in self.engines.items() if counts[cell] < most]

    @property
    def _has_room_in_single_cell(self) -> bool:
        """Whether there is one cell, and it gets the next body."""
        return len(self.engines) == 1 and self.members.moving_count < self._single_cell_bodies

    @property
    def _held_bodies(self) -> int:
        """Moving bodies for which the cells have room."""
        if len(self.engines) == 1:
            return self._single_cell_bodies
        return len(self.engines) * self._capacity.max_bodies(self.members.moving_count)

    def fits_single_cell(self, models: Sequence[Model]) -> bool:
        """Whether one cell is enough when bodies of some models come."""
        moving = sum(map(can_move, models))
        is_enough = self.members.moving_count + moving <= self._single_cell_bodies
        return len(self.engines) == 1 and is_enough

    def expect(self, models: Sequence[Model]) -> None:
        """See `Engine.expect`; which of many cells gets a body that moves shows when it comes."""
        self._planned.clear()
        is_fit = self.fits_single_cell(models)
        expected = models if is_fit else [model for model in models if not can_move(model)]
        for engine in self.engines.values():
            engine.expect(expected)

    def plan(self, models: Sequence[Model], expected: Sequence[ExpectedBody]) -> None:
        """Make the cells of the bodies that come next.

        Args:
            models: Of those that cannot move.
            expected: Those that move.

        Raises:
            EngineRefused: A cell cannot be made.
        """
        by_cell: dict[int, list[Model]] = {}
        for body in expected:
            by_cell.setdefault(body.cell, []).append(body.model)
        for cell, own in by_cell.items():
            self.get_engine(cell).expect([*models, *own])
        for body in expected:
            if id(body.model) not in self._planned:
                self._planned[id(body.model)] = PlannedCells(body.model)
            self._planned[id(body.model)].by_place.setdefault(body.place, body.cell)

    def insert(self, body: int, model: Model, reach: BodyReach, base: FloatArray) -> None:
        """Add a body: one that cannot move to all cells, any other to one; raises EngineRefused."""
        if not can_move(model):
            self._insert_in_all(body, model, base)
            self.members.add(body, model, reach, cell=ALL_CELLS)
            self.record_static(body)
            return
        if self.members.moving_count > self._held_bodies * CELL_START_RATIO:
            self._cells.start()
        cell = self._find_planned_cell(model, base)
        if cell is None:
            cell = self._find_nearest_cell(base)
        self._find_accepting_engine(cell, model).insert(body, model, base)
        self._accepted = model
        self.members.add(body, model, reach, cell=cell)

    def discard(self, body: int) -> None:
        """Remove a body from all its cells."""
        for engine in self.locate(body):
            engine.discard(body)
        self.members.remove(body)
        self._stuck.discard(body)

    def group_by_cell(self, bodies: Iterable[int]) -> Sequence[tuple[Engine, list[int]]]:
        """Group bodies by engine; what cannot move is in each."""
        by_cell: dict[int, list[int]] = {}
        for body in bodies:
            cell = int(self.members.cell[body])
            for one in self.engines if cell == ALL_CELLS else (cell,):
                by_cell.setdefault(one, []).append(body)
        return [(self.engines[cell], own) for cell, own in by_cell.items()]

    def locate(self, body: int) -> Sequence[Engine]:
        """List the engines that contain a body."""
        return [engine for engine, _ in self.group_by_cell([body])]

    def record_static(self, body: int) -> None:
        """Store the state of a body that cannot move."""
        self.members.by_number[body].base = self.locate(body)[0].read([body]).base[0]
        self.members.version += 1

    def get_engine(self, cell: int) -> Engine:
        """Find or make the engine of a cell; a new one gets all bodies that cannot move.

        Raises:
            EngineRefused: One of these bodies cannot be made again; there is no new cell.
        """
        if (known := self.engines.get(cell)) is not None:
            return known
        engine = self._cells.make()
        statics = [one for one in self.members.by_number.items() if one[1].base is not None]
        engine.expect([one.model for _, one in statics])
        try:
            for body, one in statics:
                if one.base is not None:
                    engine.insert(body, one.model, one.base)
        except EngineRefused:
            self._cells.end(engine)
            raise
        self.engines[cell] = engine
        return engine

    def move(self, order: CellBodyOrder, states: BodyStates, cells: IntArray) -> bool:
        """Move bodies to other cells with their current states.

        Args:
            order: The n bodies that move.
            states: Their states.
            cells: (n,) the cell of each.

        Returns:
            Whether any body changed its cell.
        """
        members = self.members
        rows = np.flatnonzero(cells != members.cell[order.numbers]).tolist()
        arriving = self._list_arriving(order.numbers[rows], cells[rows])
        for row in rows:
            number, cell = int(order.numbers[row]), int(cells[row])
            joints = slice(order.joint_start[row], order.joint_start[row + 1])
            try:
                engine = self._find_accepting_engine(cell, members.by_number[number].model)
                if cell in arriving:
                    engine.expect(arriving.pop(cell))
                engine.insert(number, members.by_number[number].model, states.base[row])
            except EngineRefused as refused:
                self._report_stuck(number, refused)
                continue
            self.engines[int(members.cell[number])].discard(number)
            positions, velocities = states.joint_positions[joints], states.joint_velocities[joints]
            engine.set_state(number, states.base[row], positions, velocities)
            members.move(number, cell=cell)
            self._stuck.discard(number)
        return bool(rows)

    def forget_removed(self) -> None:
        """Close cells without moving bodies."""
        members = self.members
        occupied = set(members.cell[members.moving].tolist())
        for cell in [cell for cell in self.engines if cell and cell not in occupied]:
            self._cells.end(self.engines.pop(cell))
        for engine in self.engines.values():
            engine.forget_removed()

    def _insert_in_all(self, body: int, model: Model, base: FloatArray) -> None:
        """Add a body that cannot move to each cell, or to none; raises EngineRefused."""
        having: list[Engine] = []
        try:
            for engine in self.engines.values():
                engine.insert(body, model, base)
                having.append(engine)
        except EngineRefused:
            for engine in having:
                engine.discard(body)
            raise

    def _list_arriving(self, numbers: IntArray, cells: IntArray) -> dict[int, list[Model]]:
        """List the models of bodies that come to each cell."""
        arriving: dict[int, list[Model]] = {}
        for number, cell in zip(numbers.tolist(), cells.tolist(), strict=True):
            arriving.setdefault(cell, []).append(self.members.by_number[number].model)
        return arriving

    def _report_stuck(self, number: int, refused: EngineRefused) -> None:
        """Log once that a body stays in its cell, where it does not touch those of the other."""
        if number not in self._stuck:
            self._stuck.add(number)
            LOG.warning("body stays in its cell body=%d reason=%s", number, refused)

    def _find_accepting_engine(self, cell: int, model: Model) -> Engine:
        """Find the engine of a cell; it skips validation of a model that another has accepted."""
        engine = self.get_engine(cell)
        if model is self._accepted:
            engine.skip_validation(model)
        return engine

    def _find_planned_cell(self, model: Model, base: FloatArray) -> int | None:
        planned = self._planned.get(id(model))
        return None if planned is None else planned.by_place.get((float(base[0]), float(base[1])))

    def _find_nearest_cell(self, base: FloatArray) -> int:
        """Find the cell with free capacity whose body is nearest; else the emptiest cell."""
        if self._has_room_in_single_cell:
            return 0
        cells = self.members.cell
        counts = np.bincount(cells[cells >= 0], minlength=1)
        has_room = counts < self._capacity.max_bodies(int(counts.sum()))
        if not (has_room & (counts > 0)).any():
            return int(np.append(counts, 0).argmin())
        # Bodies without a cell, and those of all cells, have the numbers -2 and -1.
        is_choice = np.append(has_room, (False, False))[cells]
        square = self.members.find_square_distances(base[:2])
        return int(cells[np.where(is_choice, square, np.inf).argmin()])
