"""The odometry of all robots of an agent in few messages, published for subscribers only."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import STATE_COLUMNS, DriveState, FleetOdometry
from zensim.proto.network_protocols import AgentNetwork
from zensim.proto.topic_catalog import FLEET_ODOMETRY

MAX_MOTION_BYTES = 60_000
"""Most bytes of the rows of a message: with its names and headers it fits a batch of 64 KiB. What
is sent in fragments is lost with any of them."""
MAX_SENT_AT_ONCE = 6
"""Messages of one step that are sent in one poll. A link holds 16, a router gets those of several
agents at once, and what does not fit is lost."""
ROW_BYTES = 8 * STATE_COLUMNS
MAX_NAME_BYTES = 5
"""Written before the characters of a name."""


class MotionRows(NamedTuple):
    """Odometry of robots with equally many joints and equal rates; see `FleetOdometry`."""

    entities: Sequence[str]
    motions: bytes
    joint_positions: bytes
    has_own_tf_rate: bool = False

    def measure_row(self) -> int:
        """Measure the longest row in a message [bytes]."""
        joints = len(self.joint_positions) // max(1, len(self.entities))
        return ROW_BYTES + joints + MAX_NAME_BYTES + max(map(len, self.entities), default=0)

    def cut(self, start: int, end: int) -> "MotionRows":
        """Take some rows."""
        joints = len(self.joint_positions) // max(1, len(self.entities))
        return MotionRows(
            self.entities[start:end],
            self.motions[start * ROW_BYTES : end * ROW_BYTES],
            self.joint_positions[start * joints : end * joints],
            self.has_own_tf_rate,
        )


class FleetOdometryPublisher:
    """Publishes the odometry of the robots of one agent."""

    def __init__(self, network: AgentNetwork, world: str, agent: str) -> None:
        """Declare the topic of an agent."""
        key = FLEET_ODOMETRY.key(world, agent)
        self._publisher = network.advertise(key, FLEET_ODOMETRY.encoding)
        self._unsent: deque[FleetOdometry] = deque()

    @property
    def is_wanted(self) -> bool:
        """Whether there are subscribers."""
        return self._publisher.is_matched

    def publish(self, state: DriveState, rows: Iterable[MotionRows]) -> None:
        """Publish the odometry that a state made new."""
        self.begin(state, rows)
        self._send(len(self._unsent))

    def begin(self, state: DriveState, rows: Iterable[MotionRows]) -> None:
        """Publish a part of the odometry that a state made new; `send_some` sends the rest."""
        self._send(len(self._unsent))
        self._unsent.extend(make_messages(state, rows))
        self.send_some()

    def send_some(self) -> None:
        """Send the next messages of the last state, if there are any."""
        self._send(min(MAX_SENT_AT_ONCE, len(self._unsent)))

    def _send(self, count: int) -> None:
        for _ in range(count):
            self._publisher.send(encode(self._unsent.popleft(), Format.MSGPACK))

    def close(self) -> None:
        """Send what is left, and undeclare the topic."""
        self._send(len(self._unsent))
        self._publisher.close()


def make_messages(state: DriveState, rows: Iterable[MotionRows]) -> Iterator[FleetOdometry]:
    """Make messages of at most 64 KiB, in the order of the rows."""
    parts: list[MotionRows] = []
    room = MAX_MOTION_BYTES
    for one in rows:
        start, count, size = 0, len(one.entities), one.measure_row()
        if parts and parts[0].has_own_tf_rate != one.has_own_tf_rate:
            yield _join(state, parts)
            parts, room = [], MAX_MOTION_BYTES
        while start < count:
            most = room // size
            if not most and parts:
                yield _join(state, parts)
                parts, room = [], MAX_MOTION_BYTES
                continue
            part = one.cut(start, start + max(1, most))
            parts.append(part)
            start += len(part.entities)
            room -= size * len(part.entities)
    if parts:
        yield _join(state, parts)


def _join(state: DriveState, parts: Sequence[MotionRows]) -> FleetOdometry:
    return FleetOdometry(
        state.epoch,
        state.step,
        state.time_ns,
        tuple(name for one in parts for name in one.entities),
        b"".join([one.motions for one in parts]),
        b"".join([one.joint_positions for one in parts]),
        parts[0].has_own_tf_rate,
    )
