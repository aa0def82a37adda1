"""Arrays with a row per robot: remapping of rows when robots come and go, and rate limiters."""

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.rate_limiter import SLACK_NS

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
NEW_ROW = -1
"""Stands for a row that was not there before."""


def remap_floats(column: FloatArray, before: IntArray, fresh: float = 0.0) -> FloatArray:
    """Cut a column anew.

    Args:
        column: (n, ...).
        before: Where each of the rows-to-be was, or `NEW_ROW`; (m,).
        fresh: What new rows hold.
    """
    out = np.full((len(before), *column.shape[1:]), fresh)
    is_kept = before != NEW_ROW
    out[is_kept] = column[before[is_kept]]
    return out


def remap_ints(column: IntArray, before: IntArray) -> IntArray:
    """Cut a column of whole numbers anew; new rows hold 0."""
    out = np.zeros((len(before), *column.shape[1:]), dtype=np.int64)
    is_kept = before != NEW_ROW
    out[is_kept] = column[before[is_kept]]
    return out


def remap_flags(column: BoolArray, before: IntArray) -> BoolArray:
    """Cut a column of flags anew; new rows are False."""
    out = np.zeros(len(before), dtype=np.bool_)
    is_kept = before != NEW_ROW
    out[is_kept] = column[before[is_kept]]
    return out


class GroupRateLimiter:
    """A gate a row, all of one rate; each has a beat of its own."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NANOSECONDS / rate_hz) if rate_hz > 0.0 else 0
        self._has_opened = np.zeros(0, dtype=np.bool_)
        self._opened_ns = np.zeros(0, dtype=np.int64)
        self._due_ns = np.zeros(0, dtype=np.int64)

    def remap(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self._has_opened = remap_flags(self._has_opened, before)
        self._opened_ns = remap_ints(self._opened_ns, before)
        self._due_ns = remap_ints(self._due_ns, before)

    def reset(self) -> None:
        """Forget when any was open."""
        self._has_opened[:] = False

    def open(self, time_ns: int) -> tuple[IntArray, FloatArray]:
        """Open those that are due.

        Returns:
            Their rows (m,), and the time [s] since each was open last, one period at first.
        """
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
        return rows, elapsed_s
