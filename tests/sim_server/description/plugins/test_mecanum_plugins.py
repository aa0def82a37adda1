"""Plug-ins of Gazebo Classic for mecanum wheels."""

import pytest

from tests.sim_server.description.plugins.driven_robots import a_four_wheeler
from tests.sim_server.description.robots import a_plugin, mentions
from zensim.proto.messages.drive_messages import OmniDrive
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

FILENAME = "libgazebo_ros_mecanum_drive.so"
ROS_1 = """
  <LeftFront>fl</LeftFront><RightFront>fr</RightFront><LeftRear>rl</LeftRear>
  <RightRear>rr</RightRear><WheelSeparationW>0.4</WheelSeparationW>
  <WheelSeparationL>0.5</WheelSeparationL><wheelDiameter>0.2</wheelDiameter>
  <WheelTorque>3</WheelTorque><odometryRate>10</odometryRate><publishOdom>false</publishOdom>
  <isRollerModel>true</isRollerModel><robotBaseFrame>base</robotBaseFrame>
"""
ROS_2 = """
  <front_left_joint>fl</front_left_joint><front_right_joint>fr</front_right_joint>
  <back_left_joint>rl</back_left_joint><back_right_joint>rr</back_right_joint>
  <max_wheel_torque>3</max_wheel_torque><robot_base_frame>base</robot_base_frame>
"""


@pytest.mark.parametrize("tags", [ROS_1, ROS_2])
def test_mecanum_plugin_turns_its_wheels_as_rollers_need(tags: str) -> None:
    model = read_urdf(a_four_wheeler(a_plugin(FILENAME, tags)))

    drive = model.drive
    assert isinstance(drive, OmniDrive)
    assert drive.wheel_joints == ("fl", "fr", "rl", "rr")
    assert [round(one.left, 6) for one in drive.wheels] == [-10.0, 10.0, 10.0, -10.0]
    assert [round(one.turn, 6) for one in drive.wheels] == [-4.5, 4.5, -4.5, 4.5]
    assert drive.max_torque_nm == 3.0
    assert not [entry for entry in model.report if entry.status == "unknown"]


def test_mecanum_plugin_has_the_rates_of_ros_1() -> None:
    drive = read_urdf(a_four_wheeler(a_plugin(FILENAME, ROS_1))).drive

    assert isinstance(drive, OmniDrive)
    assert (drive.odometry_rate_hz, drive.publish_odom) == (10.0, False)


def test_mecanum_plugin_is_no_drive_when_a_wheel_is_missing() -> None:
    tags = ROS_2.replace("<back_left_joint>rl</back_left_joint>", "")

    model = read_urdf(a_four_wheeler(a_plugin(FILENAME, tags)))

    assert model.drive is None
    assert mentions(model.report, "suspicious", "no drive: 3 wheels")
