"""Rate limiter on simulation time or on a monotonic clock."""

from zensim.proto.messages.standard_messages import NANOSECONDS

SLACK_NS = 1000
"""A step is a whole number of nanoseconds, so 3/240 s can be shorter than 1/80 s by a few."""


class RateLimiter:
    """Opens `rate_hz` times a second on average; at each new time if the rate is 0.

    Calls come at times of their own: it opens at the first call that is due. The next due time is a
    multiple of the period from the first, unless calls are late by more than a period.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NANOSECONDS / rate_hz) if rate_hz > 0.0 else 0
        self.opened_ns: int | None = None
        """Time of the last opening; None before the first."""
        self.due_ns = 0
        """Time of the next opening; any before the first."""

    def reset(self) -> None:
        """Open at the next call: time may have gone back."""
        self.opened_ns = None

    def is_due(self, time_ns: int) -> bool:
        """Open if due."""
        return self.elapsed_s(time_ns) is not None

    def elapsed_s(self, time_ns: int) -> float | None:
        """Open if due: return the time [s] since the last opening, at first one period, or None."""
        opened_ns = self.opened_ns
        if opened_ns is None:
            opened_ns, self.due_ns = time_ns - self._period_ns, time_ns
        elif time_ns <= opened_ns or time_ns + SLACK_NS < self.due_ns:
            return None
        self.opened_ns = time_ns
        self.due_ns += self._period_ns
        if self.due_ns <= time_ns:
            self.due_ns = time_ns + self._period_ns
        return (time_ns - opened_ns) / NANOSECONDS
