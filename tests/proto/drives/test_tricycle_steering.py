"""A tricycle's wheel and steering, by the rules of Gazebo's plug-in."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.proto.drives.single_drive import SingleDrive
from zensim.proto.messages.drive_messages import TricycleDrive

RADIUS = 0.1
AT_REST = (0.0, 0.0)


def a_tricycle(**limits: float) -> SingleDrive:
    return SingleDrive(TricycleDrive(actuated_wheel_diameter_m=2.0 * RADIUS, **limits))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("speed", "angle", "expected"),
    [
        (0.0, 0.0, (0.0, 0.0)),
        (0.5, 0.3, (5.0, 0.3)),
        (-0.5, -0.3, (-5.0, -0.3)),
        (0.1, 3.0, (1.0, math.pi / 2.0)),
        (0.1, -3.0, (1.0, -math.pi / 2.0)),
    ],
)
def test_tricycle_takes_rim_speed_and_steering_angle(
    speed: float, angle: float, expected: tuple[float, float]
) -> None:
    drive = a_tricycle()
    drive.reset()

    found = drive.update(speed, angle, positions=AT_REST, velocities=AT_REST, dt_s=0.01)

    assert found == pytest.approx(expected)


@pytest.mark.parametrize(
    ("wanted", "current", "expected"),
    [(5.0, 0.0, 0.2), (5.0, 4.9, 5.0), (0.0, 5.0, 4.6), (-5.0, 0.0, -0.4), (5.0, 4.995, 5.0)],
)
def test_tricycle_limits_acceleration_and_deceleration(
    wanted: float, current: float, expected: float
) -> None:
    drive = a_tricycle(max_acceleration=20.0, max_deceleration=40.0)
    positions, velocities = (0.0, 0.0), (current, 0.0)

    found = drive.update(wanted * RADIUS, positions=positions, velocities=velocities, dt_s=0.01)

    assert found[0] == pytest.approx(expected)


def test_tricycle_has_no_limit_on_the_side_that_is_zero() -> None:
    drive = a_tricycle(max_acceleration=20.0)
    positions, velocities = (0.0, 0.0), (5.0, 0.0)

    assert drive.update(0.0, positions=positions, velocities=velocities, dt_s=0.01)[0] == 0.0


@pytest.mark.parametrize(
    ("angle", "current", "expected"),
    [(0.5, 0.0, 2.0), (-0.5, 0.0, -2.0), (0.5, 0.495, 0.0), (0.5, 0.515, -1.5), (9.0, 0.0, 2.0)],
)
def test_tricycle_steers_at_its_speed_until_the_angle_is_reached(
    angle: float, current: float, expected: float
) -> None:
    drive = a_tricycle(max_steering_speed=2.0, angle_tolerance=0.01)
    positions, velocities = (0.0, current), (0.0, 0.0)

    found = drive.update(1.0, angle, positions=positions, velocities=velocities, dt_s=0.01)

    assert found[1] == pytest.approx(expected)


@given(st.floats(-1e308, 1e308), st.floats(-1e308, 1e308))
def test_tricycle_keeps_targets_finite(speed: float, angle: float) -> None:
    drive = a_tricycle(max_acceleration=1.0, max_deceleration=1.0, max_steering_speed=1.0)

    found = drive.update(speed, angle, positions=AT_REST, velocities=AT_REST, dt_s=0.01)

    assert all(map(math.isfinite, found))


def test_tricycle_does_not_steer_when_no_time_has_gone() -> None:
    drive = a_tricycle(max_steering_speed=1.0)

    assert drive.update(0.0, 1.0, positions=AT_REST, velocities=AT_REST, dt_s=0.0)[1] == 0.0
