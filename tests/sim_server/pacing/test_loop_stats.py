"""Meter: figures of the last window, sums since the start."""

import pytest

from zensim.sim_server.pacing.loop_stats import LoopStats

SECOND = 1_000_000_000
MILLISECOND = 1_000_000


def note_steps(loop_stats: LoopStats, count: int, *, took_ns: int, late_ns: int = 0) -> None:
    for _ in range(count):
        loop_stats.note_step(simulated_ns=4 * MILLISECOND, took_ns=took_ns, late_ns=late_ns)


def test_meter_keeps_its_window_open_for_a_second() -> None:
    meter = LoopStats(7)
    note_steps(meter, 10, took_ns=MILLISECOND)

    is_closed = meter.close_window(7 + SECOND - 1)

    assert not is_closed
    assert meter.real_time_factor == 0.0


def test_meter_tells_figures_of_the_window() -> None:
    meter = LoopStats(0)
    note_steps(meter, 99, took_ns=MILLISECOND)
    note_steps(meter, 1, took_ns=11 * MILLISECOND, late_ns=3 * MILLISECOND)

    is_closed = meter.close_window(2 * SECOND)

    assert is_closed
    assert meter.real_time_factor == pytest.approx(0.2)
    assert meter.step_time_s == pytest.approx(0.0011)
    assert meter.step_time_max_s == pytest.approx(0.011)
    assert meter.late_max_s == pytest.approx(0.003)


def test_meter_begins_each_window_anew() -> None:
    meter = LoopStats(0)
    note_steps(meter, 100, took_ns=9 * MILLISECOND, late_ns=9 * MILLISECOND)
    meter.close_window(SECOND)

    note_steps(meter, 50, took_ns=MILLISECOND)
    meter.close_window(2 * SECOND)

    assert meter.real_time_factor == pytest.approx(0.2)
    assert meter.step_time_max_s == pytest.approx(0.001)
    assert meter.late_max_s == 0.0


def test_meter_tells_zeros_when_nothing_was_stepped() -> None:
    meter = LoopStats(0)
    note_steps(meter, 10, took_ns=MILLISECOND)
    meter.close_window(SECOND)

    meter.close_window(2 * SECOND)

    assert (meter.real_time_factor, meter.step_time_s, meter.step_time_max_s) == (0.0, 0.0, 0.0)


def test_meter_keeps_its_sums_when_a_window_closes() -> None:
    meter = LoopStats(0)
    meter.slipped_ns, meter.requests = 5, 6

    meter.close_window(SECOND)

    assert (meter.slipped_ns, meter.requests) == (5, 6)


def test_parted_work_gets_a_quarter_of_a_step_but_no_less_than_it_asks_for() -> None:
    meter = LoopStats(0)

    quick = meter.work_budget_ns(2_000_000)
    meter.step_time_s = 0.1

    assert (quick, meter.work_budget_ns(2_000_000)) == (2_000_000, 25_000_000)


def test_meter_adds_up_what_holds_a_step_up_and_takes_off_the_time_of_each_step() -> None:
    meter = LoopStats(0)

    for busy in (10, 6, 3):
        meter.note_turn(busy_ns=busy * MILLISECOND, paced_ns=4 * MILLISECOND)
    meter.close_window(SECOND)

    assert meter.busy_max_s == pytest.approx(0.012)


def test_meter_forgets_what_was_held_up_once_nothing_is_due() -> None:
    meter = LoopStats(0)

    for paced_ns in (4 * MILLISECOND, 0, 4 * MILLISECOND):
        meter.note_turn(busy_ns=9 * MILLISECOND, paced_ns=paced_ns)
    meter.close_window(SECOND)

    assert meter.busy_max_s == pytest.approx(0.009)
    meter.close_window(2 * SECOND)
    assert meter.busy_max_s == 0.0
