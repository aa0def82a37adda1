"""Topics of one robot."""

import math
from typing import TypeVar

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import AT_REST, DRIVE, WHEELS, a_claim, two_wheeler
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.drive_messages import DiffDrive, RosBlock
from zensim.proto.messages.model_messages import JointStatePublisher, Model
from zensim.proto.messages.standard_messages import (
    Header,
    JointState,
    Odometry,
    String,
    TFMessage,
    Time,
    TransformStamped,
)
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.settings.ros_choice import TfScope
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.odometry import BaseMotion
from zensim.robot_agent.robot_telemetry import (
    JointTelemetry,
    MotionTelemetry,
    list_static_messages,
    make_fixed_transforms,
    make_static_publishers,
    make_tf_publishers,
    prefix_frames,
)
from zensim.robot_agent.topic_remapping import find_topic_keys

EDGE = TFMessage((TransformStamped(Header(frame_id="odom"), "base_link"),))


def frames(message: TFMessage) -> list[tuple[str, str]]:
    return [(edge.header.frame_id, edge.child_frame_id) for edge in message.transforms]


def list_tf_frames(scope: TfScope) -> dict[str, list[tuple[str, str]]]:
    bus = MemoryBus()
    receive = bus.subscribe("**", 8)
    factory = TopicFactory(bus, settings=RosSettings(tf=scope))
    claim = msgspec.structs.replace(a_claim(), namespace="team/r1")
    publishers = make_tf_publishers(
        factory,
        "team/r1",
        find_topic_keys(claim, factory.settings),
        template=EDGE,
        value_of=lambda message: lambda: message,
    )
    for publisher in publishers:
        publisher.publish()
    return {s.key: frames(decode(TFMessage, s.payload, s.encoding)) for s in receive.take()}


def test_frames_are_as_described_on_the_own_topic_and_prefixed_on_the_shared_one() -> None:
    assert list_tf_frames("both") == {
        "team/r1/tf": [("odom", "base_link")],
        "tf": [("team/r1/odom", "team/r1/base_link")],
    }


@pytest.mark.parametrize(("scope", "key"), [("global", "tf"), ("namespaced", "team/r1/tf")])
def test_transforms_are_published_in_the_scope_of_tf(scope: TfScope, key: str) -> None:
    assert list(list_tf_frames(scope)) == [key]


def test_frame_that_starts_with_the_namespace_is_not_prefixed() -> None:
    message = TFMessage((TransformStamped(Header(frame_id="r1/odom"), "base_link"),))

    assert frames(prefix_frames(message, "r1")) == [("r1/odom", "r1/base_link")]


def test_nothing_is_published_without_a_value() -> None:
    bus = MemoryBus()
    receive = bus.subscribe("**", 8)

    factory = TopicFactory(bus, settings=RosSettings())
    publishers = make_tf_publishers(
        factory,
        "r1",
        find_topic_keys(a_claim(), factory.settings),
        template=EDGE,
        value_of=lambda _: lambda: None,
    )
    for publisher in publishers:
        publisher.publish()

    assert receive.take() == []


SECOND = 1_000_000_000
Message = TypeVar("Message", bound=msgspec.Struct)
MOTION = BaseMotion((1.0, 2.0, 0.0), linear_x=0.5)


def state(time_ns: int = 5 * SECOND) -> RobotState:
    return RobotState(time_ns, AT_REST, (0.1, 0.2), (1.0, 2.0), (0.3, -0.4))


def receive(bus: MemoryBus, key: str, kind: type[Message], model: Model | None = None) -> Message:
    listener = bus.subscribe(key)
    MotionTelemetry(TopicFactory(bus), a_claim(model=model)).publish(state(), MOTION)
    JointTelemetry(TopicFactory(bus), a_claim(model=model)).publish(state())
    (sample,) = listener.take()
    return decode(kind, sample.payload, sample.encoding)


def test_motion_is_published_as_odometry() -> None:
    message = receive(MemoryBus(), "r1/odom", Odometry)

    assert message.header == Header(Time(5), "odom")
    assert message.child_frame_id == "base_footprint"
    assert message.pose.pose.position.x == 1.0
    assert message.twist.twist.linear.x == 0.5


def test_motion_is_published_in_tf_with_the_wheels() -> None:
    message = receive(MemoryBus(), "r1/tf", TFMessage)

    assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
        ("odom", "base_footprint"),
        ("base_link", "left_wheel"),
        ("base_link", "right_wheel"),
    ]
    assert {t.header.stamp for t in message.transforms} == {Time(5)}


def test_tf_has_joints_only_when_the_drive_does_not_publish_its_own() -> None:
    quiet = msgspec.structs.replace(DRIVE, publish_odom_tf=False)

    message = receive(MemoryBus(), "r1/tf", TFMessage, two_wheeler(quiet))

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


def test_joint_states_have_names_positions_velocities_and_efforts() -> None:
    message = receive(MemoryBus(), "r1/joint_states", JointState)

    assert message == JointState(
        Header(Time(5)), ("left_joint", "right_joint"), (0.1, 0.2), (1.0, 2.0), (0.3, -0.4)
    )


def test_joint_states_have_no_number_for_efforts_that_the_server_does_not_report() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/joint_states")

    JointTelemetry(TopicFactory(bus), a_claim()).publish(
        msgspec.structs.replace(state(), efforts=())
    )

    (sample,) = listener.take()
    efforts = decode(JointState, sample.payload, sample.encoding).effort
    assert [math.isnan(effort) for effort in efforts] == [True, True]


def test_efforts_are_wanted_while_joint_states_have_a_subscriber() -> None:
    bus = MemoryBus()
    telemetry = JointTelemetry(TopicFactory(bus), a_claim())
    wanted = []

    telemetry.publish(state(0))
    wanted.append(telemetry.wants_efforts)
    listener = bus.subscribe("r1/joint_states")
    telemetry.publish(state(SECOND))
    wanted.append(telemetry.wants_efforts)
    listener.close()
    telemetry.publish(state(2 * SECOND))
    wanted.append(telemetry.wants_efforts)

    assert wanted == [False, True, False]


def test_joint_states_hold_the_publishers_joints_only() -> None:
    model = two_wheeler(joint_state=JointStatePublisher(("right_joint",)))

    message = receive(MemoryBus(), "r1/joint_states", JointState, model)

    assert (message.name, message.position) == (("right_joint",), (0.2,))


def test_joint_states_are_not_offered_when_there_are_none() -> None:
    bus = MemoryBus()

    telemetry = JointTelemetry(
        TopicFactory(bus), a_claim(model=two_wheeler(joint_state=JointStatePublisher(("missing",))))
    )
    telemetry.publish(state())

    assert not bus.is_served("r1/*")


@pytest.mark.parametrize(("rate_hz", "count"), [(None, 30), (10.0, 10), (0.0, 80)])
def test_joint_states_come_at_their_own_rate(rate_hz: float | None, count: int) -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/joint_states", 100)
    names = ("left_joint",)
    publisher = None if rate_hz is None else JointStatePublisher(names, rate_hz)
    telemetry = JointTelemetry(TopicFactory(bus), a_claim(model=two_wheeler(joint_state=publisher)))

    for i in range(80):
        telemetry.publish(state(i * SECOND // 80))

    assert len(listener.take()) == count


def test_topics_follow_remappings() -> None:
    bus = MemoryBus()
    drive = msgspec.structs.replace(DRIVE, ros=RosBlock("", ("odom:=ground_truth", "/tf:=/all/tf")))
    publisher = JointStatePublisher(("left_joint",), ros=RosBlock("", ("joint_states:=js",)))
    claim = a_claim(model=two_wheeler(drive, joint_state=publisher))

    publishers = [
        MotionTelemetry(TopicFactory(bus), claim),
        JointTelemetry(TopicFactory(bus), claim),
    ]

    assert publishers
    assert all(bus.is_served(key) for key in ("r1/ground_truth", "all/tf", "r1/js"))
    assert not any(bus.is_served(key) for key in ("r1/odom", "r1/tf", "r1/joint_states"))


def test_replies_have_the_last_values_until_a_reset() -> None:
    bus = MemoryBus()
    motion, joints = (
        MotionTelemetry(TopicFactory(bus), a_claim()),
        JointTelemetry(TopicFactory(bus), a_claim()),
    )
    bus.pumps += [
        publisher.reply_to_queries for publisher in (*motion.publishers, *joints.publishers)
    ]
    assert bus.get("r1/*") == []

    motion.publish(state(), MOTION)
    joints.publish(state())
    assert {sample.key for sample in bus.get("r1/*")} == {"r1/odom", "r1/tf", "r1/joint_states"}

    motion.reset()
    joints.reset()
    assert bus.get("r1/*") == []


def test_joint_states_come_at_once_after_a_reset() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/joint_states", 8)
    telemetry = JointTelemetry(TopicFactory(bus), a_claim())
    telemetry.publish(state(5 * SECOND))

    telemetry.reset()
    telemetry.publish(state(0))

    assert len(listener.take()) == 2


def test_static_topics_are_the_fixed_frames_and_the_description() -> None:
    bus = MemoryBus()
    bus.pumps += [
        publisher.reply_to_queries
        for publisher in make_static_publishers(TopicFactory(bus), a_claim())
    ]

    (fixed,) = bus.get("r1/tf_static")
    (description,) = bus.get("r1/robot_description")

    transforms = decode(TFMessage, fixed.payload).transforms
    assert [t.child_frame_id for t in transforms] == ["base_link", "camera"]
    assert {t.header.stamp for t in transforms} == {Time()}
    assert decode(String, description.payload) == String("<robot/>")


def test_static_topics_are_not_offered_when_there_are_none() -> None:
    bus = MemoryBus()
    model = two_wheeler(None, joints=WHEELS, frames=())
    claim = msgspec.structs.replace(a_claim(model=model), robot_description="")

    assert make_static_publishers(TopicFactory(bus), claim) == []


FIXED = TFMessage((TransformStamped(Header(frame_id="base_link"), "lidar"),))
NOTHING = TFMessage()
WORLD_DRIVE = msgspec.structs.replace(DRIVE, publish_odom_tf=True, odometry_source="world")
ENCODER_DRIVE = msgspec.structs.replace(WORLD_DRIVE, odometry_source="encoder")
QUARTER = math.sqrt(0.5)
AT_SPAWN = (3.0, 4.0, 0.1, 0.0, 0.0, QUARTER, QUARTER, *(0.0,) * 6)


def make_static_claim(drive: DiffDrive = WORLD_DRIVE) -> Claim:
    return Claim(1, "r1", "r1", two_wheeler(drive), spawn_state=AT_SPAWN)


def list_static_frames(
    claim: Claim, fixed: TFMessage = FIXED, tf: TfScope = "both", root: str = "world"
) -> dict[str, list[tuple[str, str]]]:
    settings = RosSettings(tf=tf, tf_root=root)
    return {
        key: [(edge.header.frame_id, edge.child_frame_id) for edge in message.transforms]
        for _, key, message in list_static_messages(claim, fixed, settings)
        if isinstance(message, TFMessage)
    }


def find_root_transform(claim: Claim) -> TransformStamped:
    ((_, _, message),) = list_static_messages(claim, NOTHING, RosSettings(tf="global"))
    assert isinstance(message, TFMessage)
    return message.transforms[-1]


def test_root_transform_is_on_the_shared_topic() -> None:
    assert list_static_frames(make_static_claim()) == {
        "r1/tf_static": [("base_link", "lidar")],
        "tf_static": [("r1/base_link", "r1/lidar"), ("world", "r1/odom")],
    }


def test_root_transform_is_published_without_other_fixed_frames() -> None:
    assert list_static_frames(make_static_claim(), NOTHING, root="map") == {
        "tf_static": [("map", "r1/odom")]
    }


@pytest.mark.parametrize(
    ("tf", "root", "drive"),
    [
        ("both", "", WORLD_DRIVE),
        ("namespaced", "world", WORLD_DRIVE),
        ("both", "world", msgspec.structs.replace(WORLD_DRIVE, publish_odom_tf=False)),
    ],
    ids=["none is wanted", "no topic is shared", "tf has no odometry"],
)
def test_root_transform_is_omitted(tf: TfScope, root: str, drive: DiffDrive) -> None:
    edges = list_static_frames(make_static_claim(drive), FIXED, tf, root).get("tf_static", [])

    assert ("r1/base_link", "r1/lidar") in edges or tf == "namespaced"
    assert [edge for edge in edges if edge[1] == "r1/odom"] == []


def test_root_of_world_odometry_is_the_world_origin() -> None:
    transform = find_root_transform(make_static_claim()).transform

    assert (transform.translation.x, transform.translation.y) == (0.0, 0.0)
    assert transform.rotation.w == 1.0


def test_root_of_encoder_odometry_is_the_spawn_pose() -> None:
    transform = find_root_transform(make_static_claim(ENCODER_DRIVE)).transform

    assert (transform.translation.x, transform.translation.y) == (3.0, 4.0)
    assert transform.rotation.z == pytest.approx(QUARTER)


def test_root_of_encoder_odometry_is_the_origin_without_a_spawn_pose() -> None:
    claim = msgspec.structs.replace(make_static_claim(ENCODER_DRIVE), spawn_state=())

    assert find_root_transform(claim).transform.translation.x == 0.0


def test_late_joiners_get_fixed_transforms() -> None:
    bus = MemoryBus()
    publishers = make_static_publishers(
        TopicFactory(bus, settings=RosSettings()), make_static_claim()
    )
    bus.pumps += [publisher.reply_to_queries for publisher in publishers]

    fixed = make_fixed_transforms(make_static_claim().model)
    (own,), (shared,) = bus.get("r1/tf_static"), bus.get("tf_static")

    assert decode(TFMessage, own.payload, own.encoding) == fixed
    assert (
        len(decode(TFMessage, shared.payload, shared.encoding).transforms)
        == len(fixed.transforms) + 1
    )
