"""The odometry of all robots of an agent in few messages, published for subscribers only."""

from collections.abc import Iterable, Iterator, Sequence

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import STATE_COLUMNS, DriveState, FleetOdometry
from zensim.proto.network_protocols import AgentNetwork
from zensim.proto.topic_catalog import FLEET_ODOMETRY

MotionRows = tuple[Sequence[str], bytes]
"""Entities and their motions: `FleetOdometry.motions`."""
MAX_MOTION_BYTES = 60_000
"""Of the rows of a message: with its names and headers it fits a batch of 64 KiB. What is sent in
fragments is lost with any of them."""
ROW_BYTES = 8 * STATE_COLUMNS
MAX_NAME_BYTES = 5
"""Written before the characters of a name."""


class FleetOdometryPublisher:
    """Publishes the odometry of the robots of one agent."""

    def __init__(self, network: AgentNetwork, world: str, agent: str) -> None:
        """Declare the topic of an agent."""
        key = FLEET_ODOMETRY.key(world, agent)
        self._publisher = network.advertise(key, FLEET_ODOMETRY.encoding)

    @property
    def is_wanted(self) -> bool:
        """Whether there are subscribers."""
        return self._publisher.is_matched

    def publish(self, state: DriveState, rows: Iterable[MotionRows]) -> None:
        """Publish the odometry that a state made new."""
        for message in make_messages(state, rows):
            self._publisher.send(encode(message, Format.MSGPACK))

    def close(self) -> None:
        """Undeclare the topic."""
        self._publisher.close()


def make_messages(state: DriveState, rows: Iterable[MotionRows]) -> Iterator[FleetOdometry]:
    """Make messages of at most 64 KiB, in the order of the rows."""
    listed = list(rows)
    entities = tuple(name for names, _ in listed for name in names)
    if not entities:
        return
    motions = b"".join([part for _, part in listed])
    longest = max(map(len, entities))
    most = max(1, MAX_MOTION_BYTES // (ROW_BYTES + MAX_NAME_BYTES + longest))
    for start in range(0, len(entities), most):
        end = start + most
        yield FleetOdometry(
            state.epoch,
            state.step,
            state.time_ns,
            entities[start:end],
            motions[start * ROW_BYTES : end * ROW_BYTES],
        )
