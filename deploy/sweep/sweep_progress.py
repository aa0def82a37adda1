"""Progress of a sweep: runs that have ended, their pace, and the time that is left."""

import msgspec


class SweepProgress(msgspec.Struct, frozen=True):
    """Counts of a sweep.

    Attributes:
        total: Runs of the sweep.
        before: Runs that had ended before it was started now.
        ended: Runs that have ended since.
        failed: Runs that failed, of all.
        elapsed_s: Wall time since the first run of now started.
    """

    total: int
    before: int
    failed: int = 0
    ended: int = 0
    elapsed_s: float = 0.0

    @property
    def done(self) -> int:
        """Runs that have ended."""
        return self.before + self.ended

    @property
    def per_minute(self) -> float:
        """Runs per minute of wall time."""
        return 60.0 * self.ended / self.elapsed_s if self.elapsed_s > 0.0 else 0.0

    @property
    def left_s(self) -> float | None:
        """Wall time that the other runs take at this pace; None before the first has ended."""
        pace = self.per_minute / 60.0
        return (self.total - self.done) / pace if pace else None

    def add(self, *, is_passed: bool, elapsed_s: float) -> "SweepProgress":
        """Count a run that has ended."""
        return msgspec.structs.replace(
            self, ended=self.ended + 1, failed=self.failed + (not is_passed), elapsed_s=elapsed_s
        )

    def __str__(self) -> str:
        left = "" if self.left_s is None else f", {write_duration(self.left_s)} left"
        pace = f", {self.per_minute:.0f} runs/min" if self.ended else ""
        return f"{self.done}/{self.total} done, {self.failed} failed{pace}{left}"


def write_duration(seconds: float) -> str:
    """Write a wall time in hours, minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
