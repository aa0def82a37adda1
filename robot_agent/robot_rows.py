"""Arrays with a row per robot: states, rows when robots come and go, and rate limiters."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.rate_limiter import SLACK_NS, RateLimiter

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
ALL_ROWS = slice(None)
NEW_ROW = -1
"""Former row of a robot that is new."""


def remap_floats(column: FloatArray, before: IntArray, fresh: float = 0.0) -> FloatArray:
    """Rearrange the rows of a column.

    Args:
        column: (n, ...).
        before: Former row of each new row, or `NEW_ROW`; (m,).
        fresh: Value of new rows.
    """
    out = np.full((len(before), *column.shape[1:]), fresh)
    is_kept = before != NEW_ROW
    out[is_kept] = column[before[is_kept]]
    return out


def remap_ints(column: IntArray, before: IntArray) -> IntArray:
    """Rearrange the rows of a column of integers; new rows are 0."""
    out = np.zeros((len(before), *column.shape[1:]), dtype=np.int64)
    is_kept = before != NEW_ROW
    out[is_kept] = column[before[is_kept]]
    return out


def remap_flags(column: BoolArray, before: IntArray) -> BoolArray:
    """Rearrange the rows of a column of flags; new rows are False."""
    out = np.zeros(len(before), dtype=np.bool_)
    is_kept = before != NEW_ROW
    out[is_kept] = column[before[is_kept]]
    return out


def take_rows(column: FloatArray, rows: IntArray) -> FloatArray:
    """Select ascending rows of a column (n, ...); all of them are the column itself, not a copy."""
    return column if len(rows) == len(column) else column[rows]


def find_index(rows: IntArray, count: int) -> IntArray | slice:
    """Find the faster index of ascending rows of `count`."""
    return ALL_ROWS if len(rows) == count else rows


def intersect_rows(rows: IntArray, others: IntArray, count: int) -> IntArray:
    """Find the ascending rows of `count` that are in both."""
    if len(others) == count:
        return rows
    return others if len(rows) == count else np.intersect1d(rows, others, assume_unique=True)


@dataclass(frozen=True)
class RowPlaces:
    """Where the numbers of a group's rows are in an array of its pool.

    Attributes:
        places: (n,) or (n, k) indices.
        span: The same if each is one more than the last: numpy then copies nothing.
    """

    places: IntArray
    span: slice | None

    def read(self, array: FloatArray) -> FloatArray:
        """Select the numbers (n, ...) or (n, k, ...)."""
        if self.span is None:
            return array[self.places]
        return array[self.span].reshape(*self.places.shape, *array.shape[1:])

    def write(self, array: FloatArray, values: FloatArray) -> None:
        """Write the numbers into an array (m,)."""
        if self.span is None:
            array[self.places] = values
        else:
            array[self.span] = values.reshape(-1)


def make_row_places(places: IntArray) -> RowPlaces:
    """Find out whether places follow each other."""
    flat = places.reshape(-1)
    is_span = len(flat) > 0 and bool((np.diff(flat) == 1).all())
    return RowPlaces(places, slice(int(flat[0]), int(flat[-1]) + 1) if is_span else None)


@dataclass(frozen=True)
class StateRows:
    """States of robots with equal joints at one step, a row each."""

    time_ns: int
    base: FloatArray
    """States of the root links, (n, STATE_COLUMNS)."""
    positions: FloatArray
    """Positions of all joints [rad or m], (n, joints)."""
    velocities: FloatArray
    """[rad/s or m/s]."""
    efforts: FloatArray | None = None
    """[N m or N]; None if the server does not report them."""

    def remap(self, before: IntArray) -> "StateRows":
        """Rearrange the rows, without efforts; new ones are NaN. See `remap_floats`."""
        columns = (self.base, self.positions, self.velocities)
        return StateRows(self.time_ns, *(remap_floats(one, before, np.nan) for one in columns))


class KeptRows:
    """A copy of columns, updated by rows: each row has the values of its last `keep`.

    Arrays are shared, not copied, while all rows are updated at once, which is the usual case.
    """

    def __init__(self, columns: int) -> None:
        """Keep no row of so many columns."""
        self.values: FloatArray = np.zeros((0, columns))
        """(n, columns); read only."""
        self._is_shared = False
        """Whether others have the array, too."""

    def remap(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        self.values, self._is_shared = remap_floats(self.values, before), False

    def keep(self, rows: IntArray, columns: FloatArray) -> None:
        """Keep ascending rows of columns (n, ...); the caller does not change them later."""
        if len(rows) == len(columns):
            self.values, self._is_shared = columns, True
        elif len(rows):
            if self._is_shared:
                self.values, self._is_shared = self.values.copy(), False
            self.values[rows] = columns[rows]


class GroupRateLimiter:
    """A rate limiter per row, all of one rate; see `RateLimiter`.

    Rows share a single one while they open at the same times, as they mostly do.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._period_ns = round(NANOSECONDS / rate_hz) if rate_hz > 0.0 else 0
        self._shared: RateLimiter | None = RateLimiter(rate_hz)
        """None while rows differ; else the arrays of openings are of no use."""
        self._rows = np.zeros(0, dtype=np.int64)
        """All of them."""
        self._elapsed_s = np.zeros(0)
        """Time since the last opening of all rows, when they shared it last."""
        self._has_opened = np.zeros(0, dtype=np.bool_)
        self._opened_ns = np.zeros(0, dtype=np.int64)
        self._due_ns = np.zeros(0, dtype=np.int64)

    def remap(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        is_new = before == NEW_ROW
        if is_new.all():
            self._shared = RateLimiter(self._rate_hz)
        elif self._shared is None or (self._shared.opened_ns is not None and is_new.any()):
            self._divide()
            self._has_opened = remap_flags(self._has_opened, before)
            self._opened_ns = remap_ints(self._opened_ns, before)
            self._due_ns = remap_ints(self._due_ns, before)
        self._rows = np.arange(len(before))
        self._elapsed_s = np.zeros(0)

    def reset(self, rows: IntArray | slice = ALL_ROWS) -> None:
        """Forget the last openings."""
        if isinstance(rows, slice):
            self._shared = RateLimiter(self._rate_hz)
        else:
            self._divide()
            self._has_opened[rows] = False

    def save(self) -> tuple[BoolArray, IntArray, IntArray]:
        """Copy the openings of all rows."""
        self._divide()
        return self._has_opened.copy(), self._opened_ns.copy(), self._due_ns.copy()

    def load(self, saved: tuple[BoolArray, IntArray, IntArray]) -> None:
        """Put back what `save` returned."""
        self._divide()
        self._has_opened[:], self._opened_ns[:], self._due_ns[:] = saved

    def open(self, time_ns: int) -> tuple[IntArray, FloatArray]:
        """Open the rows that are due.

        Returns:
            Their rows (m,), and the time [s] since their last opening, one period at first; others
            get the same arrays.
        """
        if (shared := self._shared) is None:
            return self._open_rows(time_ns)
        elapsed_s = shared.elapsed_s(time_ns)
        if elapsed_s is None:
            return self._rows[:0], self._elapsed_s[:0]
        found = self._elapsed_s
        if not len(found) or found[0] != elapsed_s:
            found = self._elapsed_s = np.full(len(self._rows), elapsed_s)
        return self._rows, found

    def _divide(self) -> None:
        """Give each row an opening of its own."""
        if (shared := self._shared) is None:
            return
        count, opened_ns = len(self._rows), shared.opened_ns
        self._has_opened = np.full(count, opened_ns is not None)
        self._opened_ns = np.full(count, opened_ns or 0, dtype=np.int64)
        self._due_ns = np.full(count, shared.due_ns, dtype=np.int64)
        self._shared = None

    def _open_rows(self, time_ns: int) -> tuple[IntArray, FloatArray]:
        is_first = ~self._has_opened
        self._opened_ns[is_first] = time_ns - self._period_ns
        self._due_ns[is_first] = time_ns
        is_open = (self._opened_ns < time_ns) & (self._due_ns <= time_ns + SLACK_NS)
        rows = np.flatnonzero(is_open | is_first)
        elapsed_s = (time_ns - self._opened_ns[rows]) / NANOSECONDS
        self._has_opened[rows] = True
        self._opened_ns[rows] = time_ns
        due_ns = self._due_ns[rows] + self._period_ns
        self._due_ns[rows] = np.where(due_ns <= time_ns, time_ns + self._period_ns, due_ns)
        if len(rows) == len(self._rows) and len(rows) and (self._due_ns == self._due_ns[0]).all():
            self._shared = RateLimiter(self._rate_hz)
            self._shared.opened_ns, self._shared.due_ns = time_ns, int(self._due_ns[0])
        return rows, elapsed_s
