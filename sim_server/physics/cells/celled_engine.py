"""The Engine over many cells: regroup bodies, move them between cells, forward calls."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.body_reach import ReachCache
from zensim.sim_server.physics.cells.cell_assignment import (
    CELL_GAP_M,
    SPEED_MARGIN_MPS,
    CellCapacity,
    InteractionGroups,
    assign_cells,
    find_interaction_groups,
)
from zensim.sim_server.physics.cells.cell_bodies import (
    ALL_CELLS,
    NO_CELL,
    CellBodyOrder,
    CellIndexMap,
    make_body_order,
    make_index_map,
)
from zensim.sim_server.physics.cells.cell_executor import CellExecutor, CellReadRequest, CellTargets
from zensim.sim_server.physics.cells.cell_map import CellMap, ExpectedBody
from zensim.sim_server.physics.engine import (
    BodyStates,
    ContactPoints,
    Engine,
    EngineRefused,
    EngineReplicas,
    FloatArray,
    Place,
    can_move,
    concatenate_contacts,
    concatenate_states,
    refuse_faults,
)
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges

LOOKAHEAD_PERIODS = (4, 2, 1)
"""Periods until the next regrouping: the first for which all groups fit into cells."""
ALERT_S = 1.0
"""Simulation time of regrouping at each step, after a body exceeded its speed bound."""
MAX_CACHED_INDEX_MAPS = 256
MIN_DIVISOR = 1e-3
"""Least mass [kg] or radius [m] as a divisor."""


class QueuedLoad(NamedTuple):
    """A wrench (6,) or an effort on a part, the number of a link or a joint, for the next step."""

    body: int
    part: int
    load: FloatArray | float


@dataclass(frozen=True)
class CellSettings:
    """How a world is divided into cells.

    Attributes:
        single_cell_bodies: Up to so many moving bodies stay in one cell.
        cell_bodies: Maximum bodies of a cell, once there are several.
        period_steps: Least steps between two regroupings.
        moved_bodies: Maximum bodies that leave an overfull cell in one regrouping.
        large_cell_bodies: Maximum bodies of a cell of a large world; see `CellCapacity`.
    """

    single_cell_bodies: int = 150
    cell_bodies: int = 64
    period_steps: int = 1
    moved_bodies: int = 8
    large_cell_bodies: int = 0


class CelledEngine(Engine):
    """One engine made of many: bodies that may touch soon are in the same cell."""

    def __init__(self, config: EngineConfig, cells: CellExecutor, settings: CellSettings) -> None:
        self._cells = cells
        self._settings = settings
        self._capacity = CellCapacity(
            settings.cell_bodies, settings.moved_bodies, settings.large_cell_bodies
        )
        self._dt_s = config.step_ns * 1e-9
        self._ahead_s = settings.period_steps * LOOKAHEAD_PERIODS[0] * self._dt_s
        self._speed_margin_mps = (
            SPEED_MARGIN_MPS + float(np.linalg.norm(config.gravity)) * self._ahead_s
        )
        self._measure = ReachCache(config.mesh_folder)
        self._cell_map = CellMap(cells, settings.single_cell_bodies, self._capacity)
        self.capabilities = replace(self._cell_map.engines[0].capabilities, sleeps="none")
        self._members = self._cell_map.members
        self._loads: list[QueuedLoad] = []
        self._body_order: tuple[int, CellBodyOrder] | None = None
        self._index_maps: dict[int, tuple[Sequence[int], int, CellIndexMap]] = {}
        self._states: BodyStates | None = None
        self._steps = self._last_regroup = self._next_regroup = self._alert_until = 0
        self._is_due = self._was_due = self._is_bad = self._has_new_targets = False
        self._has_regrouped = False
        """Whether the places and speed bounds are those of a regrouping."""

    @property
    def name(self) -> str:
        """See `Engine.name`."""
        return self._cell_map.engines[0].name

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`; each call prepares one cell or measures one mesh."""
        return self._cell_map.prepare(model) and self._measure.prepare(model)

    def expect(self, models: Sequence[Model], places: Sequence[Place] = ()) -> None:
        """See `Engine.expect`; with places, bodies that need cells are assigned to them now."""
        self._cell_map.expect(models)
        is_empty = bool(places) and not self._members.moving_count
        if is_empty and not self._cell_map.fits_single_cell(models):
            with suppress(EngineRefused), refuse_faults("expected models"):
                self._plan_cells(models, places)

    def _plan_cells(self, models: Sequence[Model], places: Sequence[Place]) -> None:
        """Assign expected bodies to cells as the first regrouping would."""
        moving = [at for at, model in enumerate(models) if can_move(model)]
        own_models, own_places = [models[at] for at in moving], [places[at] for at in moving]
        positions = np.array(own_places).reshape(-1, 2)
        reaches = [self._measure.measure(model).radius_m for model in own_models]
        speeds = np.full(len(moving), self._speed_margin_mps)
        groups = self._find_fitting_groups(positions, np.array(reaches), speeds).groups
        capacity = replace(self._capacity, moved_bodies=len(moving))
        cells = assign_cells(np.zeros(len(moving), np.intp), groups, positions, capacity).tolist()
        rows = zip(own_models, own_places, cells, strict=True)
        self._cell_map.plan(
            [model for model in models if not can_move(model)], [ExpectedBody(*row) for row in rows]
        )

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        """See `Engine.insert`."""
        self._cell_map.insert(body, model, self._measure.measure(model), base)
        self._was_due = self._is_due
        self._record_place(body, base)
        if not (self._was_due or self._is_due_at_next_step):
            self._is_due = self._joins_others(body, base)

    def hide(self, body: int) -> None:
        """See `Engine.hide`; hidden bodies need no regrouping."""
        for engine in self._cell_map.locate(body):
            if engine.capabilities.hides:
                engine.hide(body)
                self._members.set_concealed(body, is_concealed=True)
        if body in self._members.concealed:
            # Its overlaps may have made a regrouping, which read it.
            self._states, self._is_due = None, self._was_due

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        hidden = [body for body in bodies if body in self._members.concealed]
        for body in bodies:
            self._members.set_concealed(body, is_concealed=False)
        for engine, own in self._cell_map.group_by_cell(hidden):
            engine.show(own)
        self._states, self._is_due = None, True

    def discard(self, body: int) -> None:
        """See `Engine.discard`."""
        self._loads = [load for load in self._loads if load.body != body]
        self._cell_map.discard(body)
        self._states = None

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._cell_map.forget_removed()
        self._steps = self._last_regroup = self._next_regroup = self._alert_until = 0
        self._is_due, self._has_regrouped = True, False

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`."""
        return self.find_overlaps_async(body)()

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Engine.find_overlaps_async`; of many cells, none is asked about a body alone."""
        if not self._cell_map.is_single_cell:
            if not self._has_regrouped:
                self._regroup()
            near = self._members.cell[self._list_near(body)]
            if not len(near):
                return lambda: []
            own = self._members.cell[body]
            if own != ALL_CELLS and ((near != own) & (near != ALL_CELLS)).any():
                self._regroup()
        waits = [engine.find_overlaps_async(body) for engine in self._cell_map.locate(body)]
        known = self._members.by_number
        return lambda: sorted({one for wait in waits for one in wait() if one in known})

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        """See `Engine.read_joint_efforts`; each cell reads its own."""
        if self._cell_map.is_single_cell:
            return self._cell_map.engines[0].read_joint_efforts(bodies)
        order, index_map = self._current_order(), self._index_map(bodies)
        # Of few bodies, each cell reads only these; else indexing in Python takes more.
        is_most = len(order.numbers) <= 2 * len(index_map.rows)
        if not is_most or len(index_map.rows) < len(bodies):
            return self._read_efforts_by_cell(bodies)
        engines, efforts = self._cell_map.engines, np.zeros(index_map.joint_count)
        cells = zip(order.cells, order.bodies, strict=True)
        found = np.concatenate([engines[cell].read_joint_efforts(own) for cell, own in cells])
        efforts[index_map.joints_into] = found[index_map.joints]
        return efforts

    def _read_efforts_by_cell(self, bodies: Sequence[int]) -> FloatArray:
        """Read the efforts of joints, those of each cell together."""
        places = {body: place for place, body in enumerate(bodies)}
        counts = self._members.joint_count[list(bodies)]
        starts, efforts = np.cumsum(counts) - counts, np.zeros(counts.sum())
        for engine, own in self._cell_map.group_by_cell(bodies):
            at = [places[body] for body in own]
            efforts[expand_ranges(starts[at], counts[at])[1]] = engine.read_joint_efforts(own)
        return efforts

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        """See `Engine.read_contacts`; each cell reads its own."""
        groups = self._cell_map.group_by_cell(bodies)
        return concatenate_contacts([engine.read_contacts(own) for engine, own in groups])

    def take_faults(self) -> Mapping[int, str]:
        """See `Engine.take_faults`."""
        each = [engine.take_faults() for engine in self._cell_map.engines.values()]
        return {body: reason for faults in each for body, reason in faults.items()}

    def is_idle(self) -> bool:
        """See `Engine.is_idle`."""
        are_idle = [engine.is_idle() for engine in self._cell_map.engines.values()]
        return all(are_idle)  # asks each worker

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`; hidden bodies are read one by one."""
        if not self._members.concealed.isdisjoint(bodies):
            return concatenate_states(
                [self._cell_map.locate(body)[0].read([body]) for body in bodies]
            )
        if self._cell_map.is_single_cell:
            return self._cell_map.engines[0].read(bodies)
        return self._index_map(bodies).select(self._read_moving())

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`."""
        for engine in self._cell_map.locate(body):
            engine.set_base_state(body, base)
        self._record_place(body, base)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`."""
        for engine in self._cell_map.locate(body):
            engine.set_at_rest(body, base, positions)
        self._members.forget_targets(body)
        self._record_place(body, base)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        for engine in self._cell_map.locate(body):
            engine.set_state(body, base, positions, velocities)
        self._record_place(body, base)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`; cells get their targets together before the next step."""
        members, index_map = self._members, self._index_map(bodies)
        if not len(index_map.driven):
            return
        members.targets[index_map.targets] = targets
        members.is_commanded[index_map.driven] = True
        if self._cell_map.is_single_cell:
            self._cell_map.engines[0].command(bodies, targets)
            return
        members.is_due[index_map.driven] = self._has_new_targets = True
        speeds = np.abs(targets) * members.levers[index_map.targets]
        commanded = np.maximum.reduceat(speeds, index_map.starts)
        self._is_due |= bool((commanded > members.speed_bound[index_map.driven]).any())

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`; cells get it before the next step."""
        self._bound_load_speed(
            body, float(np.abs(wrench[:3]).sum()), float(np.abs(wrench[3:]).sum())
        )
        self._loads.append(QueuedLoad(body, link, wrench.copy()))

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`; cells get it before the next step."""
        self._bound_load_speed(body, abs(effort), abs(effort))
        self._loads.append(QueuedLoad(body, joint, effort))

    def step(self) -> bool:
        """See `Engine.step`."""
        if not self._cell_map.is_single_cell and (self._is_due or self._is_due_at_next_step):
            self._regroup()
        if self._has_new_targets:
            self._send_targets()
        if self._loads:
            self._apply_loads()
        is_well = self._advance()
        self._steps += 1
        self._states = None
        return is_well

    def close(self) -> None:
        """See `Engine.close`."""
        for engine in self._cell_map.engines.values():
            engine.close()
        self._cells.close()

    def replicate(self, bodies: Sequence[int], count: int) -> EngineReplicas:
        """See `Engine.replicate`; refuses a world that is divided."""
        if not self._cell_map.is_single_cell:
            raise EngineRefused("a world of several cells cannot be copied; use clusters='off'")
        return self._cell_map.engines[0].replicate(bodies, count)

    def resume(self) -> None:
        """See `Engine.resume`."""
        for engine in self._cell_map.engines.values():
            engine.resume()

    @property
    def _is_due_at_next_step(self) -> bool:
        """Whether the next step regroups, whatever happens before."""
        return self._steps >= self._next_regroup

    def _advance(self) -> bool:
        engines = self._cell_map.engines
        if self._cell_map.is_single_cell:
            return engines[0].step()
        # Threads that take one after another end together if the last ones are small.
        cells = self._current_order().largest_first
        is_well = self._cells.step([engines[cell] for cell in cells], 1)
        is_well, self._is_bad = is_well and not self._is_bad, False
        return is_well

    def _list_near(self, body: int) -> IntArray:
        """List the other bodies that a body may touch now."""
        members = self._members
        elapsed_s = (self._steps - self._last_regroup) * self._dt_s
        total = members.radius + members.speed_bound * elapsed_s
        total += total[body] + CELL_GAP_M
        is_near = members.find_square_distances(members.place[body]) <= total * total
        is_near &= members.cell != NO_CELL
        is_near[body] = False
        return np.flatnonzero(is_near)

    def _joins_others(self, body: int, base: FloatArray) -> bool:
        """Whether a new body may touch one of another cell before the next regrouping."""
        members = self._members
        if len(self._cell_map.engines) == 1 or members.cell[body] == ALL_CELLS:
            return True
        members.speed_bound[body] = self._speed_margin_mps + float(np.linalg.norm(base[7:10]))
        # Others may have moved since the last regrouping, where their places were recorded.
        elapsed_s = (self._next_regroup - self._last_regroup) * self._dt_s
        reach = members.radius + members.speed_bound * elapsed_s
        reach += reach[body] + CELL_GAP_M
        # By one coordinate first, which leaves few: bodies of a large world are many.
        near = np.flatnonzero(np.abs(members.place[:, 0] - base[0]) <= reach)
        cells = members.cell[near]
        near = near[(cells >= 0) & (cells != members.cell[body])]
        apart = np.linalg.norm(members.place[near] - members.place[body], axis=1)
        return bool((apart <= reach[near]).any())

    def _record_place(self, body: int, base: FloatArray) -> None:
        if self._members.cell[body] == ALL_CELLS:
            self._cell_map.record_static(body)
        self._members.place[body] = base[:2]
        self._states, self._is_due = None, True

    def _bound_load_speed(self, body: int, force: float, torque: float) -> None:
        """Bound the speed that a load adds to a body; a torque acts at its radius."""
        members = self._members
        rim, mass = members.radius[body], members.by_number[body].model.mass_kg
        gained = (force + torque / max(rim, MIN_DIVISOR)) / max(mass, MIN_DIVISOR) * self._dt_s
        members.load_speed[body] += gained
        self._is_due |= bool(members.load_speed[body] > SPEED_MARGIN_MPS / 4.0)

    def _current_order(self) -> CellBodyOrder:
        if self._body_order is None or self._body_order[0] != self._members.version:
            self._body_order = (self._members.version, make_body_order(self._members))
        return self._body_order[1]

    def _index_map(self, bodies: Sequence[int]) -> CellIndexMap:
        version = self._members.version
        known = self._index_maps.get(id(bodies))
        if known is not None and known[0] is bodies and known[1] == version:
            return known[2]
        index_map = make_index_map(bodies, self._members, self._current_order())
        if isinstance(bodies, tuple):  # a list may change
            if len(self._index_maps) >= MAX_CACHED_INDEX_MAPS:
                self._index_maps.clear()
            self._index_maps[id(bodies)] = (bodies, version, index_map)
        return index_map

    def _read_moving(self) -> BodyStates:
        """Read all bodies that move, at most once a step."""
        if self._states is None:
            order, engines = self._current_order(), self._cell_map.engines
            cells = zip(order.cells, order.bodies, strict=True)
            self._states = concatenate_states(
                self._cells.read([CellReadRequest(engines[cell], b) for cell, b in cells])
            )
        return self._states

    def _regroup(self) -> None:
        """Move bodies that may touch before the next regrouping into one cell."""
        order, states, members = self._current_order(), self._read_moving(), self._members
        numbers, places = order.numbers, states.base[:, :2]
        if self._has_regrouped:
            self._check_speed_bounds(places - members.place[numbers], members.speed_bound[numbers])
        self._has_regrouped = True
        found = self._find_groups(order, states)
        members.place[numbers], members.speed_bound[numbers] = places, found.speeds
        members.load_speed[numbers] = 0.0
        is_finite = np.asarray(np.isfinite(states.base).all(axis=1))
        self._is_bad |= not is_finite.all()
        before = members.cell[numbers]
        after = assign_cells(
            before, found.groups, np.where(is_finite[:, None], places, 0.0), self._capacity
        )
        if self._cell_map.move(order, states, np.where(is_finite, after, before)):
            self._states, self._has_new_targets = None, True
        self._last_regroup, self._is_due = self._steps, False
        period = self._settings.period_steps
        self._next_regroup = (self._steps // period + found.periods) * period
        if self._steps < self._alert_until:
            self._next_regroup = self._steps + 1

    def _check_speed_bounds(self, moved: FloatArray, bounds: FloatArray) -> None:
        """Regroup at each step for a while after a body moved farther than its speed bound."""
        elapsed_s = (self._steps - self._last_regroup) * self._dt_s
        with np.errstate(invalid="ignore", over="ignore"):
            beyond = np.linalg.norm(moved, axis=1) - bounds * elapsed_s
        if (beyond > CELL_GAP_M / 2.0).any():
            self._alert_until = self._steps + round(ALERT_S / self._dt_s)

    def _find_groups(self, order: CellBodyOrder, states: BodyStates) -> InteractionGroups:
        members, numbers = self._members, order.numbers
        radii = members.radius[numbers] = self._radii(order, states)
        velocity = states.base[:, 7:]
        with np.errstate(invalid="ignore", over="ignore"):
            linear = np.linalg.norm(velocity[:, :3], axis=1)
            own = linear + np.linalg.norm(velocity[:, 3:], axis=1) * members.com_offset_m[numbers]
        commanded = np.zeros(len(numbers))
        if len(order.driven):
            target_speeds = np.abs(members.targets[order.targets]) * members.levers[order.targets]
            commanded[order.driven] = np.maximum.reduceat(target_speeds, order.target_starts)
        speeds = np.maximum(own, commanded) + members.load_speed[numbers] + self._speed_margin_mps
        return self._find_fitting_groups(states.base[:, :2], radii, speeds)

    def _find_fitting_groups(
        self, places: FloatArray, radii: FloatArray, speeds: FloatArray
    ) -> InteractionGroups:
        """Find groups for the longest time for which they fit into cells."""
        period_s = self._settings.period_steps * self._dt_s
        choices = LOOKAHEAD_PERIODS[-1:] if self._steps < self._alert_until else LOOKAHEAD_PERIODS
        for periods in choices:
            found = find_interaction_groups(places, radii, speeds, period_s, periods=periods)
            if found.largest <= self._capacity.max_bodies(len(places)):
                break
        return found

    def _radii(self, order: CellBodyOrder, states: BodyStates) -> FloatArray:
        """Bound the radii (n,) of bodies until the next regrouping, prismatic joints included."""
        radii = self._members.rigid_m[order.numbers]
        rows, joints = order.slides
        ahead = np.abs(states.joint_velocities[joints]) * self._ahead_s
        np.add.at(radii, rows, np.abs(states.joint_positions[joints]) + ahead)
        return radii

    def _send_targets(self) -> None:
        """Send new targets to the cells."""
        self._cells.command(list(self._list_pending_targets()))
        self._members.is_due[:] = self._has_new_targets = False

    def _apply_loads(self) -> None:
        """Apply the queued loads to this step."""
        for body, part, load in self._loads:
            for engine in self._cell_map.locate(body):
                if isinstance(load, float):
                    engine.apply_joint_effort(body, part, load)
                else:
                    engine.apply_link_wrench(body, part, load)
        self._loads.clear()

    def _list_pending_targets(self) -> Iterator[CellTargets]:
        order, members, engines = self._current_order(), self._members, self._cell_map.engines
        is_due = members.is_due[order.numbers]
        if is_due[order.driven].all():
            ends = order.cell_targets.tolist()
            for cell, bodies, at, end in zip(
                order.cells, order.bodies, ends, ends[1:], strict=False
            ):
                if at < end:
                    yield CellTargets(engines[cell], bodies, members.targets[order.targets[at:end]])
            return
        due = np.flatnonzero(is_due)
        cells = members.cell[order.numbers[due]]
        for cell in np.unique(cells).tolist():
            bodies = tuple(order.numbers[due[cells == cell]].tolist())
            targets = [members.targets[members.by_number[body].targets] for body in bodies]
            yield CellTargets(engines[cell], bodies, np.concatenate(targets))
