"""What is known of each body of two tiers, a row each: columns that grow."""

import heapq
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.engine import FloatArray

IntColumn = npt.NDArray[np.intp]
BoolColumn = npt.NDArray[np.bool_]
At = IntColumn | slice
"""Which rows: their numbers, or from where to where."""
FIRST = 64


class Tier(IntEnum):
    """Where a body is simulated."""

    NONE = 0
    """The row is free."""
    FULL = 1
    KINEMATIC = 2


class Rows:
    """Columns of all bodies; a body's number is its row. What has k numbers a body is (k, n).

    Attributes:
        tier: One of `Tier`.
        is_auto: Whether it changes tiers by itself.
        is_held: Whether it is a robot that may be in the kinematic tier, so that its joints and
            targets are kept here.
        is_static: Whether it never moves.
        full: Its number in the full engine; -1 = none.
        joint_count, joint_start: Where its joints are in the pool.
        width, target_start: Where its targets are in the pool.
        radius: Of its disc [m].
        centre: (2, n) of the disc in the root link.
        heights: (2, n) lowest and highest point against the root link.
        place: (3, n) of the root link.
        yaw: Heading [rad], and `half`, (2, n) sine and cosine of half of it.
        tilt: (4, n) orientation of the root link before it is turned by its heading.
        twist: (3, n) vx, vy, wz along the heading.
        pace: How fast [m/s] it may become before the next look, at most.
        is_harsh: Whether it is asked for more than it can do flat.
    """

    def __init__(self) -> None:
        self.tier: IntColumn = np.zeros(FIRST, np.intp)
        self.is_auto: BoolColumn = np.zeros(FIRST, np.bool_)
        self.is_held: BoolColumn = np.zeros(FIRST, np.bool_)
        self.is_static: BoolColumn = np.zeros(FIRST, np.bool_)
        self.full: IntColumn = np.full(FIRST, -1, np.intp)
        self.joint_count: IntColumn = np.zeros(FIRST, np.intp)
        self.joint_start: IntColumn = np.zeros(FIRST, np.intp)
        self.width: IntColumn = np.zeros(FIRST, np.intp)
        self.target_start: IntColumn = np.zeros(FIRST, np.intp)
        self.radius: FloatArray = np.zeros(FIRST)
        self.centre: FloatArray = np.zeros((2, FIRST))
        self.heights: FloatArray = np.zeros((2, FIRST))
        self.place: FloatArray = np.zeros((3, FIRST))
        self.yaw: FloatArray = np.zeros(FIRST)
        self.half: FloatArray = np.zeros((2, FIRST))
        self.tilt: FloatArray = np.zeros((4, FIRST))
        self.twist: FloatArray = np.zeros((3, FIRST))
        self.pace: FloatArray = np.zeros(FIRST)
        self.is_harsh: BoolColumn = np.zeros(FIRST, np.bool_)
        self._free = list(range(FIRST))

    def take(self) -> int:
        """Take the lowest row that is free, all zeros."""
        if not self._free:
            self._grow()
        row = heapq.heappop(self._free)
        for column in vars(self).values():
            if isinstance(column, np.ndarray):
                column[..., row] = 0
        self.full[row] = -1
        return row

    def give_back(self, row: int) -> None:
        """Free a row."""
        self.tier[row] = Tier.NONE
        heapq.heappush(self._free, row)

    def turn_to(self, at: At, yaw: FloatArray) -> None:
        """Set headings."""
        self.yaw[at] = yaw
        half = yaw * 0.5
        self.half[0, at] = np.sin(half)
        self.half[1, at] = np.cos(half)

    def headings(self, at: At) -> tuple[FloatArray, FloatArray]:
        """Find cosines and sines (n,) of headings."""
        sin, cos = self.half[0, at], self.half[1, at]
        return cos * cos - sin * sin, 2.0 * sin * cos

    def discs(self, at: At) -> FloatArray:
        """Find the centres (n, 2) of discs in the world."""
        x, y = self.centre[0, at], self.centre[1, at]
        found = np.empty((len(x), 2))
        found[:, 0], found[:, 1] = self.place[0, at], self.place[1, at]
        if x.any() or y.any():
            right, up = turned(x, y, self.headings(at))
            found[:, 0] += right
            found[:, 1] += up
        return found

    def states(self, at: At) -> FloatArray:
        """Compose the state rows (n, 13) of kinematic bodies."""
        sin, cos = self.half[0, at], self.half[1, at]
        x, y, z, w = (self.tilt[k, at] for k in range(4))
        vx, vy = turned(self.twist[0, at], self.twist[1, at], self.headings(at))
        found = np.zeros((len(x), 13))
        # All at once: number by number would go through memory thirteen times.
        found.T[:9] = [
            *(self.place[k, at] for k in range(3)),
            *(cos * x - sin * y, cos * y + sin * x, cos * z + sin * w, cos * w - sin * z),
            *(vx, vy),
        ]
        found[:, 12] = self.twist[2, at]
        return found

    def _grow(self) -> None:
        size = len(self.tier)
        self._free = list(range(size, 2 * size))
        for name, column in vars(self).items():
            if isinstance(column, np.ndarray):
                setattr(self, name, np.concatenate([column, np.zeros_like(column)], axis=-1))


def at_rows(rows: IntColumn) -> At:
    """Say where rows are: those that follow one another are reached several times as fast."""
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1 and bool((np.diff(rows) == 1).all()):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def turned(
    x: FloatArray, y: FloatArray, heading: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Turn vectors (n,), (n,) by headings, given as their cosines and sines."""
    cos, sin = heading
    return cos * x - sin * y, sin * x + cos * y


class Pool:
    """Numbers of bodies, each body's in a row; room that was given back is used again."""

    def __init__(self) -> None:
        self.numbers: FloatArray = np.zeros(FIRST)
        self._end = 0
        self._free: dict[int, list[int]] = {}

    def take(self, count: int) -> int:
        """Find room for so many; it is the caller's to fill."""
        if free := self._free.get(count):
            return heapq.heappop(free)
        start, self._end = self._end, self._end + count
        while self._end > len(self.numbers):
            self.numbers = np.concatenate([self.numbers, np.zeros_like(self.numbers)])
        return start

    def give_back(self, start: int, count: int) -> None:
        """Free what was taken."""
        heapq.heappush(self._free.setdefault(count, []), start)


def spans(starts: IntColumn, counts: IntColumn) -> IntColumn:
    """List the numbers of spans, one after another."""
    total = int(counts.sum())
    shifts = np.repeat(starts - (np.cumsum(counts) - counts), counts)
    return np.asarray(np.arange(total) + shifts)
