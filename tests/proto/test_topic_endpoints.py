"""Topics on plain keys and on ROS 2 keys."""

from collections.abc import Callable
from typing import cast

import pytest

from tests.fakes import ManualClock, MemoryBus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import String, Twist, TwistStamped
from zensim.proto.network_protocols import Stamp
from zensim.proto.ros2.liveliness_tokens import gid_from_token
from zensim.proto.ros2.qos_profiles import LATCHED
from zensim.proto.ros2.rmw_attachment import read_attachment
from zensim.proto.ros2.ros_graph import RosGraph, RosTopic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.topic_endpoints import (
    REPEAT_AFTER_S,
    KeyPublisher,
    LazyTopicPublisher,
    TopicFactory,
    TopicPublisher,
)

TOPIC = RosTopic("r1/description", String, LATCHED)
PLAIN_TOPIC = RosTopic("r1/description", String)
ROS_KEY = (
    "0/r1/description/std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
ENCODING = "application/cdr;std_msgs/msg/String"
PAYLOAD = b"\x00\x01\x00\x00payload"


def a_factory(bus: MemoryBus, settings: RosSettings = RosSettings()) -> TopicFactory:  # noqa: B008
    return TopicFactory(bus, RosGraph(bus, settings).add_node("r1", "agent"), settings)


def a_publisher(bus: MemoryBus) -> TopicPublisher:
    return a_factory(bus).publisher(TOPIC)


def value() -> bytes:
    return PAYLOAD


def nothing() -> bytes | None:
    return None


def test_message_is_published_on_each_key_with_a_subscriber() -> None:
    bus = MemoryBus()
    plain, ros = bus.subscribe("r1/description", 8), bus.subscribe(ROS_KEY, 8)

    a_publisher(bus).send(PAYLOAD)

    assert [(s.key, s.payload, s.encoding, s.attachment) for s in plain.take()] == [
        ("r1/description", PAYLOAD, ENCODING, b"")
    ]
    assert [(s.key, s.payload) for s in ros.take()] == [(ROS_KEY, PAYLOAD)]


def test_ros_messages_have_sequence_numbers_from_one_and_the_gid_of_the_endpoint() -> None:
    bus = MemoryBus()
    ros = bus.subscribe(ROS_KEY, 8)
    publisher = a_publisher(bus)

    publisher.send(PAYLOAD)
    publisher.send(PAYLOAD)

    attachments = [read_attachment(sample.attachment) for sample in ros.take()]
    (token,) = bus.list_tokens("@ros2_lv/*/*/*/*/MP/**")
    assert [one.sequence_number for one in attachments if one] == [1, 2]
    assert {one.gid for one in attachments if one} == {gid_from_token(token)}


def test_sequence_number_is_kept_without_a_subscriber() -> None:
    bus = MemoryBus()
    publisher = a_publisher(bus)
    publisher.send(PAYLOAD)

    ros = bus.subscribe(ROS_KEY, 8)
    publisher.send(PAYLOAD)

    (sample,) = ros.take()
    attachment = read_attachment(sample.attachment)
    assert attachment is not None
    assert attachment.sequence_number == 1


def test_topic_is_matched_by_a_subscriber_on_any_key() -> None:
    bus = MemoryBus()
    publisher = a_publisher(bus)
    assert not publisher.is_matched

    bus.subscribe(ROS_KEY)

    assert publisher.is_matched


def test_value_is_published_to_the_first_subscriber_of_each_key() -> None:
    bus = MemoryBus()
    publisher = a_publisher(bus)
    plain = bus.subscribe("r1/description", 8)
    publisher.publish_to_new(value)

    ros = bus.subscribe(ROS_KEY, 8)
    publisher.publish_to_new(value)
    publisher.publish_to_new(value)

    assert (len(plain.take()), len(ros.take())) == (1, 1)


def test_latched_message_is_repeated_once_with_its_attachment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bus, clock = MemoryBus(), ManualClock()
    monkeypatch.setattr("zensim.proto.topic_endpoints.time.monotonic", clock)
    ros = bus.subscribe(ROS_KEY, 8)
    publisher = a_publisher(bus)
    publisher.send(PAYLOAD)
    (lost,) = ros.take()

    publisher.publish_to_new(value)
    early = ros.take()
    clock.sleep(REPEAT_AFTER_S)
    publisher.publish_to_new(value)
    publisher.publish_to_new(value)

    assert (early, ros.take()) == ([], [lost])


def test_other_messages_are_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, clock = MemoryBus(), ManualClock()
    monkeypatch.setattr("zensim.proto.topic_endpoints.time.monotonic", clock)
    ros = bus.subscribe(ROS_KEY, 8)
    publisher = a_factory(bus).publisher(PLAIN_TOPIC)
    publisher.send(PAYLOAD)

    clock.sleep(REPEAT_AFTER_S)
    publisher.publish_to_new(value)

    assert len(ros.take()) == 1


def late_join(
    bus: MemoryBus, publisher: TopicPublisher, payload: Callable[[], bytes | None]
) -> int:
    bus.pumps.append(lambda: publisher.reply_to_late_joiners(payload))
    replies = bus.get(f"{ROS_KEY}/@adv/**")
    assert all(reply.key == ROS_KEY for reply in replies)
    assert all(read_attachment(reply.attachment) for reply in replies)
    return len(replies)


def test_latched_topic_replies_to_late_joiners() -> None:
    bus = MemoryBus()

    assert late_join(bus, a_publisher(bus), value) == 1


def test_latched_topic_has_a_token_at_which_returning_subscribers_find_the_value() -> None:
    bus = MemoryBus()
    publisher = a_publisher(bus)
    bus.pumps.append(lambda: publisher.reply_to_late_joiners(value))

    (token,) = bus.list_tokens(f"{ROS_KEY}/@adv/**")

    assert token == f"{ROS_KEY}/@adv/pub/{bus.zid}/uhlc/_"
    assert [reply.key for reply in bus.get(token)] == [ROS_KEY]


def test_latched_topic_does_not_reply_without_a_value() -> None:
    bus = MemoryBus()

    assert late_join(bus, a_publisher(bus), nothing) == 0


def test_other_topics_do_not_serve_late_joiners() -> None:
    bus = MemoryBus()

    a_factory(bus).publisher(PLAIN_TOPIC)

    assert not bus.is_served(f"{ROS_KEY}/@adv/**")


def test_command_of_either_type_and_of_any_hash_is_received() -> None:
    bus = MemoryBus()
    received = a_factory(bus).subscription("r1/cmd_vel", (Twist, TwistStamped), 8, 1000)

    bus.put("0/r1/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/RIHS01_5f0f", b"stamped")
    bus.put("0/r1/cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported", b"bare")
    bus.put("r1/cmd_vel", b"plain", "application/json")

    samples = [(sample.key, sample.payload, sample.encoding) for sample in received.take()]
    assert samples == [
        ("r1/cmd_vel", b"plain", "application/json"),
        ("r1/cmd_vel", b"bare", "application/cdr;geometry_msgs/msg/Twist"),
        ("r1/cmd_vel", b"stamped", "application/cdr;geometry_msgs/msg/TwistStamped"),
    ]


def test_command_in_another_domain_is_not_received() -> None:
    bus = MemoryBus()
    received = a_factory(bus).subscription("r1/cmd_vel", (Twist,), 8, 1000)

    bus.put("7/r1/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_9c45", b"other")

    assert received.newest() is None


def test_topics_have_plain_keys_only_without_ros() -> None:
    bus = MemoryBus()
    factory = TopicFactory(bus)

    publisher, received = (
        factory.publisher(TOPIC),
        factory.subscription("r1/cmd_vel", (Twist,), 8, 1000),
    )

    bus.subscribe(ROS_KEY)
    assert not publisher.is_matched
    assert bus.has_subscriber("r1/cmd_vel")
    assert not bus.has_subscriber("0/r1/cmd_vel/a/b")
    received.close()
    assert not bus.has_subscriber("r1/cmd_vel")


class Stamps:
    """Records the stamps of published messages, and makes stamps."""

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
    publisher = KeyPublisher(stamps, None, stamps.make)

    for payload in (b"1", b"1", b"2"):
        publisher.send(payload)

    first, again, changed = stamps.sent
    assert first is again
    assert changed is not first


def test_value_that_is_not_latched_is_not_stamped() -> None:
    stamps = Stamps()

    KeyPublisher(stamps).send(b"1")

    assert stamps.sent == [None]


class CountedValue:
    """Counts how often the value is made."""

    def __init__(self, message: String | None) -> None:
        self.message = message
        self.made = 0

    def __call__(self) -> String | None:
        self.made += 1
        return self.message


def test_lazy_publisher_publishes_its_value_when_there_is_a_subscriber() -> None:
    bus = MemoryBus()
    subscription = bus.subscribe("r1/description")
    publisher = LazyTopicPublisher(TopicFactory(bus), PLAIN_TOPIC, CountedValue(String("hello")))

    publisher.publish()

    (sample,) = subscription.take()
    assert sample.encoding == ENCODING
    assert decode(String, sample.payload, sample.encoding) == String("hello")


def test_lazy_publisher_publishes_bytes_unchanged() -> None:
    bus = MemoryBus()
    subscription = bus.subscribe("r1/description")

    LazyTopicPublisher(TopicFactory(bus), PLAIN_TOPIC, lambda: b"ready").publish()

    (sample,) = subscription.take()
    assert (sample.payload, sample.encoding) == (b"ready", ENCODING)


def test_lazy_publisher_makes_no_value_without_a_subscriber() -> None:
    value = CountedValue(String("hello"))

    LazyTopicPublisher(TopicFactory(MemoryBus()), PLAIN_TOPIC, value).publish()

    assert value.made == 0


def test_lazy_publisher_publishes_nothing_without_a_value() -> None:
    bus = MemoryBus()
    subscription = bus.subscribe("r1/description")

    LazyTopicPublisher(TopicFactory(bus), PLAIN_TOPIC, CountedValue(None)).publish()

    assert subscription.take() == []


def test_lazy_publisher_announces_once_to_each_first_subscription() -> None:
    bus = MemoryBus()
    publisher = LazyTopicPublisher(TopicFactory(bus), PLAIN_TOPIC, CountedValue(String("hello")))
    publisher.announce()

    subscription = bus.subscribe("r1/description", 8)
    publisher.announce()
    publisher.announce()
    assert len(subscription.take()) == 1

    subscription.close()
    publisher.announce()
    later = bus.subscribe("r1/description", 8)
    publisher.announce()
    assert len(later.take()) == 1


def test_lazy_publisher_replies_to_a_get_with_its_value() -> None:
    bus = MemoryBus()
    publisher = LazyTopicPublisher(TopicFactory(bus), PLAIN_TOPIC, CountedValue(String("hello")))
    bus.pumps.append(publisher.reply_to_queries)

    (sample,) = bus.get("r1/*")

    assert (sample.key, sample.encoding) == ("r1/description", ENCODING)
    assert decode(String, sample.payload) == String("hello")


def test_lazy_publisher_drops_a_query_without_a_value() -> None:
    bus = MemoryBus()
    publisher = LazyTopicPublisher(TopicFactory(bus), PLAIN_TOPIC, CountedValue(None))
    bus.pumps.append(publisher.reply_to_queries)

    assert bus.get("r1/description") == []


def test_lazy_publisher_undeclares_its_queryable_when_closed() -> None:
    bus = MemoryBus()

    LazyTopicPublisher(TopicFactory(bus), PLAIN_TOPIC, CountedValue(String("hello"))).close()

    assert not bus.is_served("r1/description")
