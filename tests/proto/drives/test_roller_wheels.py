"""Mecanum and omni wheels against numbers worked out by hand."""

import pytest

from tests.proto.drives.single_drive import SingleDrive
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.drives.measured_joints import MeasuredJoints
from zensim.proto.drives.roller_wheels import RollerWheels
from zensim.proto.messages.drive_messages import Limits, OmniDrive, RollerWheel

WHEELS = (RollerWheel("a", 10.0, -10.0, -5.0), RollerWheel("b", 10.0, 10.0, 5.0))


def find(drive: OmniDrive, twist: tuple[float, float, float]) -> tuple[float, ...]:
    kinematics = RollerWheels(drive, FLOAT_MATH)
    found, _ = kinematics.find_targets(
        twist, measured=MeasuredJoints(), state=(0.0,) * kinematics.state_size, dt_s=0.1
    )
    return found


def test_body_takes_the_twist_and_wheels_turn_along() -> None:
    assert find(OmniDrive(wheels=WHEELS), (0.5, 0.2, 1.0)) == pytest.approx(
        (0.5, 0.2, 1.0, 5.0 - 2.0 - 5.0, 5.0 + 2.0 + 5.0)
    )


def test_limits_hold_for_each_direction_and_for_the_wheels() -> None:
    drive = OmniDrive(
        wheels=WHEELS,
        linear_limits=Limits(max_velocity=0.3),
        lateral_limits=Limits(max_acceleration=1.0),
    )

    assert find(drive, (0.5, 0.2, 0.0)) == pytest.approx((0.3, 0.1, 0.0, 2.0, 4.0))


def test_targets_are_finite_for_every_twist() -> None:
    drive = SingleDrive(OmniDrive(wheels=WHEELS))

    assert all(
        abs(target) < 1e9
        for target in drive.update(1e300, 0.0, positions=(0.0, 0.0), velocities=(0.0, 0.0))
    )
