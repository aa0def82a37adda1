"""The Engine over many cells: regroups bodies, moves them between cells, forwards calls."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.body_reach import BodyReach, ReachCache, can_move
from zensim.sim_server.physics.cells.cell_assignment import (
    CELL_GAP_M,
    SPEED_MARGIN_MPS,
    CellCapacity,
    InteractionGroups,
    assign_cells,
    find_interaction_groups,
)
from zensim.sim_server.physics.cells.cell_body_table import (
    ALL_CELLS,
    CellBodyOrder,
    CellBodyTable,
    CellIndexMap,
    concatenate_readings,
    make_body_order,
    make_index_map,
)
from zensim.sim_server.physics.cells.cell_executor import CellExecutor, CellReadRequest, CellTargets
from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.scene.broad_phase import IntArray

WORKER_START_RATIO = 0.8
"""Of the bodies that one cell has before there are several: from then on workers start."""


class CellMap:
    """Cells by number; the first is always there.

    Attributes:
        members: All bodies.
        engines: By number of the cell.
    """

    def __init__(self, cells: CellExecutor, alone: int, room: CellCapacity) -> None:
        self._cells = cells
        self._alone = alone
        self._capacity = room
        self.members = CellBodyTable()
        self._taken: Model | None = None
        self.engines: dict[int, Engine] = {0: cells.make()}

    @property
    def is_single_cell(self) -> bool:
        """Whether there is no need for a second cell."""
        return len(self.engines) == 1 and self.members.moving_count <= self._alone

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`; who trusts others that took the model is not waited for."""
        is_taken = model is self._taken
        return all(
            (is_taken and engine.capabilities.is_remote) or engine.prepare(model)
            for engine in self.engines.values()
        )

    def add(self, model: Model, reach: BodyReach, base: FloatArray) -> int:
        """Make a body where it may live; raises EngineRefused."""
        if not can_move(model):
            copies = {cell: engine.add(model, base) for cell, engine in self.engines.items()}
            number = self.members.add(model, reach, cell=ALL_CELLS, inner=-1)
            self.members.by_number[number].copies = copies
            self.record_static(number)
            return number
        if self.members.moving_count > self._alone * WORKER_START_RATIO:
            self._cells.start()
        cell = self._find_nearest_cell(base)
        inner = self._find_accepting_engine(cell, model).add(model, base)
        self._taken = model
        return self.members.add(model, reach, cell=cell, inner=inner)

    def remove(self, body: int) -> None:
        """Take a body out of wherever it is."""
        for engine, inner in self.locate(body):
            engine.remove(inner)
        self.members.remove(body)

    def hide(self, body: int) -> None:
        """Let a body wait; one whose engine cannot do that stands where it will be."""
        for engine, inner in self.locate(body):
            if engine.capabilities.hides:
                engine.hide(inner)
                self.members.set_concealed(body, is_concealed=True)

    def show(self, bodies: Iterable[int]) -> None:
        """Let bodies that wait take part."""
        hidden: dict[int, tuple[Engine, list[int]]] = {}
        for body in bodies:
            for engine, inner in self.locate(body) if body in self.members.concealed else ():
                hidden.setdefault(id(engine), (engine, []))[1].append(inner)
            self.members.set_concealed(body, is_concealed=False)
        for engine, inners in hidden.values():
            engine.show(inners)

    def read_each(self, bodies: Iterable[int]) -> BodyStates:
        """Read bodies one by one: also those that are in no lineup."""
        each = [engine.read([inner]) for engine, inner in (self.locate(body)[0] for body in bodies)]
        return BodyStates(
            np.concatenate([one.base for one in each]),
            np.concatenate([one.joint_positions for one in each]),
            np.concatenate([one.joint_velocities for one in each]),
        )

    def locate(self, body: int) -> Sequence[tuple[Engine, int]]:
        """List the engines that have a body, and its number there."""
        if copies := self.members.by_number[body].copies:
            return [(self.engines[cell], inner) for cell, inner in copies.items()]
        cell, inner = int(self.members.cell[body]), int(self.members.inner[body])
        return [(self.engines[cell], inner)]

    def record_static(self, body: int) -> None:
        """Remember where something that never moves is."""
        engine, inner = self.locate(body)[0]
        self.members.by_number[body].base = engine.read([inner]).base[0]
        self.members.version += 1

    def get_engine(self, cell: int) -> Engine:
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
            found.update(
                self._to_body_numbers(cell, set(self.engines[cell].find_overlaps(int(inner))))
            )
        return sorted(found)

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Engine.find_overlaps_async`."""
        cell, inner = int(self.members.cell[body]), int(self.members.inner[body])
        if cell < 0:
            found = self.find_overlaps(body)
            return lambda: found
        wait = self.engines[cell].find_overlaps_async(inner)
        return lambda: sorted(self._to_body_numbers(cell, set(wait())))

    def is_idle(self) -> bool:
        """See `Engine.is_idle`."""
        return all(engine.is_idle() for engine in self.engines.values())

    def move(self, lineup: CellBodyOrder, now: BodyStates, cells: IntArray) -> bool:
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
            engine = self._find_accepting_engine(cell, members.by_number[number].model)
            inner = engine.add(members.by_number[number].model, now.base[row])
            positions, velocities = now.joint_positions[joints], now.joint_velocities[joints]
            engine.set_state(inner, now.base[row], positions, velocities)
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
        members.reset_numbering()

    def close(self) -> None:
        """Close all cells."""
        for engine in self.engines.values():
            engine.close()
        self._cells.close()

    def _find_accepting_engine(self, cell: int, model: Model) -> Engine:
        """Find the engine of a cell; it knows whether others have taken a model."""
        engine = self.get_engine(cell)
        if model is self._taken:
            engine.skip_validation(model)
        return engine

    def _find_nearest_cell(self, base: FloatArray) -> int:
        """Find a cell with room for a new body: the one where its nearest fellow is."""
        if len(self.engines) == 1 and self.members.moving_count < self._alone:
            return 0
        moving = self.members.moving
        cells = self.members.cell[moving]
        counts = np.bincount(cells, minlength=1)
        has_room = counts[cells] < self._capacity.max_bodies(len(moving))
        if not has_room.any():
            return int(np.append(counts, 0).argmin())
        apart = np.linalg.norm(self.members.place[moving] - base[:2], axis=1)
        return int(cells[np.where(has_room, apart, np.inf).argmin()])

    def _to_body_numbers(self, cell: int, inner: set[int]) -> Iterator[int]:
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


LOOKAHEAD_PERIODS = (4, 2, 1)
"""How many periods to the next look: the first for which no group is too large for a cell."""
ALERT_S = 1.0
"""How long every step is looked at, once somebody was faster than thought."""
MAX_CACHED_INDEX_MAPS = 256
MIN_DIVISOR = 1e-3
"""Of a mass [kg] or a radius [m] that something is divided by."""


class QueuedLoad(NamedTuple):
    """A wrench on a link, or an effort on a joint, in the next step."""

    body: int
    where: int
    what: FloatArray | float


@dataclass(frozen=True)
class CellSettings:
    """How a world is cut into cells.

    Attributes:
        alone: So many moving bodies at most stay in one cell.
        most: Bodies of a cell, once there are several.
        period_steps: The least time between two looks, while nobody is too fast.
        largest: Bodies of a cell of a large world.
        at_once: Bodies that leave a cell that is too full in one look.
    """

    alone: int = 150
    most: int = 64
    period_steps: int = 1
    at_once: int = 8
    largest: int = 0


class CelledEngine(Engine):
    """Engines as one."""

    def __init__(self, config: EngineConfig, cells: CellExecutor, settings: CellSettings) -> None:
        self._cells = cells
        self._settings = settings
        self._room = CellCapacity(settings.most, settings.at_once, settings.largest)
        self._dt_s = config.step_ns * 1e-9
        self._ahead_s = settings.period_steps * LOOKAHEAD_PERIODS[0] * self._dt_s
        self._speed_margin_mps = (
            SPEED_MARGIN_MPS + float(np.linalg.norm(config.gravity)) * self._ahead_s
        )
        self._measure = ReachCache(config.mesh_folder)
        self._cell_map = CellMap(cells, settings.alone, self._room)
        self.capabilities = replace(self._cell_map.engines[0].capabilities, sleeps=False)
        self._members = self._cell_map.members
        self._pushes: list[QueuedLoad] = []
        self._body_order: tuple[int, CellBodyOrder] | None = None
        self._routes: dict[int, tuple[Sequence[int], int, CellIndexMap]] = {}
        self._now: BodyStates | None = None
        self._steps = self._last_regroup = self._next_regroup = self._alert_until = 0
        self._is_due = self._was_due = self._is_bad = self._has_new_targets = False

    @property
    def name(self) -> str:
        """See `Engine.name`."""
        return self._cell_map.engines[0].name

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`: a part for one of the cells, or a mesh is measured."""
        return self._cell_map.prepare(model) and self._measure.prepare(model)

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`."""
        number = self._cell_map.add(model, self._measure.measure(model), base)
        self._was_due = self._is_due
        self._record_place(number, base)
        return number

    def hide(self, body: int) -> None:
        """See `Engine.hide`; who takes no part is looked at by nobody."""
        self._cell_map.hide(body)
        if body in self._members.concealed:
            self._is_due = self._was_due

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        self._cell_map.show(bodies)
        self._now, self._is_due = None, True

    def remove(self, body: int) -> None:
        """See `Engine.remove`."""
        self._pushes = [push for push in self._pushes if push.body != body]
        self._cell_map.remove(body)
        self._now = None

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._cell_map.forget_removed()
        self._steps = self._last_regroup = self._next_regroup = self._alert_until = 0
        self._is_due = True

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`."""
        return self.find_overlaps_async(body)()

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Engine.find_overlaps_async`."""
        if not self._cell_map.is_single_cell and self._may_touch_other_cells(body):
            self._regroup()
        return self._cell_map.find_overlaps_async(body)

    def is_idle(self) -> bool:
        """See `Engine.is_idle`."""
        return self._cell_map.is_idle()

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`."""
        if not self._members.concealed.isdisjoint(bodies):
            return self._cell_map.read_each(bodies)
        if self._cell_map.is_single_cell:
            return self._cell_map.engines[0].read(self._index_map(bodies).alone)
        return self._index_map(bodies).select(self._read_moving())

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`."""
        for engine, inner in self._cell_map.locate(body):
            engine.set_base_state(inner, base)
        self._record_place(body, base)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`."""
        for engine, inner in self._cell_map.locate(body):
            engine.set_at_rest(inner, base, positions)
        self._members.forget_targets(body)
        self._record_place(body, base)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        for engine, inner in self._cell_map.locate(body):
            engine.set_state(inner, base, positions, velocities)
        self._record_place(body, base)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`: cells are told before the next step, all at once."""
        members, route = self._members, self._index_map(bodies)
        if not len(route.driven):
            return
        members.targets[route.targets] = targets
        members.told[route.driven] = True
        if self._cell_map.is_single_cell:
            self._cell_map.engines[0].command(route.alone, targets)
            return
        members.is_due[route.driven] = self._has_new_targets = True
        speeds = np.abs(targets) * members.levers[route.targets]
        asked = np.maximum.reduceat(speeds, route.starts)
        self._is_due |= bool((asked > members.bound[route.driven]).any())

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`: cells are told before the next step."""
        self._bound_push_speed(
            body, float(np.abs(wrench[:3]).sum()), float(np.abs(wrench[3:]).sum())
        )
        self._pushes.append(QueuedLoad(body, link, wrench.copy()))

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`: likewise."""
        self._bound_push_speed(body, abs(effort), abs(effort))
        self._pushes.append(QueuedLoad(body, joint, effort))

    def step(self) -> bool:
        """See `Engine.step`."""
        if not self._cell_map.is_single_cell and (
            self._is_due or self._steps >= self._next_regroup
        ):
            self._regroup()
        if self._has_new_targets:
            self._send_targets()
        if self._pushes:
            self._apply_loads()
        is_well = self._advance()
        self._steps += 1
        self._now = None
        return is_well

    def close(self) -> None:
        """See `Engine.close`."""
        self._cell_map.close()

    def _advance(self) -> bool:
        engines = self._cell_map.engines
        if self._cell_map.is_single_cell:
            return engines[0].step()
        is_well = self._cells.step([engines[cell] for cell in self._current_order().cells], 1)
        is_well, self._is_bad = is_well and not self._is_bad, False
        return is_well

    def _may_touch_other_cells(self, body: int) -> bool:
        """Whether a body may touch one that is in another cell."""
        members, moving = self._members, self._members.moving
        if members.cell[body] == ALL_CELLS:
            return False
        others = moving[members.cell[moving] != members.cell[body]]
        elapsed_s = (self._steps - self._last_regroup) * self._dt_s
        radii = members.radius + members.bound * elapsed_s + CELL_GAP_M
        apart = np.linalg.norm(members.place[others] - members.place[body], axis=1)
        return bool((apart <= radii[others] + radii[body]).any())

    def _record_place(self, body: int, base: FloatArray) -> None:
        if self._members.cell[body] == ALL_CELLS:
            self._cell_map.record_static(body)
        self._members.place[body] = base[:2]
        self._now, self._is_due = None, True

    def _bound_push_speed(self, body: int, force: float, torque: float) -> None:
        """Bound the speed that a push gives a body; a torque pushes at its rim."""
        members = self._members
        rim, mass = members.radius[body], members.by_number[body].model.mass_kg
        gained = (force + torque / max(rim, MIN_DIVISOR)) / max(mass, MIN_DIVISOR) * self._dt_s
        members.kick[body] += gained
        self._is_due |= bool(members.kick[body] > SPEED_MARGIN_MPS / 4.0)

    def _current_order(self) -> CellBodyOrder:
        if self._body_order is None or self._body_order[0] != self._members.version:
            self._body_order = (self._members.version, make_body_order(self._members))
        return self._body_order[1]

    def _index_map(self, bodies: Sequence[int]) -> CellIndexMap:
        version = self._members.version
        known = self._routes.get(id(bodies))
        if known is not None and known[0] is bodies and known[1] == version:
            return known[2]
        route = make_index_map(bodies, self._members, self._current_order())
        if isinstance(bodies, tuple):  # else its content may change
            if len(self._routes) >= MAX_CACHED_INDEX_MAPS:
                self._routes.clear()
            self._routes[id(bodies)] = (bodies, version, route)
        return route

    def _read_moving(self) -> BodyStates:
        """Read all that moves, once a step at most."""
        if self._now is None:
            lineup, engines = self._current_order(), self._cell_map.engines
            homes = zip(lineup.cells, lineup.bodies, strict=True)
            self._now = concatenate_readings(
                self._cells.read([CellReadRequest(engines[cell], b) for cell, b in homes])
            )
        return self._now

    def _regroup(self) -> None:
        """Put bodies that may touch before the next look into one cell."""
        lineup, now, members = self._current_order(), self._read_moving(), self._members
        numbers, places = lineup.numbers, now.base[:, :2]
        self._check_speed_bounds(places - members.place[numbers], members.bound[numbers])
        parting = self._find_groups(lineup, now)
        members.place[numbers], members.bound[numbers] = places, parting.speeds
        members.kick[numbers] = 0.0
        is_good = np.asarray(np.isfinite(now.base).all(axis=1))
        self._is_bad |= not is_good.all()
        before = members.cell[numbers]
        after = assign_cells(
            before, parting.groups, np.where(is_good[:, None], places, 0.0), self._room
        )
        if self._cell_map.move(lineup, now, np.where(is_good, after, before)):
            self._now, self._has_new_targets = None, True
        self._last_regroup, self._is_due = self._steps, False
        period = self._settings.period_steps
        self._next_regroup = (self._steps // period + parting.periods) * period
        if self._steps < self._alert_until:
            self._next_regroup = self._steps + 1

    def _check_speed_bounds(self, moved: FloatArray, bounds: FloatArray) -> None:
        """Look at every step for a while when somebody went farther than was thought."""
        elapsed_s = (self._steps - self._last_regroup) * self._dt_s
        with np.errstate(invalid="ignore", over="ignore"):
            beyond = np.linalg.norm(moved, axis=1) - bounds * elapsed_s
        if (beyond > CELL_GAP_M / 2.0).any():
            self._alert_until = self._steps + round(ALERT_S / self._dt_s)

    def _find_groups(self, lineup: CellBodyOrder, now: BodyStates) -> InteractionGroups:
        members, numbers = self._members, lineup.numbers
        radii = members.radius[numbers] = self._radii(lineup, now)
        velocity = now.base[:, 7:]
        with np.errstate(invalid="ignore", over="ignore"):
            linear = np.linalg.norm(velocity[:, :3], axis=1)
            own = linear + np.linalg.norm(velocity[:, 3:], axis=1) * members.arm[numbers]
        asked = np.zeros(len(numbers))
        if len(lineup.driven):
            told = np.abs(members.targets[lineup.targets]) * members.levers[lineup.targets]
            asked[lineup.driven] = np.maximum.reduceat(told, lineup.target_starts)
        speeds = np.maximum(own, asked) + members.kick[numbers] + self._speed_margin_mps
        period_s = self._settings.period_steps * self._dt_s
        choices = LOOKAHEAD_PERIODS[-1:] if self._steps < self._alert_until else LOOKAHEAD_PERIODS
        for periods in choices:
            found = find_interaction_groups(
                now.base[:, :2], radii, speeds, period_s, periods=periods
            )
            if found.largest <= self._room.max_bodies(len(numbers)):
                break
        return found

    def _radii(self, lineup: CellBodyOrder, now: BodyStates) -> FloatArray:
        """Find how far each body reaches, with what slides where it is and will be."""
        radii = self._members.rigid_m[lineup.numbers]
        rows, joints = lineup.slides
        ahead = np.abs(now.joint_velocities[joints]) * self._ahead_s
        np.add.at(radii, rows, np.abs(now.joint_positions[joints]) + ahead)
        return radii

    def _send_targets(self) -> None:
        """Tell cells the targets of their bodies."""
        self._cells.command(list(self._list_pending_targets()))
        self._members.is_due[:] = self._has_new_targets = False

    def _apply_loads(self) -> None:
        """Push what is to be pushed in this step."""
        for body, where, push in self._pushes:
            for engine, inner in self._cell_map.locate(body):
                if isinstance(push, float):
                    engine.apply_joint_effort(inner, where, push)
                else:
                    engine.apply_link_wrench(inner, where, push)
        self._pushes.clear()

    def _list_pending_targets(self) -> Iterator[CellTargets]:
        lineup, members, engines = self._current_order(), self._members, self._cell_map.engines
        is_due = members.is_due[lineup.numbers]
        if is_due[lineup.driven].all():
            ends = lineup.cell_targets.tolist()
            for cell, bodies, at, end in zip(
                lineup.cells, lineup.bodies, ends, ends[1:], strict=False
            ):
                if at < end:
                    yield CellTargets(
                        engines[cell], bodies, members.targets[lineup.targets[at:end]]
                    )
            return
        due = np.flatnonzero(is_due)
        cells = members.cell[lineup.numbers[due]]
        for cell in np.unique(cells).tolist():
            numbers = lineup.numbers[due[cells == cell]]
            targets = [members.targets[members.by_number[n].targets] for n in numbers.tolist()]
            bodies = tuple(members.inner[numbers].tolist())
            yield CellTargets(engines[cell], bodies, np.concatenate(targets))
