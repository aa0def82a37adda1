"""Columns of all bodies of the two tiers, and index maps that split them by tier."""

import heapq
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges

IntColumn = npt.NDArray[np.intp]
BoolColumn = npt.NDArray[np.bool_]
RowSelection = IntColumn | slice
"""Rows by their numbers or as a slice."""
INITIAL_ROWS = 64


class Tier(IntEnum):
    """Where a body is simulated."""

    NONE = 0
    """The row is free."""
    FULL = 1
    KINEMATIC = 2
    HIDDEN = 3
    """Kinematic once it is shown: until then it neither moves nor stops others."""


class TierBodyTable:
    """Columns of all bodies, indexed by their numbers.

    Attributes:
        tier: One of `Tier`.
        is_auto: Whether it changes tiers automatically.
        is_held: Whether it may be in the kinematic tier; then its joints and targets are pooled.
        is_static: Whether it never moves.
        joint_count, joint_start: Range of its joints in the pool.
        width, target_start: Range of its targets in the pool.
        radius: Of its disc [m].
        centre: (2, n) of the disc in the root link.
        heights: (2, n) lowest and highest point relative to the root link.
        place: (3, n) of the root link.
        yaw: Heading [rad].
        half: (2, n) sine and cosine of half the heading.
        tilt: (4, n) orientation of the root link before rotation by its heading.
        twist: (3, n) vx, vy, wz along the heading.
        pace: Bound of its speed [m/s] until the next proximity check.
        exceeds_limits: Whether its command exceeds what it can do without dynamics.
        reach_m: Bound of the distance from a root link to the rim of its disc, for all bodies.
    """

    def __init__(self) -> None:
        self.tier: IntColumn = np.zeros(INITIAL_ROWS, np.intp)
        self.is_auto: BoolColumn = np.zeros(INITIAL_ROWS, np.bool_)
        self.is_held: BoolColumn = np.zeros(INITIAL_ROWS, np.bool_)
        self.is_static: BoolColumn = np.zeros(INITIAL_ROWS, np.bool_)
        self.joint_count: IntColumn = np.zeros(INITIAL_ROWS, np.intp)
        self.joint_start: IntColumn = np.zeros(INITIAL_ROWS, np.intp)
        self.width: IntColumn = np.zeros(INITIAL_ROWS, np.intp)
        self.target_start: IntColumn = np.zeros(INITIAL_ROWS, np.intp)
        self.radius: FloatArray = np.zeros(INITIAL_ROWS)
        self.centre: FloatArray = np.zeros((2, INITIAL_ROWS))
        self.heights: FloatArray = np.zeros((2, INITIAL_ROWS))
        self.place: FloatArray = np.zeros((3, INITIAL_ROWS))
        self.yaw: FloatArray = np.zeros(INITIAL_ROWS)
        self.half: FloatArray = np.zeros((2, INITIAL_ROWS))
        self.tilt: FloatArray = np.zeros((4, INITIAL_ROWS))
        self.twist: FloatArray = np.zeros((3, INITIAL_ROWS))
        self.pace: FloatArray = np.zeros(INITIAL_ROWS)
        self.exceeds_limits: BoolColumn = np.zeros(INITIAL_ROWS, np.bool_)
        self.reach_m = 0.0

    def add(self, row: int) -> None:
        """Set a row, which may be beyond the end, to zeros."""
        while row >= len(self.tier):
            self._grow()
        for column in vars(self).values():
            if isinstance(column, np.ndarray):
                column[..., row] = 0

    def tile(self, rows: IntColumn, copies: int) -> "TierBodyTable":
        """Make a table of `copies` times these rows, which pools their joints and targets anew."""
        found = TierBodyTable()
        for name, column in vars(self).items():
            if isinstance(column, np.ndarray):
                setattr(found, name, np.tile(column[..., rows], copies))
        found.joint_start = np.cumsum(found.joint_count) - found.joint_count
        found.target_start = np.cumsum(found.width) - found.width
        found.reach_m = self.reach_m
        return found

    def set_disc(self, row: int, radius_m: float, centre: Sequence[float] | FloatArray) -> None:
        """Set the disc of a body; its centre (2,) is in the root link."""
        self.radius[row], self.centre[:, row] = radius_m, centre
        self.reach_m = max(self.reach_m, radius_m + float(np.hypot(*centre)))

    def turn_to(self, at: RowSelection, yaw: FloatArray) -> None:
        """Set headings."""
        self.yaw[at] = yaw
        half = yaw * 0.5
        self.half[0, at] = np.sin(half)
        self.half[1, at] = np.cos(half)

    def headings(self, at: RowSelection) -> tuple[FloatArray, FloatArray]:
        """Compute cosines and sines (n,) of headings."""
        sin, cos = self.half[0, at], self.half[1, at]
        return cos * cos - sin * sin, 2.0 * sin * cos

    def discs(self, at: RowSelection) -> FloatArray:
        """Compute the centres (n, 2) of discs in the world."""
        x, y = self.centre[0, at], self.centre[1, at]
        found = np.empty((len(x), 2))
        found[:, 0], found[:, 1] = self.place[0, at], self.place[1, at]
        if x.any() or y.any():
            right, up = rotate_by_heading(x, y, self.headings(at))
            found[:, 0] += right
            found[:, 1] += up
        return found

    def states(self, at: RowSelection) -> FloatArray:
        """Compute the state rows (n, 13) of kinematic bodies."""
        sin, cos = self.half[0, at], self.half[1, at]
        x, y, z, w = (self.tilt[k, at] for k in range(4))
        vx, vy = rotate_by_heading(self.twist[0, at], self.twist[1, at], self.headings(at))
        found = np.zeros((len(x), 13))
        # One assignment: column by column would pass through memory thirteen times.
        found.T[:9] = [
            *(self.place[k, at] for k in range(3)),
            *(cos * x - sin * y, cos * y + sin * x, cos * z + sin * w, cos * w - sin * z),
            *(vx, vy),
        ]
        found[:, 12] = self.twist[2, at]
        return found

    def _grow(self) -> None:
        for name, column in vars(self).items():
            if isinstance(column, np.ndarray):
                setattr(self, name, np.concatenate([column, np.zeros_like(column)], axis=-1))


def select_rows(rows: IntColumn) -> RowSelection:
    """Convert consecutive rows to a slice, which is several times as fast."""
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1 and bool((np.diff(rows) == 1).all()):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def rotate_by_heading(
    x: FloatArray, y: FloatArray, heading: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Rotate vectors x (n,), y (n,) by headings, given as cosines and sines."""
    cos, sin = heading
    return cos * x - sin * y, sin * x + cos * y


class ArrayPool:
    """Array of consecutive numbers of each body; freed ranges are reused."""

    def __init__(self) -> None:
        self.numbers: FloatArray = np.zeros(INITIAL_ROWS)
        self._end = 0
        self._free: dict[int, list[int]] = {}

    def allocate(self, count: int) -> int:
        """Allocate a range; its values are undefined."""
        if free := self._free.get(count):
            return heapq.heappop(free)
        start, self._end = self._end, self._end + count
        while self._end > len(self.numbers):
            self.numbers = np.concatenate([self.numbers, np.zeros_like(self.numbers)])
        return start

    def free(self, start: int, count: int) -> None:
        """Free an allocated range."""
        heapq.heappush(self._free.setdefault(count, []), start)


MAX_MAPPED_BODIES = 1 << 17
"""Bodies of all cached index maps; a world has its own and those of its agents."""


@dataclass(frozen=True)
class TierSlice:
    """The bodies of a sequence that are in one tier.

    Attributes:
        rows: (n,) of the bodies.
        places: (n,) indices in the sequence.
        joints, targets: Indices among the joints and targets of the whole sequence.
    """

    rows: IntArray
    places: IntArray
    joints: IntArray
    targets: IntArray


@dataclass(frozen=True)
class TierIndexMap:
    """A sequence of bodies, split by tier.

    Attributes:
        count: Number of bodies.
        joint_count: Of all of them.
        at: Rows of the kinematic ones.
        bodies: The others, which are in the full engine.
        pooled_joints: Indices of the joints of the kinematic ones in the pool.
        held: Rows of robots that may be kinematic.
        pooled_targets: Indices of their targets in the pool.
        held_targets: Indices of their targets in the sequence.
    """

    count: int
    joint_count: int
    kinematic: TierSlice
    full: TierSlice
    at: RowSelection
    bodies: tuple[int, ...]
    pooled_joints: IntArray
    held: tuple[int, ...]
    pooled_targets: IntArray
    held_targets: IntArray


def split_by_tier(rows: TierBodyTable, numbers: IntArray) -> TierIndexMap:
    """Split bodies (n,) by tier."""
    joints, widths = rows.joint_count[numbers], rows.width[numbers]
    joint_at, target_at = np.cumsum(joints) - joints, np.cumsum(widths) - widths
    is_kinematic = rows.tier[numbers] >= Tier.KINEMATIC

    def half(places: IntArray) -> TierSlice:
        return TierSlice(
            numbers[places],
            places,
            expand_ranges(joint_at[places], joints[places])[1],
            expand_ranges(target_at[places], widths[places])[1],
        )

    kinematic, full = half(np.flatnonzero(is_kinematic)), half(np.flatnonzero(~is_kinematic))
    is_held = rows.is_held[numbers]
    held = numbers[is_held]
    return TierIndexMap(
        count=len(numbers),
        joint_count=int(joints.sum()),
        kinematic=kinematic,
        full=full,
        at=select_rows(kinematic.rows),
        bodies=tuple(full.rows.tolist()),
        pooled_joints=expand_ranges(
            rows.joint_start[kinematic.rows], rows.joint_count[kinematic.rows]
        )[1],
        held=tuple(held.tolist()),
        pooled_targets=expand_ranges(rows.target_start[held], rows.width[held])[1],
        held_targets=expand_ranges(target_at[is_held], widths[is_held])[1],
    )


class TierIndexMapCache:
    """Caches the index maps of tuples of bodies."""

    def __init__(self, rows: TierBodyTable) -> None:
        self._table = rows
        self._kept: OrderedDict[int, tuple[Sequence[int], IntArray, TierIndexMap | None]] = (
            OrderedDict()
        )
        self._mapped = 0
        """Number of bodies of all selections that are kept."""

    def __len__(self) -> int:
        return len(self._kept)

    def __getstate__(self) -> dict[str, object]:
        """Leave out what is cached by the identity of tuples."""
        return {**self.__dict__, "_kept": OrderedDict(), "_mapped": 0}

    def get(self, bodies: Sequence[int]) -> TierIndexMap:
        """Split bodies by tier."""
        if not isinstance(bodies, tuple):
            return split_by_tier(self._table, np.array(bodies, np.intp))
        # A tuple is constant, and while it is kept here, its id is unique.
        kept = self._kept.get(id(bodies))
        if kept is not None:
            self._kept.move_to_end(id(bodies))
            if kept[2] is not None:
                return kept[2]
        numbers = kept[1] if kept else np.array(bodies, np.intp)
        mapping = split_by_tier(self._table, numbers)
        self._mapped += 0 if kept else len(bodies)
        self._kept[id(bodies)] = (bodies, numbers, mapping)
        while self._mapped > MAX_MAPPED_BODIES and len(self._kept) > 1:
            self._mapped -= len(self._kept.popitem(last=False)[1][0])
        return mapping

    def invalidate(self) -> None:
        """Drop all maps after bodies changed; forget tuples that were not used since."""
        kept = list(self._kept.items())
        self._kept.clear()
        self._mapped = sum(len(bodies) for _, (bodies, _, mapping) in kept if mapping is not None)
        for number, (bodies, numbers, mapping) in kept:
            if mapping is not None:
                self._kept[number] = (bodies, numbers, None)
