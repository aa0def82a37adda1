"""A car's rear wheels and steering, by the rules of Gazebo's plug-in."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.proto.drives.single_drive import SingleDrive
from zensim.proto.messages.drive_messages import AckermannDrive

CAR = AckermannDrive(wheel_radius_m=0.1, wheelbase_m=1.0, track_m=0.6, max_speed=5.0, max_steer=0.6)
STRAIGHT = (0.0,) * 5


def targets(speed: float, steer: float, drive: AckermannDrive = CAR) -> tuple[float, ...]:
    return SingleDrive(drive).update(speed, steer, positions=STRAIGHT)


@pytest.mark.parametrize(
    ("speed", "rim"), [(0.0, 0.0), (1.0, 10.0), (-1.0, -10.0), (9.0, 50.0), (-1e308, -50.0)]
)
def test_car_limits_its_speed(speed: float, rim: float) -> None:
    assert targets(speed, 0.0) == pytest.approx((rim, rim, 0.0, 0.0))


@pytest.mark.parametrize(
    ("speed", "asked", "steer"),
    [
        (1.0, 0.3, 0.3),
        (1.0, -0.3, -0.3),
        (1.0, 2.0, 0.6),
        (1.0, -2.0, -0.6),
        (0.0, 0.3, 0.3),
        (-1.0, 0.3, -0.3),
    ],
)
def test_car_takes_the_turn_as_its_steering_angle(speed: float, asked: float, steer: float) -> None:
    left, right = targets(speed, asked)[2:]

    tan = math.tan(steer)
    assert left == pytest.approx(math.atan2(tan, 1.0 - 0.3 * tan))
    assert right == pytest.approx(math.atan2(tan, 1.0 + 0.3 * tan))


def test_inner_wheels_of_a_car_turn_more_and_roll_less() -> None:
    left_rim, right_rim, left, right = targets(1.0, 0.4)

    assert left > right > 0.0
    assert 0.0 < left_rim < 10.0 < right_rim


def test_car_turns_its_steering_wheel_with_its_front_wheels() -> None:
    drive = AckermannDrive(steering_wheel_joint="wheel", max_steer=0.5, max_steering_angle=5.0)

    found = SingleDrive(drive).update(positions=(0.0, 0.0, 0.2, 0.1, 0.0))

    assert found[4] == pytest.approx(1.5)


def test_car_keeps_targets_finite_when_it_may_steer_beyond_a_right_angle() -> None:
    far = AckermannDrive(max_steer=3.0)

    assert all(map(math.isfinite, targets(1e308, math.pi / 2.0, far)))


@given(steer=st.floats(-0.6, 0.6), speed=st.floats(0.1, 5.0))
def test_car_has_one_turning_circle_for_all_wheels(steer: float, speed: float) -> None:
    left_rim, right_rim, left, right = targets(speed, steer)

    curvature = math.tan(steer)
    assert (left_rim + right_rim) / 2.0 == pytest.approx(speed / 0.1)
    assert (right_rim - left_rim) * 0.1 / 0.6 == pytest.approx(speed * curvature, abs=1e-9)
    # Each front wheel is across the line from it to the centre, which is on the rear axle.
    assert math.tan(left) * (1.0 - 0.3 * curvature) == pytest.approx(curvature, abs=1e-9)
    assert math.tan(right) * (1.0 + 0.3 * curvature) == pytest.approx(curvature, abs=1e-9)
