"""A topic on its bare key and on ROS 2's."""

from collections.abc import Callable
from typing import cast

from tests.fakes import MemoryBus
from zensim.proto.messages.standard_messages import String, Twist, TwistStamped
from zensim.proto.network_protocols import Stamp
from zensim.proto.ros2.liveliness_tokens import LATCHED, gid_from_token
from zensim.proto.ros2.rmw_attachment import read_attachment
from zensim.proto.ros2.ros_graph import RosGraph, Topic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.topic_endpoints import KeyPublisher, TopicFactory, TopicPublisher

TOPIC = Topic("r1/description", String, LATCHED)
ROS_KEY = (
    "0/r1/description/std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
ENCODING = "application/cdr;std_msgs/msg/String"
PAYLOAD = b"\x00\x01\x00\x00payload"


def faces_on(bus: MemoryBus, settings: RosSettings = RosSettings()) -> TopicFactory:  # noqa: B008
    return TopicFactory(bus, RosGraph(bus, settings).add_node("r1", "agent"), settings)


def a_publisher(bus: MemoryBus) -> TopicPublisher:
    return faces_on(bus).publisher(TOPIC)


def value() -> bytes:
    return PAYLOAD


def nothing() -> bytes | None:
    return None


def test_message_goes_to_each_face_that_is_looked_at() -> None:
    bus = MemoryBus()
    plain, ros = bus.subscribe("r1/description", 8), bus.subscribe(ROS_KEY, 8)

    a_publisher(bus).send(PAYLOAD)

    assert [(s.key, s.payload, s.encoding, s.attachment) for s in plain.take()] == [
        ("r1/description", PAYLOAD, ENCODING, b"")
    ]
    assert [(s.key, s.payload) for s in ros.take()] == [(ROS_KEY, PAYLOAD)]


def test_ros_messages_are_numbered_from_one_and_signed_with_the_endpoints_gid() -> None:
    bus = MemoryBus()
    ros = bus.subscribe(ROS_KEY, 8)
    publisher = a_publisher(bus)

    publisher.send(PAYLOAD)
    publisher.send(PAYLOAD)

    attachments = [read_attachment(sample.attachment) for sample in ros.take()]
    (token,) = bus.list_tokens("@ros2_lv/*/*/*/*/MP/**")
    assert [one.sequence_number for one in attachments if one] == [1, 2]
    assert {one.gid for one in attachments if one} == {gid_from_token(token)}


def test_number_does_not_grow_while_nobody_looks() -> None:
    bus = MemoryBus()
    publisher = a_publisher(bus)
    publisher.send(PAYLOAD)

    ros = bus.subscribe(ROS_KEY, 8)
    publisher.send(PAYLOAD)

    (sample,) = ros.take()
    attachment = read_attachment(sample.attachment)
    assert attachment is not None
    assert attachment.sequence_number == 1


def test_topic_is_matched_by_any_face() -> None:
    bus = MemoryBus()
    publisher = a_publisher(bus)
    assert not publisher.is_matched

    bus.subscribe(ROS_KEY)

    assert publisher.is_matched


def test_each_face_greets_its_own_first_listener() -> None:
    bus = MemoryBus()
    publisher = a_publisher(bus)
    plain = bus.subscribe("r1/description", 8)
    publisher.publish_to_new(value)

    ros = bus.subscribe(ROS_KEY, 8)
    publisher.publish_to_new(value)
    publisher.publish_to_new(value)

    assert (len(plain.take()), len(ros.take())) == (1, 1)


def late_join(
    bus: MemoryBus, publisher: TopicPublisher, payload: Callable[[], bytes | None]
) -> int:
    bus.pumps.append(lambda: publisher.reply_to_late_joiners(payload))
    answers = bus.get(f"{ROS_KEY}/@adv/**")
    assert all(answer.key == ROS_KEY for answer in answers)
    assert all(read_attachment(answer.attachment) for answer in answers)
    return len(answers)


def test_latched_topic_tells_late_joiners_its_value() -> None:
    bus = MemoryBus()

    assert late_join(bus, a_publisher(bus), value) == 1


def test_latched_topic_tells_late_joiners_nothing_while_there_is_nothing() -> None:
    bus = MemoryBus()

    assert late_join(bus, a_publisher(bus), nothing) == 0


def test_other_topics_have_nothing_for_late_joiners() -> None:
    bus = MemoryBus()

    faces_on(bus).publisher(Topic("r1/description", String))

    assert not bus.is_served(f"{ROS_KEY}/@adv/**")


def test_command_of_either_type_and_of_any_hash_is_heard() -> None:
    bus = MemoryBus()
    heard = faces_on(bus).subscription("r1/cmd_vel", (Twist, TwistStamped), 8)

    bus.put("0/r1/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/RIHS01_5f0f", b"stamped")
    bus.put("0/r1/cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported", b"bare")
    bus.put("r1/cmd_vel", b"plain", "application/json")

    samples = [(sample.key, sample.payload, sample.encoding) for sample in heard.take()]
    assert samples == [
        ("r1/cmd_vel", b"plain", "application/json"),
        ("r1/cmd_vel", b"bare", "application/cdr;geometry_msgs/msg/Twist"),
        ("r1/cmd_vel", b"stamped", "application/cdr;geometry_msgs/msg/TwistStamped"),
    ]


def test_command_in_another_domain_is_not_heard() -> None:
    bus = MemoryBus()
    heard = faces_on(bus).subscription("r1/cmd_vel", (Twist,), 8)

    bus.put("7/r1/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_9c45", b"other")

    assert heard.newest() is None


def test_topics_have_one_face_without_ros() -> None:
    bus = MemoryBus()
    faces = TopicFactory(bus)

    publisher, heard = faces.publisher(TOPIC), faces.subscription("r1/cmd_vel", (Twist,), 8)

    bus.subscribe(ROS_KEY)
    assert not publisher.is_matched
    assert bus.is_heard("r1/cmd_vel")
    assert not bus.is_heard("0/r1/cmd_vel/a/b")
    heard.close()
    assert not bus.is_heard("r1/cmd_vel")


class Stamps:
    """A publisher that keeps the stamps of what is put, and a clock that makes them."""

    is_matched = True

    def __init__(self) -> None:
        self.sent: list[object] = []

    def make(self) -> Stamp:
        return cast("Stamp", object())

    def send(self, payload: bytes, attachment: bytes = b"", stamp: Stamp | None = None) -> None:
        del payload, attachment
        self.sent.append(stamp)

    def close(self) -> None:
        raise AssertionError


def test_latched_value_keeps_its_stamp_until_it_changes() -> None:
    stamps = Stamps()
    face = KeyPublisher(stamps, None, stamps.make)

    for payload in (b"1", b"1", b"2"):
        face.send(payload)

    first, again, changed = stamps.sent
    assert first is again
    assert changed is not first


def test_value_that_is_not_latched_is_not_stamped() -> None:
    stamps = Stamps()

    KeyPublisher(stamps).send(b"1")

    assert stamps.sent == [None]
