"""When a gate opens."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.rate_limiter import RateLimiter

MS = 1_000_000


def openings(gate: RateLimiter, period_ns: int, count: int) -> list[int]:
    return [i * period_ns for i in range(count) if gate.elapsed_s(i * period_ns) is not None]


def test_gate_opens_at_once_with_one_period_elapsed() -> None:
    assert RateLimiter(100.0).elapsed_s(5 * MS) == pytest.approx(0.01)


def test_gate_opens_whenever_asked_when_the_rate_is_zero() -> None:
    gate = RateLimiter(0.0)

    elapsed = [gate.elapsed_s(time_ns) for time_ns in (0, 3 * MS, 4 * MS)]

    assert elapsed == pytest.approx([0.0, 0.003, 0.001])


def test_gate_opens_every_period() -> None:
    assert openings(RateLimiter(100.0), 5 * MS, 7) == [0, 10 * MS, 20 * MS, 30 * MS]


def test_gate_opens_always_when_states_come_less_often_than_its_rate() -> None:
    assert len(openings(RateLimiter(100.0), 12_500_001, 80)) == 80


def test_gate_opens_when_a_state_comes_a_few_nanoseconds_early() -> None:
    assert len(openings(RateLimiter(80.0), 12_499_998, 80)) == 80


def test_gate_tells_the_time_that_passed_when_its_beat_lies_between_states() -> None:
    gate = RateLimiter(30.0)

    elapsed = [gate.elapsed_s(i * 12_500_000) for i in range(7)]

    assert elapsed == [pytest.approx(1 / 30), None, None, 0.0375, None, None, 0.0375]


def test_gate_does_not_open_twice_at_one_moment() -> None:
    gate = RateLimiter(0.0)
    gate.elapsed_s(MS)

    assert gate.elapsed_s(MS) is None


def test_gate_opens_once_when_it_was_not_asked_for_long() -> None:
    gate = RateLimiter(100.0)
    gate.elapsed_s(0)

    assert gate.elapsed_s(1000 * MS) == pytest.approx(1.0)
    assert gate.elapsed_s(1005 * MS) is None
    assert gate.elapsed_s(1010 * MS) == pytest.approx(0.01)


def test_gate_opens_at_once_when_it_was_reset_and_time_went_back() -> None:
    gate = RateLimiter(10.0)
    gate.elapsed_s(1000 * MS)

    gate.reset()

    assert gate.elapsed_s(0) == pytest.approx(0.1)


@given(rate_hz=st.floats(1.0, 75.0))
def test_gate_keeps_its_rate_on_average(rate_hz: float) -> None:
    count = len(openings(RateLimiter(rate_hz), 12_500_000, 8000))

    assert count == pytest.approx(100.0 * rate_hz, abs=2.0)
