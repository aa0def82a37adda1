"""A velocity that is bounded, and changes no faster than it may."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.messages.drive_messages import Limits
from zensim.robot_agent.drives.twist_limits import LimitedVelocity


def test_velocity_is_what_is_wanted_when_nothing_limits_it() -> None:
    assert LimitedVelocity(Limits()).update(1e9, 0.01) == 1e9


@pytest.mark.parametrize(("wanted", "found"), [(0.3, 0.3), (9.0, 1.0), (-9.0, -0.5)])
def test_velocity_stays_within_its_bounds(wanted: float, found: float) -> None:
    limited = LimitedVelocity(Limits(min_velocity=-0.5, max_velocity=1.0))

    assert limited.update(wanted, 0.01) == found


def test_velocity_changes_no_faster_than_it_may() -> None:
    limited = LimitedVelocity(Limits(min_acceleration=-4.0, max_acceleration=2.0))

    assert limited.update(1.0, 0.1) == pytest.approx(0.2)
    assert limited.update(1.0, 0.1) == pytest.approx(0.4)
    assert limited.update(-1.0, 0.2) == pytest.approx(-0.4)


def test_velocity_starts_from_standing_when_it_is_reset() -> None:
    limited = LimitedVelocity(Limits(max_acceleration=1.0))
    limited.update(1.0, 0.5)

    limited.reset()

    assert limited.update(1.0, 0.1) == pytest.approx(0.1)


@given(st.lists(st.floats(-5.0, 5.0), max_size=20))
def test_velocity_never_leaves_its_bounds(wishes: list[float]) -> None:
    limited = LimitedVelocity(Limits(-1.0, 2.0, -3.0, 3.0))
    before = 0.0
    for wish in wishes:
        now = limited.update(wish, 0.1)
        assert -1.0 <= now <= 2.0
        assert abs(now - before) <= 0.3 + 1e-12
        before = now
