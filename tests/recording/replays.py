"""Recordings to replay, and a sink that keeps what is published."""

from pathlib import Path

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import (
    Header,
    Odometry,
    String,
    TFMessage,
    TransformStamped,
)
from zensim.proto.ros2.qos_profiles import LATCHED, RELIABLE_10, Qos
from zensim.recording.mcap_records import Channel, Metadata, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.output_file import OutputFile
from zensim.recording.recorded_topics import HASH_METADATA, QOS_METADATA, write_qos_profiles
from zensim.recording.recording_reader import StoredTopic, accept_all

SECOND = 1_000_000_000
PERIOD_NS = 100_000_000
START_NS = 5 * SECOND
TYPE_HASH = "RIHS01_" + "ab" * 32

ODOM, TF_STATIC, DESCRIPTION, EVENTS, CUSTOM = 1, 2, 3, 4, 5
TOPICS: dict[int, tuple[str, str, Qos]] = {
    ODOM: ("/r1/odom", "nav_msgs/msg/Odometry", RELIABLE_10),
    TF_STATIC: ("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED),
    DESCRIPTION: ("/r1/robot_description", "std_msgs/msg/String", LATCHED),
    EVENTS: ("/sim/default/events", "std_msgs/msg/String", RELIABLE_10),
    CUSTOM: ("/r1/custom", "my_msgs/msg/Own", RELIABLE_10),
    6: ("/clock", "rosgraph_msgs/msg/Clock", RELIABLE_10),
    7: ("/sim/default/inputs", "std_msgs/msg/UInt8MultiArray", RELIABLE_10),
}


def make_odometry(number: int) -> bytes:
    return encode(Odometry(Header(frame_id=str(number))), Format.CDR)


def make_transforms(*children: str) -> bytes:
    transforms = tuple(TransformStamped(child_frame_id=child) for child in children)
    return encode(TFMessage(transforms), Format.CDR)


def make_text(text: str) -> bytes:
    return encode(String(text), Format.CDR)


def write_run(path: Path, seconds: float = 10.0, *, start_ns: int = START_NS) -> None:
    """Write odometry at 10 Hz; latched messages a moment after the start; an event at 2 s."""
    output = OutputFile(path)
    writer = McapWriter(output)
    for number, (name, ros_type, qos) in TOPICS.items():
        writer.define(Schema(number, ros_type, "ros2msg", b""))
        metadata = {QOS_METADATA: write_qos_profiles(qos), HASH_METADATA: TYPE_HASH}
        writer.define(Channel(number, number, name, "cdr", metadata))
    for number in range(round(seconds * 10) + 1):
        time_ns = start_ns + number * PERIOD_NS
        writer.write_message(ODOM, time_ns, time_ns, make_odometry(number))
        writer.write_message(6, time_ns, time_ns, bytes(12))
        if number == 1:
            writer.write_message(TF_STATIC, time_ns, time_ns, make_transforms("r1/a"))
            writer.write_message(TF_STATIC, time_ns, time_ns, make_transforms("r2/a"))
            writer.write_message(DESCRIPTION, time_ns, time_ns, make_text("<robot/>"))
        if number == 20:
            event = '{"kind":"spawned","name":"r1"}'
            writer.write_message(EVENTS, time_ns, time_ns, make_text(event))
            writer.write_message(7, time_ns, time_ns, bytes(8))
            writer.write_message(CUSTOM, time_ns, time_ns, bytes(8))
        if number == 40:
            writer.write_message(DESCRIPTION, time_ns, time_ns, make_text("<robot2/>"))
        if number % 25 == 24:
            writer.flush()
    writer.flush()
    writer.add_metadata(Metadata("zensim", {"step_ns": "1000000"}))
    writer.close()
    output.close()


class KeptMessages:
    """Keeps what a replay publishes."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, bytes]] = []
        self.clock: list[tuple[int, int]] = []

    def publish(self, topic: StoredTopic, payload: bytes) -> None:
        self.messages.append((topic.name, payload))

    def publish_clock(self, time_ns: int, epoch: int) -> None:
        self.clock.append((time_ns, epoch))

    @property
    def odometry(self) -> list[bytes]:
        """Payloads on `/r1/odom`."""
        return [payload for name, payload in self.messages if name == "/r1/odom"]


def is_replayed(topic: StoredTopic) -> bool:
    """Whether a topic is no clock."""
    return accept_all(topic) and topic.name != "/clock"
