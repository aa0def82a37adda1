"""Rate limiter in simulation time."""

from zensim.proto.messages.standard_messages import NANOSECONDS

SLACK_NS = 1000
"""A step is a whole number of nanoseconds, so 3/240 s can fall short of 1/80 s by a few."""


class RateLimiter:
    """Opens `rate_hz` times a second; 0 = whenever asked.

    States come on their own grid: it opens at the first one that is due, and stays on its own beat,
    so that the rate is right on average whatever the grid is.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(NANOSECONDS / rate_hz) if rate_hz > 0.0 else 0
        self._opened_ns: int | None = None
        self._due_ns = 0

    def reset(self) -> None:
        """Forget when it was open."""
        self._opened_ns = None

    def elapsed_s(self, time_ns: int) -> float | None:
        """Open if due: return the time [s] since it opened last, one period at first, else None."""
        opened_ns = self._opened_ns
        if opened_ns is None:
            opened_ns, self._due_ns = time_ns - self._period_ns, time_ns
        elif time_ns <= opened_ns or time_ns + SLACK_NS < self._due_ns:
            return None
        self._opened_ns = time_ns
        self._due_ns += self._period_ns
        if self._due_ns <= time_ns:
            self._due_ns = time_ns + self._period_ns
        return (time_ns - opened_ns) / NANOSECONDS
