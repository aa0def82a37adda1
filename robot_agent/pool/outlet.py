"""One topic of many robots: the seam that everything a pool tells leaves through.

Whoever listens to any robot's odometry is seen by one publisher on a pattern, such as `*/odom`: a
thousand robots that nobody listens to cost one look. Publishers of single robots are declared when
somebody listens, a few at a time, for declaring takes longer than putting.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import msgspec

from zensim.proto.codec.message_codec import Format, make_encoding
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.topic_endpoints import TransportPublisher
from zensim.robot_agent.network import Call, Network
from zensim.robot_agent.pool.audience import Audience
from zensim.robot_agent.pool.ros_face import RosFace

QUERY_DEPTH = 256
AT_ONCE = 32
"""Publishers that are declared, or asked who listens, in one go: a few milliseconds."""


class Values(Protocol):
    """The last values of a topic, by row."""

    def payload(self, row: int) -> bytes | None:
        """Write the last value of a row as CDR; None while there is none."""


@dataclass(eq=False)
class Line:
    """One robot's part in a topic."""

    key: str
    values: Values
    row: int = 0
    node: RosNode | None = None
    publisher: TransportPublisher | None = None
    was_matched: bool = False


class FleetOutlet:
    """A topic on all keys of one pattern; payloads in, puts where somebody listens."""

    def __init__(
        self,
        network: Network,
        pattern: str,
        message_type: type[msgspec.Struct],
        ros: RosFace | None = None,
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
        self._lines: dict[str, list[Line]] = {}
        self._undeclared: list[Line] = []
        self._unannounced: list[Line] = []
        self._has_announced = False
        self._audience = Audience[Line]()
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

    def add(self, line: Line) -> None:
        """Take a robot in; its publisher is declared once somebody listens."""
        self._lines.setdefault(line.key, []).append(line)
        self._undeclared.append(line)
        if self._ros is not None:
            self._ros.add(line)

    def remove(self, line: Line) -> None:
        """Let a robot go."""
        left = [one for one in self._lines.pop(line.key, ()) if one is not line]
        if left:
            self._lines[line.key] = left
        self._audience.remove(line)
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
            self._audience.ask_some()
            self._has_put = False
        some, self._undeclared = self._undeclared[:AT_ONCE], self._undeclared[AT_ONCE:]
        for line in some:
            if line in self._lines.get(line.key, ()):
                line.publisher = self._network.advertise(line.key, self._encoding)
                self._audience.add(line, line.publisher)

    def put(self, lines: Sequence[Line], payloads: Sequence[bytes]) -> None:
        """Put a payload on each line that is heard; on those without a publisher yet nothing."""
        self._has_put = True
        heard = self._audience.heard if self._probe.is_matched else {}
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
        some, self._unannounced = self._unannounced[:AT_ONCE], self._unannounced[AT_ONCE:]
        for line in some:
            _announce(line)

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

    def _asked(self, call: Call) -> Iterator[Line]:
        if call.key in self._lines:
            yield from self._lines[call.key]
        elif "*" in call.key:
            for key, lines in self._lines.items():
                if call.covers(key):
                    yield from lines


def _announce(line: Line) -> None:
    if line.publisher is None:
        return
    is_matched = line.publisher.is_matched
    if is_matched and not line.was_matched:
        payload = line.values.payload(line.row)
        if payload is not None:
            line.publisher.send(payload)
    line.was_matched = is_matched
