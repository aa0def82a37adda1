"""Conversion of simulation time to seconds and nanoseconds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.messages.standard_messages import Time, ns_from_time, time_from_ns


@pytest.mark.parametrize(
    ("time_ns", "time"),
    [
        (0, Time(0, 0)),
        (4_000_000, Time(0, 4_000_000)),
        (999_999_999, Time(0, 999_999_999)),
        (1_000_000_000, Time(1, 0)),
        (-1, Time(-1, 999_999_999)),
    ],
)
def test_time_splits_into_seconds_and_nanoseconds(time_ns: int, time: Time) -> None:
    assert time_from_ns(time_ns) == time
    assert ns_from_time(time) == time_ns


@given(time_ns=st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_time_round_trip_keeps_nanoseconds(time_ns: int) -> None:
    time = time_from_ns(time_ns)

    assert ns_from_time(time) == time_ns
    assert 0 <= time.nanosec < 10**9
    assert -(2**31) <= time.sec < 2**31
