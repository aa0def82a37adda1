"""Gazebo Sim's drives that go sideways move the body."""

import pytest

from tests.sim_server.description.robots import a_cart, a_plugin, subjects
from zensim.proto.messages.drive_messages import PlanarMove
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

MECANUM = """
  <front_left_joint>left_joint</front_left_joint><wheelbase>0.4</wheelbase>
  <topic>go</topic><odom_topic>odom</odom_topic><frame_id>o</frame_id>
  <child_frame_id>base</child_frame_id><odom_publish_frequency>20</odom_publish_frequency>
"""


@pytest.mark.parametrize(
    "filename", ["gz-sim-mecanum-drive-system", "libignition-gazebo-velocity-control-system.so"]
)
def test_body_takes_the_twist(filename: str) -> None:
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
