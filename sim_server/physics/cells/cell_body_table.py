"""Bodies of the celled engine as arrays, and index maps between bodies and cells."""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.body_reach import BodyReach
from zensim.sim_server.physics.engine import BodyStates, FloatArray
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges

ALL_CELLS = -1
"""Cell of what never moves: it has a copy in each."""
NO_CELL = -2
INITIAL_CAPACITY = 64


@dataclass
class CellBody:
    """A body.

    Attributes:
        targets: Where its targets stand among all.
        copies: Of what never moves: its number in each cell that there is.
        base: Of what never moves: its row (13,), as it was read.
    """

    model: Model
    reach: BodyReach
    targets: slice
    copies: dict[int, int] = field(default_factory=dict)
    base: FloatArray | None = None


class CellBodyTable:
    """Which bodies there are; arrays by number.

    Attributes:
        cell: (m,) where each is.
        inner: (m,) its number there.
        place: (m, 2) where it was last known to be.
        rigid_m: (m,) how far it reaches while nothing slides.
        radius: (m,) how far it reached at the last look [m].
        arm: (m,) from root to centre of mass [m].
        bound: (m,) the speed that it was thought to have at most [m/s].
        kick: (m,) what pushes gave it since [m/s].
        told: (m,) whether its targets were set since it was at rest.
        is_due: (m,) whether they are still to be told to its cell.
        targets: of all, body by body.
        moving_count: How many move.
        concealed: Numbers of those that wait until others are made too.
        version: Changes whenever somebody comes, goes or moves to another cell.
    """

    def __init__(self) -> None:
        self.version = self.moving_count = 0
        self.by_number: dict[int, CellBody] = {}
        self.concealed: set[int] = set()
        self.cell: IntArray = np.full(INITIAL_CAPACITY, NO_CELL, np.intp)
        self.inner: IntArray = np.zeros(INITIAL_CAPACITY, np.intp)
        self.place: FloatArray = np.zeros((INITIAL_CAPACITY, 2))
        self.rigid_m: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.radius: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.arm: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.bound: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.kick: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.told = np.zeros(INITIAL_CAPACITY, np.bool_)
        self.is_due = np.zeros(INITIAL_CAPACITY, np.bool_)
        self.targets: FloatArray = np.zeros(INITIAL_CAPACITY)
        self.levers: FloatArray = np.zeros(INITIAL_CAPACITY)
        self._free: list[int] = []
        self._gaps: dict[int, list[slice]] = {}
        self._targets_end = 0

    @property
    def moving(self) -> IntArray:
        """Numbers of what moves, ascending."""
        return np.flatnonzero(self.cell >= 0)

    @property
    def present(self) -> IntArray:
        """Numbers of what moves and is not concealed, ascending."""
        moving = self.moving
        return np.setdiff1d(moving, list(self.concealed)) if self.concealed else moving

    def set_concealed(self, number: int, *, is_concealed: bool) -> None:
        """Note that a body takes part, or does not."""
        (self.concealed.add if is_concealed else self.concealed.discard)(number)
        self.version += 1

    def add(self, model: Model, reach: BodyReach, *, cell: int, inner: int) -> int:
        """Give a new body the least number that is free."""
        number = heapq.heappop(self._free) if self._free else len(self.by_number)
        while number >= len(self.cell):
            self._grow()
        member = CellBody(model, reach, self._allocate_targets(len(reach.levers)))
        self.by_number[number] = member
        self.cell[number], self.inner[number] = cell, inner
        self.rigid_m[number] = self.radius[number] = reach.radius_m
        self.arm[number], self.bound[number] = reach.com_offset_m, 0.0
        self.moving_count += cell >= 0
        self.levers[member.targets] = reach.levers
        self.forget_targets(number)
        self.version += 1
        return number

    def remove(self, number: int) -> CellBody:
        """Forget a body."""
        member = self.by_number.pop(number)
        self.moving_count -= int(self.cell[number]) >= 0
        self.cell[number] = NO_CELL
        self.concealed.discard(number)
        self.kick[number] = 0.0
        self.told[number] = self.is_due[number] = False
        width = member.targets.stop - member.targets.start
        self._gaps.setdefault(width, []).append(member.targets)
        heapq.heappush(self._free, number)
        self.version += 1
        return member

    def move(self, number: int, *, cell: int, inner: int) -> None:
        """Note that a body went to another cell: its targets are to be told there."""
        self.cell[number], self.inner[number] = cell, inner
        self.is_due[number] = self.told[number]
        self.version += 1

    def find_target_ranges(self, numbers: IntArray) -> tuple[IntArray, IntArray]:
        """Find where the targets of bodies start, and how many each has."""
        found = [self.by_number[number].targets for number in numbers.tolist()]
        starts = np.array([one.start for one in found], np.intp)
        return starts, np.array([one.stop for one in found], np.intp) - starts

    def forget_targets(self, number: int) -> None:
        """Note that a body has none but those of a body at rest."""
        self.told[number] = self.is_due[number] = False
        self.kick[number] = 0.0
        self.targets[self.by_number[number].targets] = 0.0

    def reset_numbering(self) -> None:
        """Number bodies, and place their targets, as if nobody had ever gone."""
        if not self.by_number:
            self._free.clear()
            self._gaps.clear()
            self._targets_end = 0

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
            "inner",
            "place",
            "rigid_m",
            "radius",
            "arm",
            "bound",
            "kick",
            "told",
            "is_due",
        ):
            array = getattr(self, name)
            setattr(self, name, np.concatenate([array, np.zeros_like(array)]))
        self.cell = np.concatenate([self.cell, np.full(len(self.cell), NO_CELL, np.intp)])


@dataclass(frozen=True)
class CellBodyOrder:
    """All bodies that move, cell by cell: the order in which they are read and told.

    Attributes:
        cells: Which cells have any.
        bodies: For each of these, the numbers that its bodies have there.
        numbers: (n,) of the bodies, one cell after the other.
        row: (m,) where each number stands in `numbers`.
        joint_start: (n + 1,) where the joints of each start.
        targets: Of all targets, those of these bodies, but for those that have none.
        target_starts: Where the targets of each body that has any start.
        driven: (d,) rows of these bodies.
        cell_targets: (c + 1,) where the targets of each cell start among `targets`.
        slides: Pairs: row, and where a joint that slides stands among all joints.
    """

    cells: tuple[int, ...]
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
    """Line up all that moves and takes part."""
    moving = members.present
    numbers = moving[np.argsort(members.cell[moving], kind="stable")]
    cells, firsts = np.unique(members.cell[numbers], return_index=True)
    inner = members.inner[numbers]
    parts = np.split(inner, firsts[1:]) if len(numbers) else []
    row = np.full(len(members.cell), -1, np.intp)
    row[numbers] = np.arange(len(numbers))
    counts = [len(members.by_number[number].model.joints) for number in numbers.tolist()]
    joint_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    starts, widths = members.find_target_ranges(numbers)
    slides = [
        (at, joint_start[at] + slide)
        for at, number in enumerate(numbers.tolist())
        for slide in members.by_number[number].reach.slides
    ]
    return CellBodyOrder(
        tuple(cells.tolist()),
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
    """Where the bodies that somebody names stand in a lineup and among the targets.

    Attributes:
        rows: (k,) of the lineup.
        into: (k,) rows of the answer that they fill; the others are of bodies that never move.
        base: (n, 13) the answer, but for those.
        joints: Of the lineup's joints, in the order of the answer's.
        joints_into: Which of the answer's joints these fill.
        joint_count: Of the answer.
        numbers: (n,) the bodies.
        targets: Of all targets, those of these bodies in order.
        starts: Where the targets of each body that has any start.
        driven: These bodies.
        alone: (n,) the numbers that they have in the first cell, if there is no other.
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
    alone: tuple[int, ...]

    def select(self, now: BodyStates) -> BodyStates:
        """Cut the answer out of a reading of the lineup."""
        base = self.base.copy()
        base[self.into] = now.base[self.rows]
        positions, velocities = np.zeros(self.joint_count), np.zeros(self.joint_count)
        positions[self.joints_into] = now.joint_positions[self.joints]
        velocities[self.joints_into] = now.joint_velocities[self.joints]
        return BodyStates(base, positions, velocities)


def make_index_map(
    bodies: Sequence[int], members: CellBodyTable, lineup: CellBodyOrder
) -> CellIndexMap:
    """Work out how to find bodies."""
    numbers = np.array(bodies, np.intp)
    rows = lineup.row[numbers] if len(numbers) else numbers
    found = [members.by_number[number] for number in bodies]
    counts = np.array([len(member.model.joints) for member in found], np.intp)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    into = np.flatnonzero(rows >= 0)
    base = np.zeros((len(found), 13))
    for at in np.flatnonzero(rows < 0).tolist():
        base[at] = found[at].base
    slices, widths = members.find_target_ranges(numbers)
    is_driven = widths > 0
    ends = np.cumsum(widths)
    return CellIndexMap(
        rows[into],
        into,
        base,
        expand_ranges(lineup.joint_start[rows[into]], counts[into])[1],
        expand_ranges(starts[into], counts[into])[1],
        int(starts[-1]),
        numbers,
        expand_ranges(slices, widths)[1],
        (ends - widths)[is_driven].astype(np.intp),
        numbers[is_driven],
        tuple(m.copies.get(0, int(members.inner[n])) for n, m in zip(bodies, found, strict=True)),
    )


def concatenate_readings(readings: Sequence[BodyStates]) -> BodyStates:
    """Chain what was read of cells."""
    if len(readings) == 1:
        return readings[0]
    return BodyStates(
        np.concatenate([np.zeros((0, 13)), *(reading.base for reading in readings)]),
        np.concatenate([np.zeros(0), *(reading.joint_positions for reading in readings)]),
        np.concatenate([np.zeros(0), *(reading.joint_velocities for reading in readings)]),
    )
