"""When a rate limiter opens."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.rate_limiter import RateLimiter

MS = 1_000_000


def openings(limiter: RateLimiter, period_ns: int, count: int) -> list[int]:
    return [i * period_ns for i in range(count) if limiter.elapsed_s(i * period_ns) is not None]


def test_limiter_opens_at_once_with_one_period_elapsed() -> None:
    assert RateLimiter(100.0).elapsed_s(5 * MS) == pytest.approx(0.01)


def test_limiter_opens_at_each_call_when_the_rate_is_zero() -> None:
    limiter = RateLimiter(0.0)

    elapsed = [limiter.elapsed_s(time_ns) for time_ns in (0, 3 * MS, 4 * MS)]

    assert elapsed == pytest.approx([0.0, 0.003, 0.001])


def test_limiter_opens_every_period() -> None:
    assert openings(RateLimiter(100.0), 5 * MS, 7) == [0, 10 * MS, 20 * MS, 30 * MS]


def test_limiter_opens_always_when_states_come_less_often_than_its_rate() -> None:
    assert len(openings(RateLimiter(100.0), 12_500_001, 80)) == 80


def test_limiter_opens_when_a_state_comes_a_few_nanoseconds_early() -> None:
    assert len(openings(RateLimiter(80.0), 12_499_998, 80)) == 80


def test_limiter_returns_the_elapsed_time_when_its_period_ends_between_states() -> None:
    limiter = RateLimiter(30.0)

    elapsed = [limiter.elapsed_s(i * 12_500_000) for i in range(7)]

    assert elapsed == [pytest.approx(1 / 30), None, None, 0.0375, None, None, 0.0375]


def test_limiter_does_not_open_twice_at_one_moment() -> None:
    limiter = RateLimiter(0.0)
    limiter.elapsed_s(MS)

    assert limiter.elapsed_s(MS) is None


def test_limiter_opens_once_after_a_long_time_without_calls() -> None:
    limiter = RateLimiter(100.0)
    limiter.elapsed_s(0)

    assert limiter.elapsed_s(1000 * MS) == pytest.approx(1.0)
    assert limiter.elapsed_s(1005 * MS) is None
    assert limiter.elapsed_s(1010 * MS) == pytest.approx(0.01)


def test_limiter_opens_at_once_when_it_was_reset_and_time_went_back() -> None:
    limiter = RateLimiter(10.0)
    limiter.elapsed_s(1000 * MS)

    limiter.reset()

    assert limiter.elapsed_s(0) == pytest.approx(0.1)


@given(rate_hz=st.floats(1.0, 75.0))
def test_limiter_keeps_its_rate_on_average(rate_hz: float) -> None:
    count = len(openings(RateLimiter(rate_hz), 12_500_000, 8000))

    assert count == pytest.approx(100.0 * rate_hz, abs=2.0)


@given(
    gaps_ns=st.lists(st.integers(0, 40 * MS), min_size=1, max_size=300),
    rate_hz=st.sampled_from([100.0, 30.0, 2.0]),
)
def test_limiter_never_opens_more_often_than_its_rate(gaps_ns: list[int], rate_hz: float) -> None:
    limiter, now_ns, moments = RateLimiter(rate_hz), 1000 * MS, []

    for gap_ns in gaps_ns:
        now_ns += gap_ns
        if limiter.is_due(now_ns):
            moments.append(now_ns)

    # The first two may be closer than a period: due times keep their grid.
    span_s = (moments[-1] - moments[0]) / 1e9 if moments else 0.0
    assert len(moments) <= span_s * rate_hz + 2.0
