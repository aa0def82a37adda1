"""Small recordings for tests, and what readers that are not ours find in them."""

from collections.abc import Iterable
from pathlib import Path

import msgspec
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.standard_messages import Header, Odometry, String, Time
from zensim.proto.network_protocols import Sample
from zensim.proto.ros2.message_definitions import write_definition
from zensim.recording.mcap_records import AttachedFile, Channel, Metadata, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.output_file import OutputFile
from zensim.recording.recorded_topics import RecordedTopic, TopicTable

KINDS = (Odometry, String)


def make_topic(key: str, kind: type[msgspec.Struct]) -> RecordedTopic:
    """Make the topic of a plain key."""
    message = kind()
    sample = Sample(key, encode(message, Format.CDR), make_encoding(kind, Format.CDR))
    topic = TopicTable("default", lambda *_: True).find(sample)
    assert topic is not None
    return topic


def define_topics(writer: McapWriter, robots: int = 1) -> list[int]:
    """Define an odometry topic for each robot, and `/events`; return their channels."""
    for number, kind in enumerate(KINDS, 1):
        text = write_definition(kind).encode()
        writer.define(Schema(number, str(vars(kind)["ros_type"]), "ros2msg", text))
    topics = [(1, f"/r{number}/odom") for number in range(robots)] + [(2, "/events")]
    for number, (schema, topic) in enumerate(topics, 1):
        writer.define(Channel(number, schema, topic, "cdr", {}))
    return list(range(1, robots + 1))


def write_recording(
    path: Path,
    messages: int,
    *,
    robots: int = 3,
    is_closed: bool = True,
    metadata: Iterable[Metadata] = (),
) -> None:
    """Write odometry at 50 Hz with chunks of about a hundred messages."""
    output = OutputFile(path)
    writer = McapWriter(output)
    channels = define_topics(writer, robots)
    for number in range(messages):
        time_ns = number * 20_000_000
        stamp = Time(time_ns // 1_000_000_000, time_ns % 1_000_000_000)
        payload = encode(Odometry(Header(stamp, f"odom_{number}")), Format.CDR)
        writer.write_message(channels[number % robots], time_ns, time_ns + 7, payload)
        if number % 100 == 99:
            writer.flush()
    writer.attach(AttachedFile("world.sdf", "text/xml", b"<sdf/>"))
    for one in metadata:
        writer.add_metadata(one)
    writer.flush()
    if is_closed:
        writer.close()
    output.close()


def count_by_rosbags(path: Path) -> dict[str, int]:
    """Count the messages of each topic with rosbags."""
    counts: dict[str, int] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, _, _ in reader.messages():
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
    return counts


def count_by_mcap(path: Path) -> dict[str, int]:
    """Read all messages with mcap and mcap-ros2-support, and check all checksums."""
    counts: dict[str, int] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, _ in reader.iter_decoded_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(counts.values())
    return counts
