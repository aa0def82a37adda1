"""Rate limiters in rows open as single ones do."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zensim.proto.rate_limiter import RateLimiter
from zensim.robot_agent.robot_rows import GroupRateLimiter, remap_floats

RATES = [0.0, 7.0, 30.0, 50.0, 80.0, 100.0]
STEPS = st.lists(st.sampled_from([0, 4_166_667, 12_500_000, 10_000_000, 1]), max_size=60)


@pytest.mark.parametrize("rate_hz", RATES)
@settings(max_examples=25)
@given(st.lists(STEPS, min_size=1, max_size=4))
def test_rows_open_as_single_rate_limiters_do(rate_hz: float, courses: list[list[int]]) -> None:
    limiters, singles, time_ns = GroupRateLimiter(rate_hz), [], 0
    # Each course begins with a robot more.
    for course in courses:
        singles.append(RateLimiter(rate_hz))
        limiters.remap(np.array([*range(len(singles) - 1), -1], dtype=np.int64))
        for step_ns in course:
            time_ns += step_ns
            expected = {
                row: elapsed_s
                for row, single in enumerate(singles)
                if (elapsed_s := single.elapsed_s(time_ns)) is not None
            }
            rows, elapsed = limiters.open(time_ns)
            assert dict(zip(rows.tolist(), elapsed.tolist(), strict=True)) == expected


def test_rows_forget_openings_at_a_reset() -> None:
    limiters = GroupRateLimiter(10.0)
    limiters.remap(np.array([-1, -1], dtype=np.int64))
    limiters.open(10**9)

    limiters.reset()

    assert limiters.open(0)[0].tolist() == [0, 1]


def test_rows_keep_their_openings_when_remapped() -> None:
    limiters = GroupRateLimiter(10.0)
    limiters.remap(np.array([-1], dtype=np.int64))
    limiters.open(0)
    limiters.remap(np.array([-1, 0], dtype=np.int64))

    assert limiters.open(50_000_000)[0].tolist() == [0]
    assert limiters.open(100_000_000)[0].tolist() == [1]


def test_rows_that_stay_keep_their_values_and_new_ones_are_zero() -> None:
    column, before = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([1, -1, 0], dtype=np.int64)

    assert remap_floats(column, before).tolist() == [[3.0, 4.0], [0.0, 0.0], [1.0, 2.0]]
    assert remap_floats(column, before, 7.0)[1].tolist() == [7.0, 7.0]
