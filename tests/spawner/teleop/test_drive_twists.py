"""Twists by what drives can do."""

import pytest

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    Limits,
    OmniDrive,
    PlanarMove,
    SteeringDrive,
    TricycleDrive,
)
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.spawner.teleop.drive_twists import (
    MAX_TRICYCLE_STEER_RAD,
    USUAL_SPEED_M_S,
    USUAL_TURN_RAD_S,
    DriveStyle,
    Speeds,
    find_drive_style,
    find_full_speeds,
    make_twist,
)
from zensim.spawner.teleop.key_bindings import Direction


@pytest.mark.parametrize(
    ("drive", "style"),
    [
        (DiffDrive(), DriveStyle()),
        (PlanarMove(), DriveStyle(is_holonomic=True)),
        (OmniDrive(), DriveStyle(is_holonomic=True)),
        (SteeringDrive(), DriveStyle(is_steered=True)),
        (AckermannDrive(max_steer=0.4), DriveStyle(is_steered=True, max_angle_rad=0.4)),
        (TricycleDrive(), DriveStyle(is_steered=True, max_angle_rad=MAX_TRICYCLE_STEER_RAD)),
    ],
)
def test_style_is_that_of_the_drive(drive: Drive, style: DriveStyle) -> None:
    assert find_drive_style(drive) == style


def test_twist_is_the_direction_at_the_speeds() -> None:
    twist = make_twist(Direction(ahead=-0.5, turn=1.0), Speeds(0.6, 2.0), DriveStyle())

    assert twist == Twist(Vector3(x=-0.3), Vector3(z=2.0))


@pytest.mark.parametrize(("is_holonomic", "left_mps"), [(False, 0.0), (True, 0.6)])
def test_only_holonomic_robots_move_sideways(*, is_holonomic: bool, left_mps: float) -> None:
    twist = make_twist(Direction(left=1.0), Speeds(0.6), DriveStyle(is_holonomic=is_holonomic))

    assert twist == Twist(Vector3(y=left_mps))


def test_steering_angle_is_no_greater_than_the_drive_allows() -> None:
    style = DriveStyle(is_steered=True, max_angle_rad=0.4)

    assert make_twist(Direction(turn=-1.0), Speeds(0.5, 1.0), style).angular.z == -0.4
    assert make_twist(Direction(turn=-1.0), Speeds(0.5, 0.1), style).angular.z == -0.1


def test_speeds_are_scaled_apart() -> None:
    assert Speeds(0.5, 1.0).scale(2.0, 0.5) == Speeds(1.0, 0.5)
    assert Speeds(0.5, 1.0, 0.2).scale(2.0, 0.5) == Speeds(1.0, 0.5, 0.4)


@pytest.mark.parametrize(
    ("drive", "speeds"),
    [
        (DiffDrive(linear_limits=Limits(max_velocity=0.3)), Speeds(0.3, USUAL_TURN_RAD_S)),
        (
            OmniDrive(lateral_limits=Limits(max_velocity=0.2)),
            Speeds(USUAL_SPEED_M_S, USUAL_TURN_RAD_S, 0.2),
        ),
        (PlanarMove(), Speeds(USUAL_SPEED_M_S, USUAL_TURN_RAD_S)),
        (AckermannDrive(max_speed=0.7, max_steer=0.4), Speeds(0.7, 0.4)),
        (TricycleDrive(), Speeds(USUAL_SPEED_M_S, MAX_TRICYCLE_STEER_RAD)),
    ],
    ids=lambda one: type(one).__name__,
)
def test_full_speeds_are_those_that_the_drive_permits(drive: Drive, speeds: Speeds) -> None:
    assert find_full_speeds(drive) == speeds
