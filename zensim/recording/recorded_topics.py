"""Samples of the network as messages of a recording: topic, type, QoS, CDR bytes."""

import re
from collections.abc import Callable
from typing import Final

import msgspec

from zensim.proto.cmd_vel_decoding import MIN_STAMPED_BYTES
from zensim.proto.codec.cdr_layout import find_ros_class
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    detect_format,
    encode,
    parse_schema_name,
)
from zensim.proto.message_times import StampReader, make_stamp_reader, make_step_reader
from zensim.proto.messages.input_messages import ServiceRequest
from zensim.proto.messages.standard_messages import (
    Clock,
    String,
    Twist,
    TwistStamped,
    UInt8MultiArray,
)
from zensim.proto.network_protocols import Sample
from zensim.proto.ros2.message_definitions import write_definition
from zensim.proto.ros2.qos_profiles import (
    RELIABLE_10,
    RMW_DURABILITY,
    RMW_HISTORY,
    RMW_LIVELINESS,
    RMW_RELIABILITY,
    Qos,
    Word,
)
from zensim.proto.ros2.type_hash import hash_type
from zensim.proto.schema import find_cdr_type
from zensim.proto.topic_catalog import CLOCK, CMD_VEL, EVENTS, INPUTS, MAP, find_robot_topic
from zensim.recording.topic_selection import CLOCK_TOPIC, ROSTER_TOPICS, name_requests_topic

QOS_FIELD: Final = re.compile(r"\b(reliability|durability|history|depth): *([a-z_]+|[0-9]{1,9})")
ToCdr = Callable[[Sample], bytes]
AcceptsTopic = Callable[[str, str | None], bool]
"""Whether a topic of a name and a type is recorded; see `TopicFilter.accepts`."""
SPAN_PARTS: Final = (9223372036, 854775807)
"""Seconds and nanoseconds of an infinite time, as rmw writes it."""
QOS_METADATA: Final = "offered_qos_profiles"
HASH_METADATA: Final = "topic_type_hash"
"""Names of what ROS 2 keeps with a channel."""


class RecordedTopic(msgspec.Struct, frozen=True, eq=False):
    """A topic of a recording."""

    name: str
    kind: type[msgspec.Struct]
    qos: Qos
    read_stamp: StampReader
    to_cdr: ToCdr
    is_latched: bool = False

    @property
    def encoding(self) -> str:
        """Encoding of messages."""
        return "cdr"

    @property
    def schema_encoding(self) -> str:
        """Encoding of the definition of the type."""
        return "ros2msg"

    @property
    def schema(self) -> bytes:
        """Definition of the type."""
        return write_definition(self.kind).encode()

    @property
    def ros_type(self) -> str:
        """`pkg/msg/Name`."""
        return str(vars(find_ros_class(self.kind))["ros_type"])

    def metadata(self) -> dict[str, str]:
        """Write what ROS 2 keeps with a channel: QoS and type hash."""
        return {QOS_METADATA: write_qos_profiles(self.qos), HASH_METADATA: hash_type(self.kind)}


RecordedMessage = tuple[RecordedTopic, int, int, bytes]
"""Topic, log time [ns], publish time [ns], CDR."""


def write_qos_profiles(qos: Qos) -> str:
    """Write a profile as YAML with the numbers of rmw; Humble reads nothing else."""
    span = f"\n    sec: {SPAN_PARTS[0]}\n    nsec: {SPAN_PARTS[1]}"
    return (
        f"- history: {RMW_HISTORY[qos.history]}\n"
        f"  depth: {qos.depth}\n"
        f"  reliability: {RMW_RELIABILITY[qos.reliability]}\n"
        f"  durability: {RMW_DURABILITY[qos.durability]}\n"
        f"  deadline:{span}\n"
        f"  lifespan:{span}\n"
        f"  liveliness: {RMW_LIVELINESS[qos.liveliness]}\n"
        f"  liveliness_lease_duration:{span}\n"
        "  avoid_ros_namespace_conventions: false"
    )


def read_qos_profile(text: str) -> Qos:
    """Read reliability, durability, history and depth of the first profile in a text of YAML.

    Numbers are those of rmw; newer distributions write words. What is missing is as `RELIABLE_10`.
    """
    found: dict[str, str] = {}
    for name, value in QOS_FIELD.findall(text):
        found.setdefault(name, value)
    depth = found.get("depth", "")
    return Qos(
        reliability=_find_policy(RMW_RELIABILITY, found.get("reliability", ""), "reliable"),
        durability=_find_policy(RMW_DURABILITY, found.get("durability", ""), "volatile"),
        history=_find_policy(RMW_HISTORY, found.get("history", ""), "keep_last"),
        depth=int(depth) if depth.isdecimal() else RELIABLE_10.depth,
    )


def _find_policy(numbers: dict[Word, int], written: str, default: Word) -> Word:
    return next(
        (word for word, number in numbers.items() if written in (word, str(number))), default
    )


def make_clock_topic() -> RecordedTopic:
    """Make the topic `/clock`."""
    return RecordedTopic(CLOCK_TOPIC, Clock, CLOCK.qos, make_stamp_reader(Clock), _encode_clock)


def make_requests_topic(world: str, step_ns: int) -> RecordedTopic:
    """Make the topic of the requests that changed a world, as JSON; see `write_requests`."""
    read_stamp = make_step_reader(step_ns)
    name = name_requests_topic(world)
    return RecordedTopic(name, String, INPUTS.qos, read_stamp, lambda sample: sample.payload)


def write_request(request: ServiceRequest) -> bytes:
    """Write a request as JSON in a text; its own JSON is a part of it, unless it was cut."""
    fields = msgspec.structs.asdict(request)
    try:
        fields["request"] = msgspec.json.decode(request.request) if request.request else {}
        text = msgspec.json.encode(fields)
    except (msgspec.DecodeError, RecursionError):
        text = msgspec.json.encode({**fields, "request": request.request, "is_cut": True})
    return encode(String(text.decode()), Format.CDR)


def make_topic(sample: Sample, world: str, step_ns: int = 0) -> RecordedTopic | None:
    """Make the topic of a sample; None if its type is not known.

    Args:
        sample: With a plain key.
        world: Name of the world.
        step_ns: Physics step, of which events name the number; 0 = unknown.
    """
    name = f"/{sample.key}"
    for spec in ROSTER_TOPICS:
        if sample.key == spec.key(world):
            convert = _make_text_writer(spec.messages[0])
            read_stamp = make_step_reader(step_ns) if spec is EVENTS else make_stamp_reader(String)
            return RecordedTopic(name, String, spec.qos, read_stamp, convert)
    if sample.key == INPUTS.key(world):
        read_stamp = make_stamp_reader(UInt8MultiArray)
        return RecordedTopic(name, UInt8MultiArray, INPUTS.qos, read_stamp, _wrap_bytes)
    if (kind := _find_kind(sample)) is None:
        return None
    known = MAP if sample.key == MAP.suffix else find_robot_topic(sample.key)
    qos = known.qos if known is not None else RELIABLE_10
    is_latched = known is not None and known.is_latched
    convert = _make_cdr_writer(kind)
    return RecordedTopic(name, kind, qos, make_stamp_reader(kind), convert, is_latched)


def _find_kind(sample: Sample) -> type[msgspec.Struct] | None:
    if schema := parse_schema_name(sample.encoding):
        return find_cdr_type(schema)
    spec = find_robot_topic(sample.key)
    if spec is CMD_VEL and detect_format(sample.payload, sample.encoding) is Format.CDR:
        return TwistStamped if len(sample.payload) >= MIN_STAMPED_BYTES else Twist
    return spec.messages[0] if spec is not None else None


def _make_cdr_writer(kind: type[msgspec.Struct]) -> ToCdr:
    def to_cdr(sample: Sample) -> bytes:
        if sample.payload[:1] == b"\0":
            return sample.payload
        return encode(decode(kind, sample.payload, sample.encoding), Format.CDR)

    return to_cdr


def _make_text_writer(kind: type[msgspec.Struct]) -> ToCdr:
    """Write messages that are not CDR as JSON in a text: a bag has one serialization."""

    def to_cdr(sample: Sample) -> bytes:
        message = decode(kind, sample.payload, sample.encoding)
        return encode(String(msgspec.json.encode(message).decode()), Format.CDR)

    return to_cdr


def _wrap_bytes(sample: Sample) -> bytes:
    """Keep the bytes of a message that is not CDR as they came."""
    return encode(UInt8MultiArray(data=sample.payload), Format.CDR)


def _encode_clock(sample: Sample) -> bytes:
    return encode(Clock(decode(Clock, sample.payload, sample.encoding).clock), Format.CDR)


class TopicTable:
    """The topic of each key and encoding; looked up for each message."""

    def __init__(
        self,
        world: str,
        accepts: AcceptsTopic,
        step_ns: int = 0,
        note_key: Callable[[str], object] = len,
    ) -> None:
        """Know no topic yet.

        Args:
            world: Name of the world.
            accepts: Decides which topics are recorded.
            step_ns: See `make_topic`.
            note_key: Is called once with each key whose messages are recorded.
        """
        self._note_key = note_key
        self._world = world
        self._step_ns = step_ns
        self._accepts = accepts
        self._topics: dict[tuple[str, str], RecordedTopic | None] = {}
        self._kinds: dict[str, type[msgspec.Struct]] = {}
        self.unknown: set[str] = set()
        """Topics that are left out, since their type is not known, or is another than before."""

    def find(self, sample: Sample) -> RecordedTopic | None:
        """Find the topic of a sample with a plain key; None if it is not recorded."""
        key = sample.key, sample.encoding
        try:
            return self._topics[key]
        except KeyError:
            found = self._topics[key] = self._make(sample)
            return found

    def _make(self, sample: Sample) -> RecordedTopic | None:
        name = f"/{sample.key}"
        if not self._accepts(name, None):
            return None
        try:
            topic = make_topic(sample, self._world, self._step_ns)
        except MalformedPayload:
            topic = None
        if not self._accepts(name, topic.ros_type if topic is not None else ""):
            return None
        if topic is not None and self._kinds.setdefault(topic.name, topic.kind) is topic.kind:
            self._note_key(sample.key)
            return topic
        self.unknown.add(name)
        return None
