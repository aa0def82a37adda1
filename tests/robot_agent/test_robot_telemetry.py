"""What a robot tells, and when."""

from typing import TypeVar

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import AT_REST, DRIVE, WHEELS, a_claim, two_wheeler
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.model_messages import JointStatePublisher, Model, RosBlock
from zensim.proto.messages.standard_messages import (
    Header,
    JointState,
    Odometry,
    String,
    TFMessage,
    Time,
    TransformStamped,
)
from zensim.proto.ros2.ros_settings import RosSettings, TfScope
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.odometry import BaseMotion
from zensim.robot_agent.robot_telemetry import (
    JointTelemetry,
    MotionTelemetry,
    make_static_publishers,
    make_tf_publishers,
    prefix_frames,
)
from zensim.robot_agent.topic_remapping import find_topic_keys

EDGE = TFMessage((TransformStamped(Header(frame_id="odom"), "base_link"),))


def frames(message: TFMessage) -> list[tuple[str, str]]:
    return [(edge.header.frame_id, edge.child_frame_id) for edge in message.transforms]


def told(scope: TfScope) -> dict[str, list[tuple[str, str]]]:
    bus = MemoryBus()
    heard = bus.subscribe("**", 8)
    faces = TopicFactory(bus, settings=RosSettings(tf=scope))
    claim = msgspec.structs.replace(a_claim(), namespace="team/r1")
    outlets = make_tf_publishers(
        faces,
        "team/r1",
        find_topic_keys(claim, faces.settings),
        template=EDGE,
        value_of=lambda message: lambda: message,
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

    assert frames(prefix_frames(message, "r1")) == [("r1/odom", "r1/base_link")]


def test_nothing_is_told_while_there_is_nothing() -> None:
    bus = MemoryBus()
    heard = bus.subscribe("**", 8)

    faces = TopicFactory(bus, settings=RosSettings())
    outlets = make_tf_publishers(
        faces,
        "r1",
        find_topic_keys(a_claim(), faces.settings),
        template=EDGE,
        value_of=lambda _: lambda: None,
    )
    for outlet in outlets:
        outlet.publish()

    assert heard.take() == []


SECOND = 1_000_000_000
Message = TypeVar("Message", bound=msgspec.Struct)
MOTION = BaseMotion((1.0, 2.0, 0.0), linear_x=0.5)


def reading(time_ns: int = 5 * SECOND) -> RobotState:
    return RobotState(time_ns, AT_REST, (0.1, 0.2), (1.0, 2.0))


def heard(bus: MemoryBus, key: str, kind: type[Message], model: Model | None = None) -> Message:
    listener = bus.subscribe(key)
    MotionTelemetry(TopicFactory(bus), a_claim(model=model)).publish(reading(), MOTION)
    JointTelemetry(TopicFactory(bus), a_claim(model=model)).publish(reading())
    (sample,) = listener.take()
    return decode(kind, sample.payload, sample.encoding)


def test_motion_is_told_as_odometry() -> None:
    message = heard(MemoryBus(), "r1/odom", Odometry)

    assert message.header == Header(Time(5), "odom")
    assert message.child_frame_id == "base_footprint"
    assert message.pose.pose.position.x == 1.0
    assert message.twist.twist.linear.x == 0.5


def test_motion_is_told_in_tf_with_the_wheels() -> None:
    message = heard(MemoryBus(), "r1/tf", TFMessage)

    assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
        ("odom", "base_footprint"),
        ("base_link", "left_wheel"),
        ("base_link", "right_wheel"),
    ]
    assert {t.header.stamp for t in message.transforms} == {Time(5)}


def test_tf_has_joints_only_when_the_drive_does_not_publish_its_own() -> None:
    quiet = msgspec.structs.replace(DRIVE, publish_odom_tf=False)

    message = heard(MemoryBus(), "r1/tf", TFMessage, two_wheeler(quiet))

    assert [t.child_frame_id for t in message.transforms] == ["left_wheel", "right_wheel"]


def test_odometry_is_not_offered_when_the_drive_does_not_publish_it() -> None:
    bus = MemoryBus()
    quiet = msgspec.structs.replace(DRIVE, publish_odom=False)

    MotionTelemetry(TopicFactory(bus), a_claim(model=two_wheeler(quiet)))

    assert not bus.is_served("r1/odom")


def test_tf_is_not_offered_when_nothing_moves() -> None:
    bus = MemoryBus()

    MotionTelemetry(TopicFactory(bus), a_claim(model=two_wheeler(None, joints=())))

    assert not bus.is_served("r1/*")


def test_joint_states_have_names_positions_and_velocities() -> None:
    message = heard(MemoryBus(), "r1/joint_states", JointState)

    assert message == JointState(
        Header(Time(5)), ("left_joint", "right_joint"), (0.1, 0.2), (1.0, 2.0), ()
    )


def test_joint_states_hold_the_publishers_joints_only() -> None:
    model = two_wheeler(joint_state=JointStatePublisher(("right_joint",)))

    message = heard(MemoryBus(), "r1/joint_states", JointState, model)

    assert (message.name, message.position) == (("right_joint",), (0.2,))


def test_joint_states_are_not_offered_when_there_are_none() -> None:
    bus = MemoryBus()

    telemetry = JointTelemetry(
        TopicFactory(bus), a_claim(model=two_wheeler(joint_state=JointStatePublisher(("missing",))))
    )
    telemetry.publish(reading())

    assert not bus.is_served("r1/*")


@pytest.mark.parametrize(("rate_hz", "count"), [(None, 30), (10.0, 10), (0.0, 80)])
def test_joint_states_come_at_their_own_rate(rate_hz: float | None, count: int) -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/joint_states", 100)
    names = ("left_joint",)
    publisher = None if rate_hz is None else JointStatePublisher(names, rate_hz)
    telemetry = JointTelemetry(TopicFactory(bus), a_claim(model=two_wheeler(joint_state=publisher)))

    for i in range(80):
        telemetry.publish(reading(i * SECOND // 80))

    assert len(listener.take()) == count


def test_topics_follow_remappings() -> None:
    bus = MemoryBus()
    drive = msgspec.structs.replace(DRIVE, ros=RosBlock("", ("odom:=ground_truth", "/tf:=/all/tf")))
    publisher = JointStatePublisher(("left_joint",), ros=RosBlock("", ("joint_states:=js",)))
    claim = a_claim(model=two_wheeler(drive, joint_state=publisher))

    outlets = [MotionTelemetry(TopicFactory(bus), claim), JointTelemetry(TopicFactory(bus), claim)]

    assert outlets
    assert all(bus.is_served(key) for key in ("r1/ground_truth", "all/tf", "r1/js"))
    assert not any(bus.is_served(key) for key in ("r1/odom", "r1/tf", "r1/joint_states"))


def test_last_values_are_answered_once_there_are_any_and_until_a_reset() -> None:
    bus = MemoryBus()
    motion, joints = (
        MotionTelemetry(TopicFactory(bus), a_claim()),
        JointTelemetry(TopicFactory(bus), a_claim()),
    )
    bus.pumps += [outlet.reply_to_queries for outlet in (*motion.publishers, *joints.publishers)]
    assert bus.get("r1/*") == []

    motion.publish(reading(), MOTION)
    joints.publish(reading())
    assert {sample.key for sample in bus.get("r1/*")} == {
        "r1/odom",
        "r1/tf",
        "r1/joint_states",
    }

    motion.reset()
    joints.reset()
    assert bus.get("r1/*") == []


def test_joint_states_come_at_once_after_a_reset() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/joint_states", 8)
    telemetry = JointTelemetry(TopicFactory(bus), a_claim())
    telemetry.publish(reading(5 * SECOND))

    telemetry.reset()
    telemetry.publish(reading(0))

    assert len(listener.take()) == 2


def test_constants_are_the_fixed_frames_and_the_description() -> None:
    bus = MemoryBus()
    bus.pumps += [
        outlet.reply_to_queries for outlet in make_static_publishers(TopicFactory(bus), a_claim())
    ]

    (fixed,) = bus.get("r1/tf_static")
    (description,) = bus.get("r1/robot_description")

    transforms = decode(TFMessage, fixed.payload).transforms
    assert [t.child_frame_id for t in transforms] == ["base_link", "camera"]
    assert {t.header.stamp for t in transforms} == {Time()}
    assert decode(String, description.payload) == String("<robot/>")


def test_constants_are_not_offered_when_there_are_none() -> None:
    bus = MemoryBus()
    model = two_wheeler(None, joints=WHEELS, frames=())
    claim = msgspec.structs.replace(a_claim(model=model), robot_description="")

    assert make_static_publishers(TopicFactory(bus), claim) == []
