"""One topic of many robots on ROS 2's keys, beside the plain ones of its `outlet.FleetOutlet`.

One publisher on a pattern sees whoever listens to any robot; tokens, and then publishers, are
declared a few at a time.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Protocol

import msgspec

from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic, gid_from_endpoint
from zensim.proto.topic_endpoints import CACHE_SUFFIX, KeyPublisher
from zensim.robot_agent.network import Call, Network
from zensim.robot_agent.pool.attachments import Attachments
from zensim.robot_agent.pool.audience import Audience

QUERY_DEPTH = 256
AT_ONCE = 16
"""Tokens, or publishers, that are declared in one go: a millisecond or two."""


class Values(Protocol):
    """The last values of a topic, by row."""

    def payload(self, row: int) -> bytes | None:
        """Write the last value of a row as CDR; None while there is none."""


class Line(Protocol):
    """One robot's part in a topic; see `outlet.Line`."""

    @property
    def key(self) -> str:
        """The plain key."""

    @property
    def values(self) -> Values:
        """Where its value is."""

    @property
    def row(self) -> int:
        """Which of them."""

    @property
    def node(self) -> RosNode | None:
        """The robot in ROS 2's graph."""


class RosFace:
    """A topic on all of ROS 2's keys of one pattern."""

    def __init__(self, network: Network, graph: RosGraph, topic: Topic) -> None:
        """Declare the topic.

        Args:
            network: Where.
            graph: Of the nodes that lines have.
            topic: Its key is the pattern of the lines' keys.
        """
        self._network = network
        self._topic = topic
        self._encoding = make_encoding(topic.kind, Format.CDR)
        self._unjoined: list[Line] = []
        self._joined: dict[Line, GraphEndpoint] = {}
        self._faces: dict[Line, KeyPublisher] = {}
        """Of a latched topic: what each says does not change."""
        self._audience = Audience[Line]()
        self._attachments = Attachments()
        self._rows: dict[Line, int] = {}
        """Of a topic whose messages are put: where each has its attachment."""
        self._ros_keys: dict[Line, str] = {}
        self._graph = graph
        key = graph.data_key(topic)
        self._probe = network.advertise(key, self._encoding)
        cache = f"{key}/{CACHE_SUFFIX}/{graph.zid}/*/_"
        self._queries = network.serve(cache, QUERY_DEPTH) if topic.is_latched else None

    @property
    def is_wanted(self) -> bool:
        """Whether anybody listens to any of it."""
        return self._probe.is_matched

    def add(self, line: Line) -> None:
        """Take a robot in; it is announced soon."""
        if line.node is not None:
            self._unjoined.append(line)
            self._ros_keys[line] = self._graph.data_key(self._of(line))

    def remove(self, line: Line) -> None:
        """Let a robot go; its node withdraws the token."""
        self._joined.pop(line, None)
        self._ros_keys.pop(line, None)
        if (face := self._faces.pop(line, None)) is not None:
            face.close()
        if (row := self._rows.pop(line, None)) is not None:
            self._attachments.remove(row)
            self._audience.remove(line)

    def declare_some(self) -> None:
        """Announce some of those that are not yet; and declare publishers when anybody listens."""
        if self._unjoined:
            some, self._unjoined = self._unjoined[:AT_ONCE], self._unjoined[AT_ONCE:]
            for line in some:
                self._join(line)
        elif not self.is_wanted:
            return
        elif len(self._faces) + len(self._rows) < len(self._joined):
            is_there = self._faces if self._topic.is_latched else self._rows
            missing = [line for line in self._joined if line not in is_there]
            for line in missing[:AT_ONCE]:
                self._declare(line)
        else:
            self._audience.ask_some()

    def put(self, lines: Sequence[Line], payloads: Sequence[bytes]) -> None:
        """Put a payload on each line that is heard; on those without a publisher yet nothing."""
        heard = self._audience.heard
        told = [
            (publisher, payload, self._rows[line])
            for line, payload in zip(lines, payloads, strict=True)
            if (publisher := heard.get(line)) is not None
        ]
        attachments = self._attachments.following([row for _, _, row in told], time.time_ns())
        for (publisher, payload, _), attachment in zip(told, attachments, strict=True):
            publisher.send(payload, attachment)

    def answer(self) -> None:
        """Tell last values to those who have come late."""
        for call in self._queries.take() if self._queries is not None else ():
            for line in self._asked(call):
                self._tell(line, call)
            call.drop()

    def close(self) -> None:
        """Withdraw the topic."""
        for line in tuple(self._ros_keys):
            self.remove(line)
        self._probe.close()
        if self._queries is not None:
            self._queries.close()

    def _of(self, line: Line) -> Topic:
        return msgspec.structs.replace(self._topic, key=line.key)

    def _join(self, line: Line) -> GraphEndpoint | None:
        if line.node is None or line not in self._ros_keys:
            return None
        if line not in self._joined:
            self._joined[line] = line.node.add_topic_endpoint("MP", self._of(line))
        return self._joined[line]

    def _declare(self, line: Line) -> None:
        if line in self._faces or (endpoint := self._join(line)) is None:
            return
        publisher = self._network.advertise(self._ros_keys[line], self._encoding)
        if not self._topic.is_latched:
            self._rows[line] = self._attachments.add(gid_from_endpoint(endpoint))
            self._audience.add(line, publisher)
            return
        face = self._faces[line] = KeyPublisher(publisher, endpoint, self._network.stamp)
        if publisher.is_matched and (payload := line.values.payload(line.row)) is not None:
            face.send(payload)

    def _tell(self, line: Line, call: Call) -> None:
        self._declare(line)
        payload, face = line.values.payload(line.row), self._faces.get(line)
        if payload is not None and face is not None:
            face.add_reply(call, self._ros_keys[line], payload, self._encoding)

    def _asked(self, call: Call) -> Iterator[Line]:
        wanted, is_cached, _ = call.key.partition("/@adv/")
        for line, key in tuple(self._ros_keys.items()):
            if key == wanted if is_cached and "*" not in wanted else call.covers(self._place(key)):
                yield line

    def _place(self, key: str) -> str:
        return f"{key}/{CACHE_SUFFIX}/{self._graph.zid}/0/_"
