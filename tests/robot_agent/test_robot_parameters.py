"""Parameters of a robot's ROS 2 node, from its description."""

import msgspec
import pytest

from tests.proto.drives.robots_of_each_drive import DRIVES, robot_of
from tests.robot_agent.models import two_wheeler
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.drive_messages import DiffDrive, WheelPair
from zensim.robot_agent.robot_parameters import list_robot_parameters


@pytest.mark.parametrize("drive", DRIVES)
def test_parameters_of_each_drive_are_unique_and_have_values(drive: str) -> None:
    found = list_robot_parameters(Claim(1, "r1", "r1", robot_of(DRIVES[drive]), "<robot/>"))

    names = [one.name for one in found]
    assert len(set(names)) == len(names)
    assert {"entity", "robot_description", "drive.kind"} <= set(names)
    assert all(one.value not in ("", ()) for one in found)


def test_parameters_are_those_of_the_description() -> None:
    drive = DiffDrive(pairs=(WheelPair("l", "r", 0.5, 0.2),), update_rate_hz=50.0)
    model = msgspec.structs.replace(two_wheeler(), drive=drive)

    found = {
        one.name: one.value for one in list_robot_parameters(Claim(1, "r1", "a/b", model, "x"))
    }

    assert found["drive.pairs.0.separation_m"] == 0.5
    assert found["drive.pairs.0.left_joint"] == "l"
    assert found["drive.update_rate_hz"] == 50.0
    assert found["drive.publish_odom"] is False
    assert (found["entity"], found["robot_description"]) == ("r1", "x")
