"""The agent that drives all robots of a world in its process, and what the loop publishes to it."""

from typing import Final

import msgspec

from zensim.proto.codec.message_codec import Format
from zensim.proto.memory_bus import MemoryBus
from zensim.proto.messages.agent_messages import DriveCommand, DriveState
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.topic_catalog import CONTACTS, SCENE_STATE, TopicSpec
from zensim.robot_agent.bumpers import read_contact_report
from zensim.robot_agent.fleet_odometry import FleetOdometryPublisher
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.sim_server.runtime.loop_channels import BusWorldPublisher

POOL: Final = "pool"
"""Name of the agent that drives all robots."""
CMD_VEL_TIMEOUT_NS: Final = 500_000_000
"""Default of a pool: see `AgentConfig.cmd_vel_timeout_s`."""


class WorldPool:
    """Drives the robots of a world as an agent does, when it is called.

    Attributes:
        robots: All robots of the world.
        epoch: Of the last state that was answered.
    """

    def __init__(self, bus: MemoryBus, world: str) -> None:
        """Drive nothing yet.

        Args:
            bus: Of the robots' topics.
            world: Name of the world.
        """
        self.robots = PooledRobots(bus, CMD_VEL_TIMEOUT_NS)
        self.epoch = 0
        self._odometry = FleetOdometryPublisher(bus, world, POOL)

    def answer(self, state: DriveState) -> DriveCommand | None:
        """Drive the robots of a state, and publish their telemetry; None if there are none."""
        if state.epoch != self.epoch:
            self.epoch = state.epoch
            self.robots.reset()
        self.robots.release_all_except(state.claims)
        if not state.claims:
            return None
        if self.robots.repeats(state):
            # The telemetry of this step is published.
            return self.robots.repeat(state)
        command = self.robots.advance(state)
        self.robots.publish()
        if self._odometry.is_wanted:
            self._odometry.publish(state, self.robots.list_odometry())
        return command


class WorldOutput(BusWorldPublisher):
    """Topics of a world for subscribers of its process; states and contacts for its pool."""

    def __init__(self, bus: MemoryBus, world: str, pool: WorldPool) -> None:
        super().__init__(bus, world)
        self._pool = pool
        self._states: list[DriveState] = []

    def take_states(self) -> list[DriveState]:
        """Take the states that the pool has to answer."""
        taken, self._states = self._states, []
        return taken

    def is_wanted(self, topic: TopicSpec) -> bool:
        """See `WorldPublisher`; sensors are measured without scene states."""
        if topic is CONTACTS and self._pool.robots.wants_contacts:
            return True
        return topic is not SCENE_STATE and super().is_wanted(topic)

    def publish(self, topic: TopicSpec, message: msgspec.Struct) -> None:
        """See `WorldPublisher`."""
        if super().is_wanted(topic):
            super().publish(topic, message)
        if isinstance(message, Contacts) and self._pool.robots.wants_contacts:
            self._pool.robots.publish_contacts(read_contact_report(message))

    def serve_late_subscribers(self) -> None:
        """Do nothing: subscribers of a process get the last messages as they subscribe."""

    def publish_drive_state(
        self, agent: str, state: DriveState, form: Format = Format.MSGPACK
    ) -> None:
        """See `WorldPublisher`."""
        del form
        if agent == POOL:
            self._states.append(state)
