"""Rates and gaps of messages that begin late, end early, or do not come."""

import pytest

from benchmarks.arrivals import ArrivalWindow

WINDOW = ArrivalWindow(100.0, 160.0)


def come(begin_s: float, end_s: float, hz: float = 20.0) -> list[float]:
    return [begin_s + number / hz for number in range(1, round((end_s - begin_s) * hz) + 1)]


def test_steady_messages_have_their_rate_and_their_period() -> None:
    times_s = come(100.0, 160.0)

    assert WINDOW.rate_hz(times_s) == pytest.approx(20.0)
    assert WINDOW.longest_gap_s(times_s) == pytest.approx(0.05)


def test_messages_that_end_early_count_over_the_whole_window() -> None:
    times_s = come(100.0, 102.0)

    assert WINDOW.rate_hz(times_s) == pytest.approx(20.0 * 2.0 / 60.0)
    assert WINDOW.longest_gap_s(times_s) == pytest.approx(58.0)


def test_messages_that_begin_late_count_over_the_whole_window() -> None:
    times_s = come(145.0, 160.0)

    assert WINDOW.rate_hz(times_s) == pytest.approx(5.0)
    assert WINDOW.longest_gap_s(times_s) == pytest.approx(45.05)


def test_gap_in_the_middle_is_found() -> None:
    times_s = come(100.0, 120.0) + come(123.0, 160.0)

    assert WINDOW.longest_gap_s(times_s) == pytest.approx(3.05)


def test_without_messages_the_gap_is_the_window() -> None:
    assert WINDOW.rate_hz([]) == 0.0
    assert WINDOW.longest_gap_s([]) == pytest.approx(60.0)


def test_messages_outside_the_window_do_not_count() -> None:
    times_s = [99.0, 130.0, 161.0]

    assert WINDOW.rate_hz(times_s) == pytest.approx(1.0 / 60.0)
    assert WINDOW.longest_gap_s(times_s) == pytest.approx(30.0)
