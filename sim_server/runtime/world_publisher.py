"""Publishers of a world's topics and of drive states; messages are encoded only for subscribers."""

from collections.abc import Callable
from typing import Protocol

import msgspec

from zensim.proto import keys
from zensim.proto.bus import Bus, BusPublisher
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.gazebo_messages import LinkStates, ModelStates
from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.proto.messages.standard_messages import Clock
from zensim.proto.messages.telemetry_messages import Event, Snapshot, Stats, WorldClock
from zensim.proto.ros2.ros_graph import Topic
from zensim.proto.topic_endpoints import TopicFactory

ROS2_TOPICS: dict[str, type[msgspec.Struct]] = {
    "clock": Clock,
    "model_states": ModelStates,
    "link_states": LinkStates,
}
"""Topics of the world that ROS 2 has too, at its root."""


class WorldPublisher(Protocol):
    """What the loop tells."""

    def is_wanted(self, topic: str) -> bool:
        """Whether anybody listens to a topic."""

    def publish(self, topic: str, message: msgspec.Struct) -> None:
        """Publish on a topic of the world."""

    def publish_drive_state(self, agent: str, state: DriveState) -> None:
        """Publish a drive state."""

    def forget_agent(self, agent: str) -> None:
        """Free what was kept for an agent."""


class BusWorldPublisher:
    """The outlet on a bus: MessagePack on the world's keys, CDR where ROS 2 looks for it."""

    def __init__(
        self,
        bus: Bus,
        world: str,
        faces: TopicFactory | None = None,
        on_progress: Callable[[StepsProgress], None] | None = None,
    ) -> None:
        """Declare the topics.

        Args:
            bus: Where.
            world: Whose.
            faces: By which ROS 2 sees some of them.
            on_progress: Called with the progress of steps before it is published.
        """
        topics: dict[str, tuple[str, type[msgspec.Struct]]] = {
            "clock": (keys.clock(world), WorldClock),
            "stats": (keys.stats(world), Stats),
            "snapshot": (keys.snapshot(world), Snapshot),
            "events": (keys.events(world), Event),
            "model_states": (keys.model_states(world), ModelStates),
            "link_states": (keys.link_states(world), LinkStates),
            "simulate_steps_feedback": (keys.steps_progress(world), StepsProgress),
        }
        self._on_progress = on_progress
        self._bus = bus
        self._world = world
        self._topics = {
            topic: bus.advertise(key, make_encoding(kind, Format.MSGPACK))
            for topic, (key, kind) in topics.items()
        }
        self._ros2_publishers = {
            topic: faces.publisher(Topic(topic, kind))
            for topic, kind in ROS2_TOPICS.items()
            if faces
        }
        self._agents: dict[str, BusPublisher] = {}

    def is_wanted(self, topic: str) -> bool:
        """See `WorldPublisher`."""
        faced = self._ros2_publishers.get(topic)
        return self._topics[topic].is_matched or (faced is not None and faced.is_matched)

    def publish(self, topic: str, message: msgspec.Struct) -> None:
        """See `WorldPublisher`."""
        if self._on_progress is not None and isinstance(message, StepsProgress):
            self._on_progress(message)
        faced = self._ros2_publishers.get(topic)
        if faced is not None and faced.is_matched:
            faced.send(encode(message, Format.CDR))
        if faced is None or self._topics[topic].is_matched:
            self._topics[topic].send(encode(message, Format.MSGPACK))

    def publish_drive_state(self, agent: str, state: DriveState) -> None:
        """See `WorldPublisher`."""
        if (publisher := self._agents.get(agent)) is None:
            key = keys.drive_state(self._world, agent)
            publisher = self._bus.advertise(key, make_encoding(DriveState, Format.MSGPACK))
            self._agents[agent] = publisher
        publisher.send(encode(state, Format.MSGPACK))

    def forget_agent(self, agent: str) -> None:
        """See `WorldPublisher`."""
        if (publisher := self._agents.pop(agent, None)) is not None:
            publisher.close()
