"""Rate gates of many robots: each opens as `robot_agent.rate_gate.RateGate` does."""

import numpy as np

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.robot_agent.pool.rows import FloatArray, IntArray, carried_flags, carried_ints
from zensim.robot_agent.rate_gate import SLACK_NS


class RateGates:
    """A gate a row, all of one rate; each has a beat of its own."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NANOSECONDS / rate_hz) if rate_hz > 0.0 else 0
        self._has_opened = np.zeros(0, dtype=np.bool_)
        self._opened_ns = np.zeros(0, dtype=np.int64)
        self._due_ns = np.zeros(0, dtype=np.int64)

    def recut(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self._has_opened = carried_flags(self._has_opened, before)
        self._opened_ns = carried_ints(self._opened_ns, before)
        self._due_ns = carried_ints(self._due_ns, before)

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
