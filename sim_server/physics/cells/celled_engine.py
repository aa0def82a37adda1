"""The Engine over many cells: regroup bodies, move them between cells, forward calls."""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.body_reach import BodyReach, ReachCache
from zensim.sim_server.physics.cells.cell_executor import CellExecutor, CellReadRequest, CellTargets
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
from zensim.sim_server.scene.broad_phase import (
    IntArray,
    expand_ranges,
    find_touching_discs,
    label_components,
)

LOG = logging.getLogger(__name__)
ALL_CELLS = -1
"""Cell of a body that cannot move: each cell has it."""
NO_CELL = -2
INITIAL_CAPACITY = 64


@dataclass
class CellBody:
    """A body of the celled engine.

    Attributes:
        targets: Slice of its targets among all.
        base: Of a body that cannot move: its state row (13,).
    """

    model: Model
    reach: BodyReach
    targets: slice
    base: FloatArray | None = None


class CellBodyTable:
    """All bodies; arrays are indexed by their number.

    Attributes:
        cell: (m,) cell of each, `ALL_CELLS` or `NO_CELL`.
        place: (m, 2) last known position.
        rigid_m: (m,) radius with prismatic joints at zero.
        radius: (m,) radius [m] at the last regrouping.
        com_offset_m: (m,) from root link to centre of mass.
        speed_bound: (m,) speed [m/s] assumed at the last regrouping.
        load_speed: (m,) speed [m/s] added by loads since.
        is_commanded: (m,) whether its targets were set since it was at rest.
        is_due: (m,) whether its cell still lacks them.
        is_concealed: (m,) whether it is hidden.
        joint_count: (m,) number of its joints.
        target_start: (m,) index of its first target in `targets`.
        width: (m,) number of its targets.
        targets: Of all bodies, body by body.
        levers: Likewise: speed [m/s] of the body per unit of each target.
        moving_count: Number of bodies that move.
        concealed: Numbers of hidden bodies.
        sliding: Indices of the prismatic joints of bodies that have any, by number.
        version: Changes whenever a body comes, goes or changes its cell.
    """

    def __init__(self) -> None:
        self.version = self.moving_count = 0
        self.by_number: dict[int, CellBody] = {}
        self.concealed: set[int] = set()
        self.sliding: dict[int, tuple[int, ...]] = {}
        self.cell: IntArray = np.full(INITIAL_CAPACITY, NO_CELL, np.intp)
        self.place: FloatArray = np.zeros((INITIAL_CAPACITY, 2))
        self.rigid_m: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.radius: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.com_offset_m: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.speed_bound: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.load_speed: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.is_commanded = np.zeros(INITIAL_CAPACITY, np.bool_)
        self.is_due = np.zeros(INITIAL_CAPACITY, np.bool_)
        self.is_concealed = np.zeros(INITIAL_CAPACITY, np.bool_)
        self.joint_count: IntArray = np.zeros(INITIAL_CAPACITY, np.intp)
        self.target_start: IntArray = np.zeros(INITIAL_CAPACITY, np.intp)
        self.width: IntArray = np.zeros(INITIAL_CAPACITY, np.intp)
        self.targets: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.levers: FloatArray = np.zeros(INITIAL_CAPACITY)
        self._gaps: dict[int, list[slice]] = {}
        self._targets_end = 0

    @property
    def moving(self) -> IntArray:
        """Numbers of bodies that move, ascending."""
        return np.flatnonzero(self.cell >= 0)

    @property
    def present(self) -> IntArray:
        """Numbers of bodies that move and are not hidden, ascending."""
        return np.flatnonzero((self.cell >= 0) & ~self.is_concealed)

    def set_concealed(self, number: int, *, is_concealed: bool) -> None:
        """Mark a body as hidden or shown."""
        (self.concealed.add if is_concealed else self.concealed.discard)(number)
        self.is_concealed[number] = is_concealed
        self.version += 1

    def add(self, number: int, model: Model, reach: BodyReach, *, cell: int) -> None:
        """Add a body."""
        while number >= len(self.cell):
            self._grow()
        member = CellBody(model, reach, self._allocate_targets(len(reach.levers)))
        self.by_number[number] = member
        self.cell[number] = cell
        self.rigid_m[number] = self.radius[number] = reach.radius_m
        self.com_offset_m[number], self.speed_bound[number] = reach.com_offset_m, 0.0
        self.joint_count[number] = len(model.joints)
        self.target_start[number], self.width[number] = member.targets.start, len(reach.levers)
        if reach.slides:
            self.sliding[number] = reach.slides
        self.moving_count += cell >= 0
        self.levers[member.targets] = reach.levers
        self.forget_targets(number)
        self.version += 1

    def remove(self, number: int) -> None:
        """Remove a body."""
        member = self.by_number.pop(number)
        self.moving_count -= int(self.cell[number]) >= 0
        self.cell[number] = NO_CELL
        self.concealed.discard(number)
        self.is_concealed[number] = False
        self.sliding.pop(number, None)
        self.load_speed[number] = 0.0
        self.is_commanded[number] = self.is_due[number] = False
        width = member.targets.stop - member.targets.start
        self._gaps.setdefault(width, []).append(member.targets)
        self.version += 1

    def move(self, number: int, *, cell: int) -> None:
        """Record the new cell of a body; its targets become due there."""
        self.cell[number] = cell
        self.is_due[number] = self.is_commanded[number]
        self.version += 1

    def find_square_distances(self, place: FloatArray) -> FloatArray:
        """Find the squares (m,) of the distances of all bodies from a place (2,)."""
        away = self.place - place
        return np.asarray(np.einsum("ij,ij->i", away, away))

    def find_target_ranges(self, numbers: IntArray) -> tuple[IntArray, IntArray]:
        """Find the starts and lengths (n,) of the target ranges of bodies."""
        return self.target_start[numbers], self.width[numbers]

    def forget_targets(self, number: int) -> None:
        """Reset the targets of a body to zero."""
        self.is_commanded[number] = self.is_due[number] = False
        self.load_speed[number] = 0.0
        self.targets[self.by_number[number].targets] = 0.0

    def _allocate_targets(self, width: int) -> slice:
        if gaps := self._gaps.get(width):
            return gaps.pop()
        start, self._targets_end = self._targets_end, self._targets_end + width
        while self._targets_end > len(self.targets):
            self.targets = np.concatenate([self.targets, np.zeros_like(self.targets)])
            self.levers = np.concatenate([self.levers, np.zeros_like(self.levers)])
        return slice(start, self._targets_end)

    def _grow(self) -> None:
        for name in (
            "place",
            "rigid_m",
            "radius",
            "com_offset_m",
            "speed_bound",
            "load_speed",
            "is_commanded",
            "is_due",
            "is_concealed",
            "joint_count",
            "target_start",
            "width",
        ):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.zeros_like(array)]))
        self.cell = np.concatenate([self.cell, np.full(len(self.cell), NO_CELL, np.intp)])


@dataclass(frozen=True)
class CellBodyOrder:
    """All n bodies that move, cell by cell: the order in which they are read and commanded.

    Attributes:
        cells: (c,) cells with such bodies.
        largest_first: The same, those with most bodies first.
        bodies: For each cell, its bodies.
        numbers: (n,) of the bodies.
        row: (m,) index in `numbers` by number; -1 = absent.
        joint_start: (n + 1,) index of the first joint of each.
        targets: (t,) indices of their targets in the table.
        target_starts: (d,) starts in `targets`, of bodies with targets.
        driven: (d,) rows of those bodies.
        cell_targets: (c + 1,) starts in `targets` by cell.
        slides: Row, and index among all joints, of each prismatic joint.
    """

    cells: tuple[int, ...]
    largest_first: tuple[int, ...]
    bodies: tuple[tuple[int, ...], ...]
    numbers: IntArray
    row: IntArray
    joint_start: IntArray
    targets: IntArray
    target_starts: IntArray
    driven: IntArray
    cell_targets: IntArray
    slides: tuple[IntArray, IntArray]


def make_body_order(members: CellBodyTable) -> CellBodyOrder:
    """Sort all bodies that move and are shown by cell."""
    moving = members.present
    numbers = moving[np.argsort(members.cell[moving], kind="stable")]
    cells, firsts = np.unique(members.cell[numbers], return_index=True)
    parts = np.split(numbers, firsts[1:]) if len(numbers) else []
    by_size = np.argsort([-len(part) for part in parts], kind="stable")
    row = np.full(len(members.cell), -1, np.intp)
    row[numbers] = np.arange(len(numbers))
    joint_start = np.concatenate([[0], np.cumsum(members.joint_count[numbers])]).astype(np.intp)
    starts, widths = members.find_target_ranges(numbers)
    slides = [
        (int(row[number]), joint_start[row[number]] + slide)
        for number, own in members.sliding.items()
        if row[number] >= 0
        for slide in own
    ]
    return CellBodyOrder(
        tuple(cells.tolist()),
        tuple(cells[by_size].tolist()),
        tuple(tuple(part.tolist()) for part in parts),
        numbers,
        row,
        joint_start,
        expand_ranges(starts, widths)[1],
        (np.cumsum(widths) - widths)[widths > 0].astype(np.intp),
        np.flatnonzero(widths > 0),
        np.concatenate([[0], np.cumsum(widths)])[[*firsts, len(numbers)]].astype(np.intp),
        (np.array([a for a, _ in slides], np.intp), np.array([b for _, b in slides], np.intp)),
    )


@dataclass(frozen=True)
class CellIndexMap:
    """Indices of n selected bodies in a `CellBodyOrder` and among the targets.

    Attributes:
        rows: (k,) of the order.
        into: (k,) rows of the result that they fill; the others cannot move.
        base: (n, 13) the result for bodies that cannot move.
        joints: Joints of the order, in the order of the result.
        joints_into: Joints of the result that they fill.
        joint_count: Of the result.
        numbers: (n,) of the bodies.
        targets: Indices of their targets in the table.
        starts: Starts in `targets`, of bodies with targets.
        driven: Numbers of those bodies.
    """

    rows: IntArray
    into: IntArray
    base: FloatArray
    joints: IntArray
    joints_into: IntArray
    joint_count: int
    numbers: IntArray
    targets: IntArray
    starts: IntArray
    driven: IntArray

    def select(self, states: BodyStates) -> BodyStates:
        """Select their states from the states of the order."""
        base = self.base.copy()
        base[self.into] = states.base[self.rows]
        positions, velocities = np.zeros(self.joint_count), np.zeros(self.joint_count)
        positions[self.joints_into] = states.joint_positions[self.joints]
        velocities[self.joints_into] = states.joint_velocities[self.joints]
        return BodyStates(base, positions, velocities)


def make_index_map(
    bodies: Sequence[int], members: CellBodyTable, order: CellBodyOrder
) -> CellIndexMap:
    """Make the index map of some bodies."""
    numbers = np.array(bodies, np.intp)
    rows = order.row[numbers] if len(numbers) else numbers
    counts = members.joint_count[numbers]
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    into = np.flatnonzero(rows >= 0)
    base = np.zeros((len(numbers), 13))
    for at in np.flatnonzero(rows < 0).tolist():
        base[at] = members.by_number[bodies[at]].base
    starts_in_table, widths = members.find_target_ranges(numbers)
    is_driven = widths > 0
    ends = np.cumsum(widths)
    return CellIndexMap(
        rows[into],
        into,
        base,
        expand_ranges(order.joint_start[rows[into]], counts[into])[1],
        expand_ranges(starts[into], counts[into])[1],
        int(starts[-1]),
        numbers,
        expand_ranges(starts_in_table, widths)[1],
        (ends - widths)[is_driven].astype(np.intp),
        numbers[is_driven],
    )


FILL_RATIO = 0.75
"""Share of the capacity to which an overfull cell is emptied and others are filled."""

LARGE_WORLD_CELLS = 4
"""Number of cells of a large world, unless `CellCapacity.largest` requires more."""


@dataclass(frozen=True)
class CellCapacity:
    """Maximum numbers of bodies.

    Attributes:
        cell_bodies: Of a cell; a group that cannot be split may exceed it.
        moved_bodies: That an overfull cell gives away in one regrouping.
        large_cell_bodies: Of a cell of a large world; fewer cells take less memory.
    """

    cell_bodies: int
    moved_bodies: int
    large_cell_bodies: int = 0

    def max_bodies(self, count: int) -> int:
        """Find the maximum bodies of a cell in a world of `count` bodies."""
        return max(self.cell_bodies, min(self.large_cell_bodies, count // LARGE_WORLD_CELLS))

    def fill_limit(self, count: int) -> int:
        """Find the number of bodies up to which a cell receives groups."""
        return max(1, int(self.max_bodies(count) * FILL_RATIO))


def assign_cells(
    cells: IntArray, groups: IntArray, places: FloatArray, capacity: CellCapacity
) -> IntArray:
    """Choose a cell for each body.

    Args:
        cells: (n,) current cell of each, >= 0.
        groups: (n,) bodies of one number go to one cell.
        places: (n, 2).
        capacity: Of the cells.

    Returns:
        (n,) cells; new cells get the least free numbers.
    """
    found = _merge_groups(cells, groups)
    loads = CellLoads(found, places)
    for cell in np.flatnonzero(loads.counts > capacity.max_bodies(len(cells))):
        _offload_groups(int(cell), found, groups, loads, capacity)
    return found


class CellLoads:
    """How many bodies each cell has and where, kept while groups move between cells."""

    def __init__(self, cells: IntArray, places: FloatArray) -> None:
        self.places = places
        self.counts = np.bincount(cells, minlength=1)
        self.sums: FloatArray = np.stack([np.bincount(cells, own) for own in places.T], axis=1)
        """(c, 2) sums of the places of the bodies of each cell."""

    def move(self, members: IntArray, giver: int, target: int) -> None:
        """Count bodies in another cell, which may be the next new one."""
        if target == len(self.counts):
            self.counts = np.append(self.counts, 0)
            self.sums = np.concatenate([self.sums, np.zeros((1, 2))])
        moved = self.places[members].sum(axis=0)
        self.counts[giver] -= len(members)
        self.counts[target] += len(members)
        self.sums[giver] -= moved
        self.sums[target] += moved

    def find_receiving_cell(self, giver: int, members: IntArray, fill_limit: int) -> int:
        """Find the nearest cell with capacity for a group, else a new one."""
        counts = self.counts
        fits = (counts > 0) & (counts + len(members) <= fill_limit)
        fits[giver] = False
        if not fits.any():
            free = np.flatnonzero(counts == 0)
            return int(free[0]) if len(free) else len(counts)
        middles = self.sums / np.maximum(counts, 1)[:, None]
        apart = np.hypot(*(middles - self.places[members].mean(axis=0)).T)
        return int(np.where(fits, apart, np.inf).argmin())


def _merge_groups(cells: IntArray, groups: IntArray) -> IntArray:
    """Move each group to the cell that contains most of it; the first of equals."""
    count = int(groups.max(initial=-1)) + 1
    low, high = np.full(count, np.iinfo(np.intp).max), np.full(count, -1)
    np.minimum.at(low, groups, cells)
    np.maximum.at(high, groups, cells)
    target = low
    for group in np.flatnonzero(low != high):
        target[group] = np.bincount(cells[groups == group]).argmax()
    return target[groups]


def _offload_groups(
    cell: int, cells: IntArray, groups: IntArray, loads: CellLoads, capacity: CellCapacity
) -> None:
    """Move groups from one end of an overfull cell to others, up to `moved_bodies`."""
    held = np.flatnonzero(cells == cell)
    left, moved, fill_limit = len(held), 0, capacity.fill_limit(len(cells))
    for members in _list_groups_from_far_end(held, groups, loads.places):
        if left <= fill_limit or moved >= capacity.moved_bodies or len(members) == len(held):
            return
        target = loads.find_receiving_cell(cell, members, fill_limit)
        loads.move(members, cell, target)
        cells[members] = target
        left, moved = left - len(members), moved + len(members)


def _list_groups_from_far_end(
    held: IntArray, groups: IntArray, places: FloatArray
) -> list[IntArray]:
    """Sort the groups of a cell along its longer side, the far end first."""
    spread = np.ptp(places[held], axis=0)
    along = places[held, int(spread[1] > spread[0])]
    names, inverse = np.unique(groups[held], return_inverse=True)
    ends = np.full(len(names), -np.inf)
    np.maximum.at(ends, inverse, along)
    firsts = np.cumsum(np.bincount(inverse, minlength=len(names)))[:-1]
    members = np.split(held[np.argsort(inverse, kind="stable")], firsts)
    return [members[group] for group in np.argsort(-ends, kind="stable").tolist()]


CELL_GAP_M = 0.02
"""Least distance between bodies of different cells."""
SPEED_MARGIN_MPS = 2.0
"""Speed that a body may gain by motors or impacts before the next regrouping."""


@dataclass(frozen=True)
class InteractionGroups:
    """Groups of bodies that cannot touch other groups for some time.

    Attributes:
        groups: (n,) group of each body, from 0.
        speeds: (n,) assumed bounds of their speeds [m/s].
        periods: Number of periods for which it holds.
    """

    groups: IntArray
    speeds: FloatArray
    periods: int

    @property
    def largest(self) -> int:
        """Number of bodies of the largest group."""
        return int(np.bincount(self.groups).max(initial=0))


def find_interaction_groups(
    places: FloatArray, radii: FloatArray, speeds: FloatArray, period_s: float, *, periods: int
) -> InteractionGroups:
    """Put bodies that may touch within some periods into one group.

    Args:
        places: (n, 2); a body without a finite place is a group of its own.
        radii: (n,) [m].
        speeds: (n,) upper bounds [m/s] without impacts.
        period_s: Length of a period.
        periods: Number of periods.
    """
    is_known = np.isfinite(places).all(axis=1) & np.isfinite(radii) & np.isfinite(speeds)
    known = np.flatnonzero(is_known)
    bounds = speeds.copy()
    groups = np.zeros(0, np.intp)
    while True:
        swept = radii[known] + bounds[known] * (period_s * periods) + CELL_GAP_M / 2.0
        groups = label_components(len(known), *find_touching_discs(places[known], swept))
        raised = _raise_to_fastest(bounds[known], groups)
        if (raised <= bounds[known]).all():
            break
        bounds[known] = raised
    found = np.zeros(len(places), np.intp)
    found[known] = groups
    lost = np.flatnonzero(~is_known)
    found[lost] = int(groups.max(initial=-1)) + 1 + np.arange(len(lost))
    return InteractionGroups(found, bounds, periods)


def _raise_to_fastest(speeds: FloatArray, groups: IntArray) -> FloatArray:
    """Raise speed bounds in each group: an impact may make a body as fast as the fastest one."""
    fastest = np.zeros(int(groups.max(initial=-1)) + 1)
    np.maximum.at(fastest, groups, speeds)
    return np.maximum(speeds, fastest[groups] - SPEED_MARGIN_MPS / 2.0)


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
            [model for model in models if not can_move(model)],
            [ExpectedBody(*row) for row in rows],
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
