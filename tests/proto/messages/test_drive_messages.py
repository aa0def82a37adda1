"""Actuators of each drive."""

import msgspec
import pytest

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    Actuator,
    DiffDrive,
    Drive,
    PlanarMove,
    TricycleDrive,
    WheelPair,
)
from zensim.proto.messages.model_messages import Link, Model

FRONT = WheelPair("front_left", "front_right", 0.4, 0.2)
REAR = WheelPair("rear_left", "rear_right", 0.6, 0.1)


def joints_of(drive: Drive) -> list[tuple[str, str]]:
    return [(actuator.mode, actuator.joint) for actuator in drive.actuators]


def test_diff_drive_has_left_before_right_pair_by_pair() -> None:
    drive = DiffDrive((FRONT, REAR), max_torque_nm=3.0)

    assert drive.actuators == tuple(
        Actuator("velocity", name, 3.0)
        for name in ("front_left", "front_right", "rear_left", "rear_right")
    )
    assert drive.joints == drive.wheel_joints == tuple(a.joint for a in drive.actuators)


def test_planar_move_has_the_body() -> None:
    assert PlanarMove().actuators == (Actuator("twist"),)
    assert PlanarMove().joints == ()


def test_car_drives_behind_and_steers_in_front() -> None:
    assert joints_of(AckermannDrive()) == [
        ("velocity", "rear_left_joint"),
        ("velocity", "rear_right_joint"),
        ("position", "left_steering_joint"),
        ("position", "right_steering_joint"),
    ]


def test_car_turns_its_steering_wheel_when_it_has_one() -> None:
    drive = AckermannDrive(steering_wheel_joint="wheel")

    assert joints_of(drive)[-1] == ("position", "wheel")
    assert len(drive.joints) == 7


@pytest.mark.parametrize(("speed", "mode"), [(0.0, "position"), (1.0, "velocity")])
def test_tricycle_steers_by_speed_when_that_is_limited(speed: float, mode: str) -> None:
    assert joints_of(TricycleDrive(max_steering_speed=speed)) == [
        ("velocity", "front_wheel_joint"),
        (mode, "front_steering_joint"),
    ]


@pytest.mark.parametrize(
    ("drive", "encoder"),
    [
        (DiffDrive((FRONT, REAR), odometry_source="encoder"), FRONT),
        (DiffDrive((FRONT,)), None),
        (DiffDrive(odometry_source="encoder"), None),
        (PlanarMove(odometry_source="encoder"), None),
        (AckermannDrive(odometry_source="encoder"), None),
        (
            TricycleDrive(odometry_source="encoder"),
            WheelPair("left_wheel_joint", "right_wheel_joint", 0.5, 0.15),
        ),
        (TricycleDrive(), None),
    ],
)
def test_drive_counts_wheels_when_it_has_some_to_count(
    drive: Drive, encoder: WheelPair | None
) -> None:
    assert drive.encoder == encoder


@pytest.mark.parametrize("drive", [DiffDrive(), PlanarMove(), AckermannDrive(), TricycleDrive()])
def test_drive_is_decoded_by_its_kind(drive: Drive) -> None:
    model = Model("m", (Link("base"),), drive=drive)

    assert msgspec.msgpack.decode(msgspec.msgpack.encode(model), type=Model).drive == drive
