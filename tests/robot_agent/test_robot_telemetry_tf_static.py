"""What is fixed of a robot, on its own topic and on that of all robots, under one root."""

import math

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import DRIVE, two_wheeler
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.standard_messages import Header, TFMessage, TransformStamped
from zensim.proto.ros2.ros_settings import RosSettings, TfScope
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.robot_telemetry import (
    list_static_messages,
    make_fixed_transforms,
    make_static_publishers,
)

FIXED = TFMessage((TransformStamped(Header(frame_id="base_link"), "lidar"),))
NOTHING = TFMessage()
WORLD_DRIVE = msgspec.structs.replace(DRIVE, publish_odom_tf=True, odometry_source="world")
ENCODER_DRIVE = msgspec.structs.replace(WORLD_DRIVE, odometry_source="encoder")
QUARTER = math.sqrt(0.5)
AT_SPAWN = (3.0, 4.0, 0.1, 0.0, 0.0, QUARTER, QUARTER, *(0.0,) * 6)


def a_claim(drive: DiffDrive = WORLD_DRIVE) -> Claim:
    return Claim(1, "r1", "r1", two_wheeler(drive), spawn_state=AT_SPAWN)


def told(
    claim: Claim, fixed: TFMessage = FIXED, tf: TfScope = "both", root: str = "world"
) -> dict[str, list[tuple[str, str]]]:
    settings = RosSettings(tf=tf, tf_root=root)
    return {
        key: [(edge.header.frame_id, edge.child_frame_id) for edge in message.transforms]
        for _, key, message in list_static_messages(claim, fixed, settings)
        if isinstance(message, TFMessage)
    }


def root_of(claim: Claim) -> TransformStamped:
    ((_, _, message),) = list_static_messages(claim, NOTHING, RosSettings(tf="global"))
    assert isinstance(message, TFMessage)
    return message.transforms[-1]


def test_robots_share_a_root_where_they_share_a_topic() -> None:
    assert told(a_claim()) == {
        "r1/tf_static": [("base_link", "lidar")],
        "tf_static": [("r1/base_link", "r1/lidar"), ("world", "r1/odom")],
    }


def test_root_is_told_of_a_robot_with_nothing_else_that_is_fixed() -> None:
    assert told(a_claim(), NOTHING, root="map") == {"tf_static": [("map", "r1/odom")]}


@pytest.mark.parametrize(
    ("tf", "root", "drive"),
    [
        ("both", "", WORLD_DRIVE),
        ("namespaced", "world", WORLD_DRIVE),
        ("both", "world", msgspec.structs.replace(WORLD_DRIVE, publish_odom_tf=False)),
    ],
    ids=["none is wanted", "no topic is shared", "tf has no odometry"],
)
def test_root_is_left_out(tf: TfScope, root: str, drive: DiffDrive) -> None:
    edges = told(a_claim(drive), FIXED, tf, root).get("tf_static", [])

    assert ("r1/base_link", "r1/lidar") in edges or tf == "namespaced"
    assert [edge for edge in edges if edge[1] == "r1/odom"] == []


def test_odometry_of_the_world_begins_where_the_world_does() -> None:
    transform = root_of(a_claim()).transform

    assert (transform.translation.x, transform.translation.y) == (0.0, 0.0)
    assert transform.rotation.w == 1.0


def test_odometry_of_encoders_begins_at_the_spawn() -> None:
    transform = root_of(a_claim(ENCODER_DRIVE)).transform

    assert (transform.translation.x, transform.translation.y) == (3.0, 4.0)
    assert transform.rotation.z == pytest.approx(QUARTER)


def test_encoders_of_a_robot_whose_spawn_nobody_told_begin_at_the_root() -> None:
    claim = msgspec.structs.replace(a_claim(ENCODER_DRIVE), spawn_state=())

    assert root_of(claim).transform.translation.x == 0.0


def test_fixed_transforms_are_for_late_joiners_too() -> None:
    bus = MemoryBus()
    publishers = make_static_publishers(TopicFactory(bus, settings=RosSettings()), a_claim())
    bus.pumps += [publisher.reply_to_queries for publisher in publishers]

    fixed = make_fixed_transforms(a_claim().model)
    (own,), (shared,) = bus.get("r1/tf_static"), bus.get("tf_static")

    assert decode(TFMessage, own.payload, own.encoding) == fixed
    assert (
        len(decode(TFMessage, shared.payload, shared.encoding).transforms)
        == len(fixed.transforms) + 1
    )
