"""Each kind of drive has its controller."""

import pytest

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    PlanarMove,
    TricycleDrive,
    WheelPair,
)
from zensim.proto.messages.standard_messages import Twist
from zensim.robot_agent.drives.choice import controller_of
from zensim.robot_agent.drives.controller import Measured


@pytest.mark.parametrize(
    "drive",
    [
        DiffDrive((WheelPair("l", "r"),)),
        PlanarMove(),
        AckermannDrive(),
        AckermannDrive(steering_wheel_joint="w"),
        TricycleDrive(),
        TricycleDrive(max_steering_speed=1.0),
    ],
)
def test_controller_has_a_number_for_each_that_the_actuators_take(drive: Drive) -> None:
    joints = sum(1 for actuator in drive.actuators if actuator.joint)
    measured = Measured((0.0,) * joints, (0.0,) * joints)

    found = controller_of(drive).update(Twist(), measured=measured, elapsed_s=0.01)

    assert found == (0.0,) * sum(actuator.width for actuator in drive.actuators)
