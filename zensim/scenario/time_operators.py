"""Time operators of checks on margins: always, eventually, and held for a time; on arrays.

A margin is positive where a condition is true. Each operator keeps the worst that could still
be mended, sample by sample, for several robots at once; the values are those of signal temporal
logic with discrete samples.
"""

import math
from abc import ABC, abstractmethod
from collections import deque

import msgspec
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
TIME_TOLERANCE_S = 1e-6
"""Time by which a sample may miss the end of an interval."""


class MarginResult(msgspec.Struct, frozen=True):
    """Margin of a check so far: the worst over robots, and when it was."""

    margin: float
    """Positive = true; -inf = not yet, nan = never looked at."""
    time: float = math.nan
    """Simulated seconds since the start."""
    row: int = -1
    """Row of the robot."""


NOT_EVALUATED = MarginResult(math.nan)


class TimeOperator(ABC):
    """An operator over an interval of samples."""

    @abstractmethod
    def update(self, now: float, margins: FloatArray) -> None:
        """Take the margins of all robots at a time, (m,); times increase."""

    @abstractmethod
    def result(self) -> MarginResult:
        """Find the margin from the samples so far."""

    @abstractmethod
    def is_decided(self, now: float) -> bool:
        """Whether later samples cannot change the result."""


class Always(TimeOperator):
    """True at each sample from `start` to `end` [s]."""

    def __init__(self, start: float = 0.0, end: float = math.inf) -> None:
        self._start, self._end = start, end
        self._worst = NOT_EVALUATED

    def update(self, now: float, margins: FloatArray) -> None:
        """Keep the worst."""
        if not self._start - TIME_TOLERANCE_S <= now <= self._end + TIME_TOLERANCE_S:
            return
        row = int(np.argmin(margins))
        if not self._worst.margin <= margins[row]:
            self._worst = MarginResult(float(margins[row]), now, row)

    def result(self) -> MarginResult:
        """Return the worst sample."""
        return self._worst

    def is_decided(self, now: float) -> bool:
        """Whether the interval is over."""
        return now > self._end + TIME_TOLERANCE_S


class Eventually(TimeOperator):
    """True for each robot at some sample from `start` to `end` [s], and then for `hold` [s]."""

    def __init__(self, start: float, end: float, hold: float = 0.0) -> None:
        self._start, self._end, self._hold = start, end, hold
        self._window: deque[tuple[float, FloatArray]] = deque()
        self._best: FloatArray | None = None
        self._times: FloatArray | None = None

    def update(self, now: float, margins: FloatArray) -> None:
        """Keep the best of the windows that are complete."""
        last = self._end + self._hold + TIME_TOLERANCE_S
        if not self._start - TIME_TOLERANCE_S <= now <= last:
            return
        if self._best is None or self._times is None:
            self._best = np.full(len(margins), -math.inf)
            self._times = np.full(len(margins), math.nan)
        self._window.append((now, np.array(margins)))
        while self._window and now - self._window[0][0] >= self._hold - TIME_TOLERANCE_S:
            value = np.min([one for _, one in self._window], axis=0)
            begun, _ = self._window.popleft()
            if begun <= self._end + TIME_TOLERANCE_S:
                is_better = value > self._best
                self._times = np.where(is_better, now, self._times)
                self._best = np.where(is_better, value, self._best)

    def result(self) -> MarginResult:
        """Return the worst robot's best."""
        if self._best is None or self._times is None:
            return NOT_EVALUATED
        row = int(np.argmin(self._best))
        return MarginResult(float(self._best[row]), float(self._times[row]), row)

    def is_decided(self, now: float) -> bool:
        """Whether the interval and what follows it are over."""
        return now > self._end + self._hold + TIME_TOLERANCE_S


def combine_results(results: list[MarginResult]) -> MarginResult:
    """Find the worst of several results; none = not evaluated."""
    looked_at = [one for one in results if not math.isnan(one.margin)]
    return min(looked_at, key=lambda one: one.margin, default=NOT_EVALUATED)
