"""Targets of actuators."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_box, a_cart, a_controlled_arm, a_fork, a_puck
from zensim.proto.se3 import from_rpy
from zensim.sim_server.physics.actuation import (
    impose_planar_twists,
    make_actuation,
    make_stop_targets,
)

speeds = st.floats(-10.0, 10.0)


def test_wheels_are_found_by_name_among_the_joints() -> None:
    plan = make_actuation(a_cart())

    assert plan.width == 2
    assert plan.speeds.joints == [1, 0]
    assert plan.speeds.efforts == [2.0, 2.0]
    assert plan.speeds.select([7.0, 8.0]) == [7.0, 8.0]
    assert (plan.angles.joints, plan.twist) == ([], None)


def test_speed_and_angle_targets_are_separated() -> None:
    plan = make_actuation(a_fork(effort=9.0))

    assert (plan.speeds.joints, plan.speeds.columns) == ([0], [0])
    assert (plan.angles.joints, plan.angles.columns, plan.angles.efforts) == ([3], [1], [9.0])


def test_twist_has_three_targets() -> None:
    plan = make_actuation(a_puck())

    assert (plan.width, plan.twist) == (3, 0)


def test_body_without_a_drive_has_no_targets() -> None:
    assert make_actuation(a_box()).width == 0
    assert make_stop_targets(a_box(), np.zeros(0)).shape == (0,)


def test_stop_targets_are_zero_speeds_and_current_angles() -> None:
    assert make_stop_targets(a_fork(), np.array([1.0, 2.0, 3.0, 0.3])).tolist() == [0.0, 0.3]
    assert make_stop_targets(a_puck(), np.zeros(0)).tolist() == [0.0, 0.0, 0.0]


@given(st.tuples(*[speeds] * 6), st.tuples(*[speeds] * 3), st.floats(-3.0, 3.0))
def test_imposed_twist_keeps_vertical_and_tilt_velocities(
    velocities: tuple[float, ...], twist: tuple[float, ...], heading: float
) -> None:
    turn = from_rpy(0.0, 0.0, heading)

    (found,) = impose_planar_twists(
        np.array([velocities]), turn[None], np.array([[0.3, -0.1, 0.2]]), np.array([twist])
    )

    assert found[[2, 3, 4]].tolist() == list(velocities[2:5])
    assert found[5] == twist[2]


@given(st.tuples(*[speeds] * 3), st.floats(-3.0, 3.0))
def test_imposed_twist_is_that_of_the_root(twist: tuple[float, ...], heading: float) -> None:
    arm = np.array([0.3, -0.1, 0.2])

    (found,) = impose_planar_twists(
        np.zeros((1, 6)), from_rpy(0.0, 0.0, heading)[None], arm[None], np.array([twist])
    )

    root = found[:3] - np.cross(found[3:], arm)
    assert root[0] == pytest.approx(
        math.cos(heading) * twist[0] - math.sin(heading) * twist[1], abs=1e-9
    )
    assert root[1] == pytest.approx(
        math.sin(heading) * twist[0] + math.cos(heading) * twist[1], abs=1e-9
    )


@pytest.mark.parametrize(
    ("last", "stopped"),
    [
        ((0.0, 0.0), (0.0, 0.0)),
        ((1.0, 0.4), (1.0, 0.4)),
        ((2.0, 0.4), (2.0, 0.0)),
        ((3.0, 0.4), (3.0, 0.0)),
    ],
    ids=["free", "position", "velocity", "effort"],
)
def test_stopped_joint_holds_its_position_and_ends_velocity_and_effort(
    last: tuple[float, float], stopped: tuple[float, float]
) -> None:
    found = make_stop_targets(a_controlled_arm(), np.zeros(1), np.array(last))

    assert tuple(found) == stopped


def test_joint_is_free_after_a_stop_without_targets() -> None:
    assert make_stop_targets(a_controlled_arm(), np.zeros(1)).tolist() == [0.0, 0.0]


def test_motor_of_a_joint_without_limits_is_as_strong_as_any() -> None:
    (motor,) = make_actuation(a_controlled_arm(effort=0.0, velocity=0.0)).joint_motors

    assert min(motor.effort, motor.velocity) > 1e6
