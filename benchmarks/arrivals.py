"""Rates and gaps of messages in a window of time, by their arrivals."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True)
class ArrivalWindow:
    """The interval from one wall time to another."""

    begin_s: float
    end_s: float

    def rate_hz(self, times_s: Sequence[float]) -> float:
        """Count the arrivals in the window, over all of its time."""
        return len(self._within(times_s)) / (self.end_s - self.begin_s)

    def longest_gap_s(self, times_s: Sequence[float]) -> float:
        """Find the longest time without an arrival, also at the begin and at the end."""
        bounded = (self.begin_s, *self._within(times_s), self.end_s)
        return max(after - before for before, after in pairwise(bounded))

    def _within(self, times_s: Sequence[float]) -> list[float]:
        return [one for one in times_s if self.begin_s <= one <= self.end_s]
