"""Loop statistics: values of the last window, totals since the start."""

import pytest

from zensim.sim_server.pacing.loop_stats import LoopStats

SECOND = 1_000_000_000
MILLISECOND = 1_000_000


def note_steps(loop_stats: LoopStats, count: int, *, took_ns: int, late_ns: int = 0) -> None:
    for _ in range(count):
        loop_stats.note_step(simulated_ns=4 * MILLISECOND, took_ns=took_ns, late_ns=late_ns)


def test_stats_have_a_window_of_one_second() -> None:
    loop_stats = LoopStats(7)
    note_steps(loop_stats, 10, took_ns=MILLISECOND)

    is_closed = loop_stats.close_window(7 + SECOND - 1)

    assert not is_closed
    assert loop_stats.real_time_factor == 0.0


def test_stats_contain_the_values_of_the_window() -> None:
    loop_stats = LoopStats(0)
    note_steps(loop_stats, 99, took_ns=MILLISECOND)
    note_steps(loop_stats, 1, took_ns=11 * MILLISECOND, late_ns=3 * MILLISECOND)

    is_closed = loop_stats.close_window(2 * SECOND)

    assert is_closed
    assert loop_stats.real_time_factor == pytest.approx(0.2)
    assert loop_stats.step_time_s == pytest.approx(0.0011)
    assert loop_stats.step_time_max_s == pytest.approx(0.011)
    assert loop_stats.late_max_s == pytest.approx(0.003)


def test_stats_restart_with_each_window() -> None:
    loop_stats = LoopStats(0)
    note_steps(loop_stats, 100, took_ns=9 * MILLISECOND, late_ns=9 * MILLISECOND)
    loop_stats.close_window(SECOND)

    note_steps(loop_stats, 50, took_ns=MILLISECOND)
    loop_stats.close_window(2 * SECOND)

    assert loop_stats.real_time_factor == pytest.approx(0.2)
    assert loop_stats.step_time_max_s == pytest.approx(0.001)
    assert loop_stats.late_max_s == 0.0


def test_stats_are_zero_without_steps() -> None:
    loop_stats = LoopStats(0)
    note_steps(loop_stats, 10, took_ns=MILLISECOND)
    loop_stats.close_window(SECOND)

    loop_stats.close_window(2 * SECOND)

    assert (loop_stats.real_time_factor, loop_stats.step_time_s, loop_stats.step_time_max_s) == (
        0.0,
        0.0,
        0.0,
    )


def test_stats_keep_their_totals_when_a_window_closes() -> None:
    loop_stats = LoopStats(0)
    loop_stats.slipped_ns, loop_stats.requests = 5, 6

    loop_stats.close_window(SECOND)

    assert (loop_stats.slipped_ns, loop_stats.requests) == (5, 6)


def test_work_budget_is_a_quarter_of_a_step_or_the_minimum() -> None:
    loop_stats = LoopStats(0)

    quick = loop_stats.work_budget_ns(2_000_000)
    loop_stats.step_time_s = 0.1

    assert (quick, loop_stats.work_budget_ns(2_000_000)) == (2_000_000, 25_000_000)


def test_stats_accumulate_delays_minus_the_time_of_each_step() -> None:
    loop_stats = LoopStats(0)

    for busy in (10, 6, 3):
        loop_stats.note_turn(busy_ns=busy * MILLISECOND, paced_ns=4 * MILLISECOND)
    loop_stats.close_window(SECOND)

    assert loop_stats.busy_max_s == pytest.approx(0.012)


def test_stats_drop_delays_when_nothing_is_due() -> None:
    loop_stats = LoopStats(0)

    for paced_ns in (4 * MILLISECOND, 0, 4 * MILLISECOND):
        loop_stats.note_turn(busy_ns=9 * MILLISECOND, paced_ns=paced_ns)
    loop_stats.close_window(SECOND)

    assert loop_stats.busy_max_s == pytest.approx(0.009)
    loop_stats.close_window(2 * SECOND)
    assert loop_stats.busy_max_s == 0.0
