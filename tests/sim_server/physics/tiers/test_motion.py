"""Arcs and drives against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_box, a_cart, a_fork
from tests.sim_server.physics.tiers.flat import shipped
from zensim.sim_server.physics.tiers.footprint import corners_in
from zensim.sim_server.physics.tiers.motion import arcs, rolling_speeds, twists_by_steering
from zensim.sim_server.physics.tiers.vehicle import NotFlat, Vehicle, vehicle_of

speeds = st.floats(-3.0, 3.0)
turns = st.floats(-40.0, 40.0)
angles = st.floats(-math.pi, math.pi)


def vehicle(name: str) -> Vehicle:
    return vehicle_of(shipped(name), corners_in(""), 9.81)[0]


def an_arc(yaw: float, twist: tuple[float, float, float], dt_s: float) -> np.ndarray:
    heading = (np.array([math.cos(yaw)]), np.array([math.sin(yaw)]))
    return arcs(heading, np.array(twist)[:, None], dt_s)[:, 0]


@given(yaw=angles, ahead=speeds, left=speeds, turn=turns, dt_s=st.floats(0.001, 0.1))
def test_arc_ends_where_many_small_straight_ways_end(
    yaw: float, ahead: float, left: float, turn: float, dt_s: float
) -> None:
    count = 20_000
    middles = yaw + turn * dt_s * (np.arange(count) + 0.5) / count
    x = np.sum(ahead * np.cos(middles) - left * np.sin(middles)) * dt_s / count
    y = np.sum(ahead * np.sin(middles) + left * np.cos(middles)) * dt_s / count

    found = an_arc(yaw, (ahead, left, turn), dt_s)

    assert found == pytest.approx([x, y, turn * dt_s], abs=1e-6)


@given(ahead=speeds, turn=st.floats(-1e-4, 1e-4))
def test_arc_is_smooth_where_it_is_nearly_straight(ahead: float, turn: float) -> None:
    found = an_arc(0.0, (ahead, 0.0, turn), 0.02)

    assert found == pytest.approx(
        [ahead * 0.02, ahead * turn * 0.02**2 / 2.0, turn * 0.02], abs=1e-12
    )


def test_two_wheels_turn_a_robot_by_their_distance_and_radius() -> None:
    model = vehicle_of(a_cart(), corners_in(""), 9.81)[0]

    found = np.array(model.matrix).reshape(3, 2) @ [4.0, 6.0]

    assert found == pytest.approx([5.0 * 0.05, 0.0, 2.0 * 0.05 / 0.3], abs=1e-12)


def test_car_turns_about_the_point_that_all_its_axles_go_through() -> None:
    model = vehicle("car_bot")
    curvature, ahead, radius, base, half = 1.2, 0.5, 0.05, 0.3, 0.1
    inner = np.arctan2(base * curvature, 1.0 - curvature * half)
    outer = np.arctan2(base * curvature, 1.0 + curvature * half)
    rims = ahead * np.array([[1.0 - curvature * half, 1.0 + curvature * half]]) / radius

    twist = twists_by_steering(model, rims, np.array([[inner, outer]]))
    rolling = rolling_speeds(model, twist, np.array([[inner, outer]]))[0]

    turn = ahead * curvature
    assert twist[:, 0] == pytest.approx([ahead, turn * 0.15, turn], abs=1e-9)
    left, right = (math.hypot(base, 1.0 / curvature - y) * turn / radius for y in (half, -half))
    assert rolling == pytest.approx([left, right], rel=1e-9)


@given(angle=st.floats(-math.pi / 2.0, math.pi / 2.0), rim=st.floats(0.1, 2.0))
def test_tricycle_goes_as_its_front_wheel_pulls(angle: float, rim: float) -> None:
    model = vehicle("trike_bot")

    twist = twists_by_steering(model, np.array([[rim / 0.05]]), np.array([[angle]]))[:, 0]

    turn = rim * math.sin(angle) / 0.3
    assert twist == pytest.approx([rim * math.cos(angle), turn * 0.1, turn], abs=1e-6)


@pytest.mark.parametrize(
    ("model", "reason"), [(a_box(), "no drive"), (a_fork(), "never moves")], ids=str
)
def test_vehicle_is_none_of_what_cannot_drive(model: object, reason: str) -> None:
    with pytest.raises(NotFlat, match=reason):
        vehicle_of(model, corners_in(""), 9.81)  # type: ignore[arg-type]
