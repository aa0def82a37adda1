"""Which keys tell that others command a robot."""

import pytest
import zenoh

from zensim.deploy.other_commands import COMMAND_KEYS
from zensim.proto.messages.standard_messages import Odometry, Twist
from zensim.proto.ros2.rmw_keys import make_data_key
from zensim.proto.topic_catalog import ROBOT_TOPICS

HASH = "RIHS01_0"


def list_matching(key: str) -> list[str]:
    return [one for one in COMMAND_KEYS if zenoh.KeyExpr(one).intersects(zenoh.KeyExpr(key))]


@pytest.mark.parametrize("robot", ["r1", "site/r1"])
def test_commands_are_found_on_plain_keys_and_on_those_of_ros_2(robot: str) -> None:
    assert list_matching(f"{robot}/cmd_vel") == [COMMAND_KEYS[0]]
    ros_key = make_data_key(0, f"{robot}/cmd_vel", Twist.ros_type, HASH)
    assert list_matching(ros_key) == [COMMAND_KEYS[1]]


@pytest.mark.parametrize("topic", sorted(ROBOT_TOPICS.keys() - {"cmd_vel"}))
def test_demo_is_no_subscriber_of_other_topics_of_a_pool(topic: str) -> None:
    assert list_matching(f"*/{topic}") == []
    assert list_matching(make_data_key(0, f"*/{topic}", Odometry.ros_type, HASH)) == []
