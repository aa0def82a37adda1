"""How long a wait is said to have been."""

import pytest

from benchmarks.lateness import PERIOD_S, Lateness


def came(*whens: tuple[float, float]) -> Lateness:
    found = Lateness()
    for now_s, time_s in whens:
        found.note(now_s, time_s)
    return found


def test_longest_is_how_much_later_than_its_simulation_time_a_state_came() -> None:
    lateness = came((10.0, 0.0), (10.1, 0.1), (10.5, 0.2), (10.6, 0.3))

    assert lateness.longest_ms(10.0, 10.6) == pytest.approx(300.0)


def test_longest_passes_over_what_was_before() -> None:
    lateness = came((10.0, 0.0), (10.5, 0.1), (10.6, 0.2), (10.7, 0.3))

    assert lateness.longest_ms(10.55, 10.7) == pytest.approx(0.0)


def test_longest_counts_a_state_that_had_not_come_at_the_end() -> None:
    lateness = came((10.0, 0.0), (10.1, 0.1), (13.0, 0.2))

    assert lateness.longest_ms(10.0, 12.1) == pytest.approx(2000.0 - PERIOD_S * 1e3)


def test_longest_is_refused_when_nothing_came_before_the_end() -> None:
    with pytest.raises(IndexError):
        came((10.0, 0.0)).longest_ms(8.0, 9.0)
