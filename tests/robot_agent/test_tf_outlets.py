"""Transforms on the robot's own topics and on those of all robots."""

import pytest

from tests.fakes import MemoryBus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import Header, TFMessage, TransformStamped
from zensim.proto.ros2.ros_settings import RosSettings, TfScope
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.tf_outlets import tf_outlets, with_namespace

EDGE = TFMessage((TransformStamped(Header(frame_id="odom"), "base_link"),))


def frames(message: TFMessage) -> list[tuple[str, str]]:
    return [(edge.header.frame_id, edge.child_frame_id) for edge in message.transforms]


def told(scope: TfScope) -> dict[str, list[tuple[str, str]]]:
    bus = MemoryBus()
    heard = bus.subscribe("**", 8)
    faces = TopicFactory(bus, settings=RosSettings(tf=scope))
    outlets = tf_outlets(
        faces, "team/r1", "team/r1/tf", template=EDGE, value_of=lambda message: lambda: message
    )
    for outlet in outlets:
        outlet.publish()
    return {s.key: frames(decode(TFMessage, s.payload, s.encoding)) for s in heard.take()}


def test_own_frames_are_as_described_and_shared_ones_begin_with_the_namespace() -> None:
    assert told("both") == {
        "team/r1/tf": [("odom", "base_link")],
        "tf": [("team/r1/odom", "team/r1/base_link")],
    }


@pytest.mark.parametrize(("scope", "key"), [("global", "tf"), ("namespaced", "team/r1/tf")])
def test_transforms_are_told_where_they_are_wanted(scope: TfScope, key: str) -> None:
    assert list(told(scope)) == [key]


def test_frame_that_begins_with_the_namespace_already_is_left() -> None:
    message = TFMessage((TransformStamped(Header(frame_id="r1/odom"), "base_link"),))

    assert frames(with_namespace(message, "r1")) == [("r1/odom", "r1/base_link")]


def test_nothing_is_told_while_there_is_nothing() -> None:
    bus = MemoryBus()
    heard = bus.subscribe("**", 8)

    faces = TopicFactory(bus, settings=RosSettings())
    outlets = tf_outlets(faces, "r1", "r1/tf", template=EDGE, value_of=lambda _: lambda: None)
    for outlet in outlets:
        outlet.publish()

    assert heard.take() == []
