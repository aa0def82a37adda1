"""Plug-ins that apply the twist to the body."""

import pytest

from tests.sim_server.description.robots import a_cart, a_plugin, mentions, subjects
from zensim.proto.messages.drive_messages import PlanarMove, RosBlock
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

PLANAR = "libgazebo_ros_planar_move.so"
BASE = "<robot_base_frame>base</robot_base_frame>"


def test_planar_move_has_gazebos_defaults() -> None:
    model = read_urdf(a_cart(a_plugin(PLANAR, BASE)))

    assert model.drive == PlanarMove(odometry_rate_hz=20.0, robot_base_frame="base")
    assert model.drive.update_rate_hz == 20.0
    assert model.drive.publish_odom
    assert model.drive.publish_odom_tf
    assert subjects(model.report, "applied") == ["plugin 'p'"]


def test_force_based_move_is_a_planar_move() -> None:
    inside = """
      <odometryRate>50</odometryRate><publishOdometryTf>false</publishOdometryTf>
      <force_x_velocity_p_gain>10000</force_x_velocity_p_gain>
    """

    model = read_urdf(a_cart(a_plugin("libgazebo_ros_force_based_move.so", BASE + inside)))

    assert model.drive == PlanarMove(
        odometry_rate_hz=50.0, robot_base_frame="base", publish_odom_tf=False
    )
    assert len(subjects(model.report, "ignored")) == 1


def test_planar_move_has_the_written_parameters() -> None:
    inside = """
      <ros><remapping>cmd_vel:=go</remapping></ros>
      <update_rate>50</update_rate><publish_rate>10</publish_rate>
      <publish_odom>false</publish_odom><publish_odom_tf>false</publish_odom_tf>
      <odometry_frame>o</odometry_frame><covariance_x>0.5</covariance_x>
    """

    drive = read_urdf(a_cart(a_plugin(PLANAR, BASE + inside))).drive

    assert drive == PlanarMove(
        update_rate_hz=50.0,
        odometry_rate_hz=10.0,
        publish_odom=False,
        publish_odom_tf=False,
        odometry_frame="o",
        robot_base_frame="base",
        covariance_x=0.5,
        ros=RosBlock("", ("cmd_vel:=go",)),
    )


def test_planar_move_is_read_when_it_is_spelt_as_in_ros_1() -> None:
    inside = """
      <commandTopic>move/cmd_vel</commandTopic><odometryTopic>odom</odometryTopic>
      <odometryFrame>o</odometryFrame><odometryRate>5</odometryRate>
      <robotBaseFrame>base</robotBaseFrame>
    """

    drive = read_urdf(a_cart(a_plugin(PLANAR, inside))).drive

    assert drive == PlanarMove(
        odometry_rate_hz=5.0,
        odometry_frame="o",
        robot_base_frame="base",
        command_topic="move/cmd_vel",
    )


def test_topic_is_the_default_when_it_is_invalid() -> None:
    model = read_urdf(a_cart(a_plugin(PLANAR, BASE + "<command_topic>a b</command_topic>")))

    assert model.drive is not None
    assert model.drive.command_topic == ""
    assert mentions(model.report, "suspicious", "<command_topic>", "'cmd_vel'")


MECANUM = """
  <front_left_joint>left_joint</front_left_joint><wheelbase>0.4</wheelbase>
  <topic>go</topic><odom_topic>odom</odom_topic><frame_id>o</frame_id>
  <child_frame_id>base</child_frame_id><odom_publish_frequency>20</odom_publish_frequency>
"""


@pytest.mark.parametrize(
    "filename", ["gz-sim-mecanum-drive-system", "libignition-gazebo-velocity-control-system.so"]
)
def test_gz_body_drive_is_a_planar_move(filename: str) -> None:
    model = read_urdf(a_cart(a_plugin(filename, MECANUM)))

    assert model.drive == PlanarMove(
        update_rate_hz=0.0,
        odometry_rate_hz=20.0,
        odometry_frame="o",
        robot_base_frame="base",
        command_topic="go",
    )
    assert len(subjects(model.report, "ignored")) == 2
    assert subjects(model.report, "suspicious") == subjects(model.report, "unknown") == []
