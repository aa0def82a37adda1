"""Timing itself, and that the codec's benchmark runs."""

import gc

import pytest

from benchmarks.bench_codec import rows
from benchmarks.timing import Timing, measure


def test_measure_calls_once_more_than_it_counts() -> None:
    calls: list[int] = []

    timing = measure(lambda: calls.append(1), repeats=5, inner=3)

    assert len(calls) == 18
    assert 0.0 < timing.low_us <= timing.median_us <= timing.high_us


def test_measure_lets_the_garbage_collector_rest() -> None:
    seen: set[bool] = set()

    measure(lambda: seen.add(gc.isenabled()), repeats=1, inner=1)

    assert seen == {False}
    assert gc.isenabled()


def test_measure_wakes_the_garbage_collector_when_a_call_fails() -> None:
    with pytest.raises(ZeroDivisionError):
        measure(lambda: 1 // 0, repeats=1, inner=1)

    assert gc.isenabled()


def test_timing_is_written_with_its_spread() -> None:
    assert str(Timing(2.0, 1.5, 3.25)) == "2.00 (1.50 to 3.25)"


def test_codec_benchmark_measures_odometry_first() -> None:
    row = next(rows(is_short=True))

    assert (row.message, row.format, row.size_bytes) == ("Odometry", "CDR", 740)
    assert row.encode.median_us > 0.0
