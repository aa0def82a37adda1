"""One topic of many robots on plain and ROS 2 keys: publishers declared lazily, matched ones tracked."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

import msgspec
import numpy as np

from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.network_protocols import AgentNetwork, Publisher, Query
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint
from zensim.proto.ros2.rmw_attachment import ATTACHMENT_STRUCT, GID_BYTES
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic, gid_from_endpoint
from zensim.proto.topic_endpoints import CACHE_SUFFIX, KeyPublisher

ATTACHMENT_DTYPE: Final = np.dtype(
    [
        ("sequence_number", "<i8"),
        ("source_time_ns", "<i8"),
        ("length", "u1"),
        ("gid", "u1", GID_BYTES),
    ]
)
"""See `zensim.proto.ros2.rmw_attachment`."""


class AttachmentRows:
    """A row a publisher."""

    def __init__(self) -> None:
        self._rows = np.zeros(0, dtype=ATTACHMENT_DTYPE)
        self._free: list[int] = []

    def add(self, gid: bytes) -> int:
        """Take a publisher in that has sent nothing; return its row."""
        if not self._free:
            count = len(self._rows)
            self._rows = np.concatenate([self._rows, np.zeros(count + 1, dtype=ATTACHMENT_DTYPE)])
            self._free = list(range(len(self._rows) - 1, count - 1, -1))
        row = self._free.pop()
        self._rows[row] = (0, 0, GID_BYTES, np.frombuffer(gid, dtype=np.uint8))
        return row

    def remove(self, row: int) -> None:
        """Let a publisher go."""
        self._free.append(row)

    def write_next(self, rows: Sequence[int], time_ns: int) -> list[bytes]:
        """Write what goes with the next message of each of some rows, none of them twice."""
        at = np.array(rows, dtype=np.intp)
        self._rows["sequence_number"][at] += 1
        self._rows["source_time_ns"][at] = time_ns
        raw = self._rows[at].tobytes()
        return [
            raw[start : start + ATTACHMENT_STRUCT.size]
            for start in range(0, len(raw), ATTACHMENT_STRUCT.size)
        ]


MAX_CHECKED_AT_ONCE = 32
"""Publishers that are asked about in one go: a tenth of a millisecond."""
OwnerT = TypeVar("OwnerT")


class MatchedPublishers(Generic[OwnerT]):
    """Publishers by whose they are."""

    def __init__(self) -> None:
        self.heard: dict[OwnerT, Publisher] = {}
        """Those to put on."""
        self._all: dict[OwnerT, Publisher] = {}
        self._unchecked: list[OwnerT] = []

    def add(self, whose: OwnerT, publisher: Publisher) -> None:
        """Take a publisher in."""
        self._all[whose] = self.heard[whose] = publisher

    def remove(self, whose: OwnerT) -> None:
        """Withdraw a publisher."""
        if (publisher := self._all.pop(whose, None)) is not None:
            self.heard.pop(whose, None)
            publisher.close()

    def check_some(self) -> None:
        """Ask about the next ones, round and round."""
        if not self._unchecked:
            self._unchecked = list(self._all)
        some, self._unchecked = (
            self._unchecked[:MAX_CHECKED_AT_ONCE],
            self._unchecked[MAX_CHECKED_AT_ONCE:],
        )
        for whose in some:
            if (publisher := self._all.get(whose)) is None:
                continue
            if publisher.is_matched:
                self.heard[whose] = publisher
            else:
                self.heard.pop(whose, None)


QUERY_DEPTH = 256
MAX_ROS_DECLARED_AT_ONCE = 16
"""Tokens, or publishers, that are declared in one go: a millisecond or two."""


class LastValues(Protocol):
    """The last values of a topic, by row."""

    def payload(self, row: int) -> bytes | None:
        """Write the last value of a row as CDR; None while there is none."""


class RosTopicMember(Protocol):
    """One robot's part in a topic; see `outlet.Line`."""

    @property
    def key(self) -> str:
        """The plain key."""

    @property
    def values(self) -> LastValues:
        """Where its value is."""

    @property
    def row(self) -> int:
        """Which of them."""

    @property
    def node(self) -> RosNode | None:
        """The robot in ROS 2's graph."""


class RosFleetPublisher:
    """A topic on all of ROS 2's keys of one pattern."""

    def __init__(self, network: AgentNetwork, graph: RosGraph, topic: Topic) -> None:
        """Declare the topic.

        Args:
            network: Where.
            graph: Of the nodes that lines have.
            topic: Its key is the pattern of the lines' keys.
        """
        self._network = network
        self._topic = topic
        self._encoding = topic.encoding
        self._unjoined: list[RosTopicMember] = []
        self._joined: dict[RosTopicMember, GraphEndpoint] = {}
        self._faces: dict[RosTopicMember, KeyPublisher] = {}
        """Of a latched topic: what each says does not change."""
        self._matched = MatchedPublishers[RosTopicMember]()
        self._attachments = AttachmentRows()
        self._rows: dict[RosTopicMember, int] = {}
        """Of a topic whose messages are put: where each has its attachment."""
        self._ros_keys: dict[RosTopicMember, str] = {}
        self._graph = graph
        key = graph.data_key(topic)
        self._probe = network.advertise(key, self._encoding)
        cache = f"{key}/{CACHE_SUFFIX}/{graph.zid}/*/_"
        self._queries = network.serve(cache, QUERY_DEPTH) if topic.is_latched else None

    @property
    def is_wanted(self) -> bool:
        """Whether anybody listens to any of it."""
        return self._probe.is_matched

    def add(self, line: RosTopicMember) -> None:
        """Take a robot in; it is announced soon."""
        if line.node is not None:
            self._unjoined.append(line)
            self._ros_keys[line] = self._graph.data_key(self._make_topic(line))

    def remove(self, line: RosTopicMember) -> None:
        """Let a robot go; its node withdraws the token."""
        self._joined.pop(line, None)
        self._ros_keys.pop(line, None)
        if (face := self._faces.pop(line, None)) is not None:
            face.close()
        if (row := self._rows.pop(line, None)) is not None:
            self._attachments.remove(row)
            self._matched.remove(line)

    def declare_some(self) -> None:
        """Announce some of those that are not yet; and declare publishers when anybody listens."""
        if self._unjoined:
            some, self._unjoined = (
                self._unjoined[:MAX_ROS_DECLARED_AT_ONCE],
                self._unjoined[MAX_ROS_DECLARED_AT_ONCE:],
            )
            for line in some:
                self._join(line)
        elif not self.is_wanted:
            return
        elif len(self._faces) + len(self._rows) < len(self._joined):
            is_there = self._faces if self._topic.is_latched else self._rows
            missing = [line for line in self._joined if line not in is_there]
            for line in missing[:MAX_ROS_DECLARED_AT_ONCE]:
                self._declare(line)
        else:
            self._matched.check_some()

    def put(self, lines: Sequence[RosTopicMember], payloads: Sequence[bytes]) -> None:
        """Put a payload on each line that is heard; on those without a publisher yet nothing."""
        heard = self._matched.heard
        told = [
            (publisher, payload, self._rows[line])
            for line, payload in zip(lines, payloads, strict=True)
            if (publisher := heard.get(line)) is not None
        ]
        attachments = self._attachments.write_next([row for _, _, row in told], time.time_ns())
        for (publisher, payload, _), attachment in zip(told, attachments, strict=True):
            publisher.send(payload, attachment)

    def answer(self) -> None:
        """Tell last values to those who have come late."""
        for call in self._queries.take() if self._queries is not None else ():
            for line in self._asked(call):
                self._reply_with_last(line, call)
            call.drop()

    def close(self) -> None:
        """Withdraw the topic."""
        for line in tuple(self._ros_keys):
            self.remove(line)
        self._probe.close()
        if self._queries is not None:
            self._queries.close()

    def _make_topic(self, line: RosTopicMember) -> Topic:
        return msgspec.structs.replace(self._topic, key=line.key)

    def _join(self, line: RosTopicMember) -> GraphEndpoint | None:
        if line.node is None or line not in self._ros_keys:
            return None
        if line not in self._joined:
            self._joined[line] = line.node.add_topic_endpoint("MP", self._make_topic(line))
        return self._joined[line]

    def _declare(self, line: RosTopicMember) -> None:
        if line in self._faces or (endpoint := self._join(line)) is None:
            return
        publisher = self._network.advertise(self._ros_keys[line], self._encoding)
        if not self._topic.is_latched:
            self._rows[line] = self._attachments.add(gid_from_endpoint(endpoint))
            self._matched.add(line, publisher)
            return
        face = self._faces[line] = KeyPublisher(publisher, endpoint, self._network.stamp)
        if publisher.is_matched and (payload := line.values.payload(line.row)) is not None:
            face.send(payload)

    def _reply_with_last(self, line: RosTopicMember, call: Query) -> None:
        self._declare(line)
        payload, face = line.values.payload(line.row), self._faces.get(line)
        if payload is not None and face is not None:
            face.add_reply(call, self._ros_keys[line], payload, self._encoding)

    def _asked(self, call: Query) -> Iterator[RosTopicMember]:
        wanted, is_cached, _ = call.key.partition("/@adv/")
        for line, key in tuple(self._ros_keys.items()):
            if (
                key == wanted
                if is_cached and "*" not in wanted
                else call.covers(self._make_cache_key(key))
            ):
                yield line

    def _make_cache_key(self, key: str) -> str:
        return f"{key}/{CACHE_SUFFIX}/{self._graph.zid}/0/_"


MAX_DECLARED_AT_ONCE = 32
"""Publishers that are declared, or asked who listens, in one go: a few milliseconds."""


@dataclass(eq=False)
class TopicMember:
    """One robot's part in a topic."""

    key: str
    values: LastValues
    row: int = 0
    node: RosNode | None = None
    publisher: Publisher | None = None
    was_matched: bool = False


class FleetTopicPublisher:
    """A topic on all keys of one pattern; payloads in, puts where somebody listens."""

    def __init__(
        self,
        network: AgentNetwork,
        pattern: str,
        message_type: type[msgspec.Struct],
        ros: RosFleetPublisher | None = None,
    ) -> None:
        """Declare the topic.

        Args:
            network: Where.
            pattern: Of the keys that lines have; see `zensim.proto.keys.make_pattern`.
            message_type: What payloads are; they travel as CDR.
            ros: The same on ROS 2's keys.
        """
        self._ros = ros
        self._network = network
        self._encoding = make_encoding(message_type, Format.CDR)
        self._lines: dict[str, list[TopicMember]] = {}
        self._undeclared: list[TopicMember] = []
        self._unannounced: list[TopicMember] = []
        self._has_announced = False
        self._matched = MatchedPublishers[TopicMember]()
        self._has_put = False
        self._probe = network.advertise(pattern, self._encoding)
        # Other pools have other robots on the same pattern.
        self._queries = network.serve(pattern, QUERY_DEPTH, is_complete=False)

    @property
    def is_wanted(self) -> bool:
        """Whether anybody listens to any of it."""
        return self._probe.is_matched or (self._ros is not None and self._ros.is_wanted)

    @property
    def is_empty(self) -> bool:
        """Whether no robot is left."""
        return not self._lines

    def add(self, line: TopicMember) -> None:
        """Take a robot in; its publisher is declared once somebody listens."""
        self._lines.setdefault(line.key, []).append(line)
        self._undeclared.append(line)
        if self._ros is not None:
            self._ros.add(line)

    def remove(self, line: TopicMember) -> None:
        """Let a robot go."""
        left = [one for one in self._lines.pop(line.key, ()) if one is not line]
        if left:
            self._lines[line.key] = left
        self._matched.remove(line)
        line.publisher = None
        if self._ros is not None:
            self._ros.remove(line)

    def declare_some(self) -> None:
        """Declare some of the publishers that are missing, when anybody listens; see who does."""
        if self._ros is not None:
            self._ros.declare_some()
        if not self._lines or not self._probe.is_matched:
            return
        if self._has_put and not self._undeclared:
            self._matched.check_some()
            self._has_put = False
        some, self._undeclared = (
            self._undeclared[:MAX_DECLARED_AT_ONCE],
            self._undeclared[MAX_DECLARED_AT_ONCE:],
        )
        for line in some:
            if line in self._lines.get(line.key, ()):
                line.publisher = self._network.advertise(line.key, self._encoding)
                self._matched.add(line, line.publisher)

    def put(self, lines: Sequence[TopicMember], payloads: Sequence[bytes]) -> None:
        """Put a payload on each line that is heard; on those without a publisher yet nothing."""
        self._has_put = True
        heard = self._matched.heard if self._probe.is_matched else {}
        for line, payload in zip(lines, payloads, strict=True) if heard else ():
            if (publisher := heard.get(line)) is not None:
                publisher.send(payload)
        if self._ros is not None:
            self._ros.put(lines, payloads)

    def announce(self) -> None:
        """Begin to put last values where somebody has begun to listen; see `announce_some`."""
        if self._unannounced:
            return
        lines = [line for lines in self._lines.values() for line in lines]
        if self.is_wanted:
            self._unannounced = lines
        elif self._has_announced:
            for line in lines:
                line.was_matched = False
            self._has_announced = False

    def announce_some(self) -> None:
        """Go on with what `announce` has begun, by a part of the robots."""
        if not self._unannounced:
            return
        self._has_announced = True
        some, self._unannounced = (
            self._unannounced[:MAX_DECLARED_AT_ONCE],
            self._unannounced[MAX_DECLARED_AT_ONCE:],
        )
        for line in some:
            _publish_if_newly_matched(line)

    def answer(self) -> None:
        """Tell last values to everybody who has asked; those of other pools are told by them."""
        for call in self._queries.take():
            answers = [
                (line.key, payload)
                for line in self._asked(call)
                if (payload := line.values.payload(line.row)) is not None
            ]
            if answers:
                call.reply_each(answers, self._encoding)
            else:
                call.drop()
        if self._ros is not None:
            self._ros.answer()

    def close(self) -> None:
        """Withdraw the topic."""
        for line in [line for lines in self._lines.values() for line in lines]:
            self.remove(line)
        self._probe.close()
        self._queries.close()
        if self._ros is not None:
            self._ros.close()

    def _asked(self, call: Query) -> Iterator[TopicMember]:
        if call.key in self._lines:
            yield from self._lines[call.key]
        elif "*" in call.key:
            for key, lines in self._lines.items():
                if call.covers(key):
                    yield from lines


def _publish_if_newly_matched(line: TopicMember) -> None:
    if line.publisher is None:
        return
    is_matched = line.publisher.is_matched
    if is_matched and not line.was_matched:
        payload = line.values.payload(line.row)
        if payload is not None:
            line.publisher.send(payload)
    line.was_matched = is_matched
