"""Steering by turn rate against numbers worked out by hand."""

import math

import pytest

from tests.proto.drives.single_drive import SingleDrive
from zensim.proto.messages.drive_messages import SteeringDrive

CAR = SteeringDrive(
    traction=("rl", "rr"),
    steering=("sl", "sr"),
    wheel_radius_m=0.1,
    wheelbase_m=1.0,
    traction_track_m=0.6,
    steering_track_m=0.8,
)
BICYCLE = SteeringDrive(traction=("w",), steering=("s",), wheel_radius_m=0.1, wheelbase_m=1.0)
TRICYCLE = SteeringDrive(
    traction=("w",), steering=("s",), is_traction_steered=True, wheel_radius_m=0.1, wheelbase_m=0.5
)


def targets(drive: SteeringDrive, speed: float, turn: float) -> tuple[float, ...]:
    zeros = (0.0,) * len(drive.actuators)
    return SingleDrive(drive).update(speed, turn, positions=zeros, velocities=zeros)


def test_car_steers_about_one_point() -> None:
    left, right, steer_left, steer_right = targets(CAR, 1.0, 0.5)

    # The centre is 2 m to the left of the driven axle.
    assert (left, right) == pytest.approx((10.0 * 1.7 / 2.0, 10.0 * 2.3 / 2.0))
    assert steer_left == pytest.approx(math.atan2(1.0, 2.0 - 0.4))
    assert steer_right == pytest.approx(math.atan2(1.0, 2.0 + 0.4))


TWO_AXLES = SteeringDrive(
    traction=("fl", "fr", "rl", "rr"),
    steering=("sfl", "sfr"),
    counter_steering=("srl", "srr"),
    wheel_radius_m=0.1,
    wheelbase_m=0.5,
    traction_track_m=0.8,
    steering_track_m=0.6,
)


@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_two_axles_steer_about_one_point_beside_their_middle(speed: float) -> None:
    numbers = targets(TWO_AXLES, speed, 0.5)
    fl, fr, rl, rr = numbers[:4]
    steer_fl, steer_fr, steer_rl, steer_rr = numbers[4:]

    # The centre is 2 m beside the middle; pivots are 0.3 m, wheels 0.4 m from the middle line.
    bend = math.copysign(0.5, speed)
    assert steer_fl == pytest.approx(math.atan(bend * 0.5 / (1.0 - bend * 0.3)))
    assert steer_fr == pytest.approx(math.atan(bend * 0.5 / (1.0 + bend * 0.3)))
    assert (steer_rl, steer_rr) == (-steer_fl, -steer_fr)
    inner, outer = math.hypot(0.25, 1.0 - 0.15) - 0.05, math.hypot(0.25, 1.0 + 0.15) + 0.05
    expected = (inner, outer) if speed > 0.0 else (-outer, -inner)
    assert (fl * 0.1, fr * 0.1) == pytest.approx(expected)
    assert (rl, rr) == (fl, fr)


def test_car_keeps_its_turn_rate_in_reverse() -> None:
    left, right, steer_left, _ = targets(CAR, -1.0, 0.5)

    assert (left, right) == pytest.approx((-10.0 * 2.3 / 2.0, -10.0 * 1.7 / 2.0))
    assert steer_left < 0.0


def test_car_stands_still_without_speed() -> None:
    assert targets(CAR, 0.0, 0.0) == (0.0, 0.0, 0.0, 0.0)
    assert targets(CAR, 0.0, 1.0)[:2] == (0.0, 0.0)


def test_bicycle_steers_to_the_curvature() -> None:
    assert targets(BICYCLE, 1.0, 0.5) == pytest.approx((10.0, math.atan(0.5)))


def test_steering_behind_the_driven_axle_turns_to_the_other_side() -> None:
    behind = SteeringDrive(traction=("w",), steering=("s",), wheel_radius_m=0.1, wheelbase_m=-1.0)

    assert targets(behind, 1.0, 0.5) == pytest.approx((10.0, -math.atan(0.5)))


@pytest.mark.parametrize(("speed", "turn"), [(0.3, 0.8), (-0.3, 0.8), (0.3, -0.8)])
def test_driven_steered_wheel_has_the_speed_of_its_point(speed: float, turn: float) -> None:
    wheel, angle = targets(TRICYCLE, speed, turn)

    rim = wheel * 0.1
    assert rim * math.cos(angle) == pytest.approx(speed)
    assert rim * math.sin(angle) == pytest.approx(turn * 0.5)


def test_driven_steered_wheel_keeps_the_speed_of_its_direction_at_the_limit() -> None:
    limited = SteeringDrive(
        traction=("w",), steering=("s",), is_traction_steered=True, wheel_radius_m=0.1,
        wheelbase_m=0.5, max_steer=0.5,
    )  # fmt: skip

    assert targets(limited, 0.0, 1.0) == pytest.approx((5.0 * math.sin(0.5), 0.5))
