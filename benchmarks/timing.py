"""Timing of short calls: the median of many repeats, and their spread."""

import gc
from collections.abc import Callable
from time import perf_counter

import msgspec

MICROSECONDS = 1e6


class Timing(msgspec.Struct, frozen=True):
    """Wall time of one call [us]."""

    median_us: float
    low_us: float
    """A tenth of the repeats were faster."""
    high_us: float
    """A tenth of the repeats were slower."""

    def __str__(self) -> str:
        return f"{self.median_us:.2f} ({self.low_us:.2f} to {self.high_us:.2f})"


def measure(call: Callable[[], object], repeats: int, inner: int) -> Timing:
    """Time `repeats` runs of `inner` calls each, after one run that is not counted.

    The garbage collector is disabled, so that no call pays for the garbage of others.
    """
    was_collecting = gc.isenabled()
    gc.disable()
    try:
        _run(call, inner)
        each_us = sorted(_run(call, inner) for _ in range(repeats))
    finally:
        if was_collecting:
            gc.enable()
    return Timing(quantile(each_us, 0.5), quantile(each_us, 0.1), quantile(each_us, 0.9))


def quantile(ordered: list[float], share: float) -> float:
    """Compute a quantile of sorted numbers."""
    return ordered[round(share * (len(ordered) - 1))]


def _run(call: Callable[[], object], inner: int) -> float:
    start = perf_counter()
    for _ in range(inner):
        call()
    return (perf_counter() - start) / inner * MICROSECONDS
