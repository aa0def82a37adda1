"""Samples become messages of a recording: type, bytes, time."""

import msgspec
import pytest

from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.message_times import choose_time, make_stamp_reader
from zensim.proto.messages.standard_messages import (
    Header,
    Odometry,
    String,
    TFMessage,
    Time,
    TransformStamped,
    Twist,
    TwistStamped,
)
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.network_protocols import Sample
from zensim.recording.recorded_topics import TopicTable

STAMP = Time(12, 345)
STAMP_NS = 12_000_000_345
CLOCK_NS = 12_100_000_000


def make_sample(key: str, message: msgspec.Struct, format_: Format = Format.CDR) -> Sample:
    return Sample(key, encode(message, format_), make_encoding(message, format_))


def make_table() -> TopicTable:
    return TopicTable("default", lambda *_: True)


def test_bytes_of_a_message_remain() -> None:
    sample = make_sample("r1/odom", Odometry(Header(STAMP, "odom")))

    topic = make_table().find(sample)

    assert topic is not None
    assert (topic.name, topic.ros_type) == ("/r1/odom", "nav_msgs/msg/Odometry")
    assert topic.to_cdr(sample) is sample.payload


def test_json_command_is_recorded_as_cdr() -> None:
    command = Twist()
    sample = make_sample("r1/cmd_vel", command, Format.JSON)

    topic = make_table().find(sample)

    assert topic is not None
    assert topic.to_cdr(sample) == encode(command, Format.CDR)


def test_stamped_command_without_a_type_is_known_by_its_length() -> None:
    sample = Sample("r1/cmd_vel", encode(TwistStamped(), Format.CDR), "")

    topic = make_table().find(sample)

    assert topic is not None
    assert topic.kind is TwistStamped


def test_event_is_recorded_as_json_in_a_text() -> None:
    event = Event("spawned", entity="r1", step=7)
    sample = make_sample("sim/default/events", event, Format.MSGPACK)

    topic = make_table().find(sample)

    assert topic is not None
    assert topic.ros_type == "std_msgs/msg/String"
    text = decode(String, topic.to_cdr(sample)).data
    assert msgspec.json.decode(text, type=Event) == event


def test_unknown_type_is_left_out_and_named() -> None:
    table = make_table()

    assert table.find(Sample("plan", b"\0\1\0\0", "application/cdr;my_msgs/msg/Plan")) is None
    assert table.unknown == {"/plan"}


def test_second_type_of_a_topic_is_left_out() -> None:
    table = make_table()

    assert table.find(make_sample("r1/cmd_vel", Twist())) is not None
    assert table.find(make_sample("r1/cmd_vel", TwistStamped())) is None


def test_latched_topics_have_their_qos() -> None:
    topic = make_table().find(make_sample("r1/tf_static", TFMessage()))

    assert topic is not None
    assert topic.is_latched
    qos = topic.metadata()["offered_qos_profiles"]
    assert "durability: 1\n" in qos
    assert "depth: 1\n" in qos


@pytest.mark.parametrize(
    ("message", "stamp_ns"),
    [
        (Odometry(Header(STAMP, "odom")), STAMP_NS),
        (TFMessage((TransformStamped(Header(STAMP)),)), STAMP_NS),
        (TFMessage(), None),
        (String("text"), None),
        (Twist(), None),
    ],
    ids=["header", "transform", "empty", "text", "twist"],
)
def test_stamp_is_read_from_the_bytes(message: msgspec.Struct, stamp_ns: int | None) -> None:
    read = make_stamp_reader(type(message))

    assert read(encode(message, Format.CDR)) == stamp_ns
    assert read(b"\0\1\0\0") is None


@pytest.mark.parametrize(
    ("stamp_ns", "time_ns"),
    [(STAMP_NS, STAMP_NS), (None, CLOCK_NS), (1_700_000_000_000_000_000, CLOCK_NS), (0, CLOCK_NS)],
    ids=["simulation", "none", "time of day", "zero"],
)
def test_time_is_the_stamp_unless_it_is_of_another_clock(
    stamp_ns: int | None, time_ns: int
) -> None:
    assert choose_time(stamp_ns, CLOCK_NS) == time_ns
