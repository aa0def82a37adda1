"""Publishers of a world's topics and of drive states; messages are encoded only for subscribers."""

from collections.abc import Callable
from typing import Protocol

import msgspec

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.proto.network_protocols import Publisher, PublishingNetwork
from zensim.proto.topic_catalog import DRIVE_STATE, WORLD_TOPICS, TopicSpec
from zensim.proto.topic_endpoints import TopicFactory


class WorldPublisher(Protocol):
    """What the loop tells."""

    def is_wanted(self, topic: TopicSpec) -> bool:
        """Whether anybody listens to a topic."""

    def publish(self, topic: TopicSpec, message: msgspec.Struct) -> None:
        """Publish on a topic of the world."""

    def publish_drive_state(self, agent: str, state: DriveState) -> None:
        """Publish a drive state."""

    def forget_agent(self, agent: str) -> None:
        """Free what was kept for an agent."""


class BusWorldPublisher:
    """The outlet on a bus: MessagePack on the world's keys, CDR where ROS 2 looks for it."""

    def __init__(
        self,
        bus: PublishingNetwork,
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
        self._on_progress = on_progress
        self._bus = bus
        self._world = world
        self._topics = {
            topic: bus.advertise(topic.key(world), topic.encoding) for topic in WORLD_TOPICS
        }
        self._ros2_publishers = {
            topic: faces.publisher(topic.root())
            for topic in WORLD_TOPICS
            if faces and topic.root_message
        }
        self._agents: dict[str, Publisher] = {}

    def is_wanted(self, topic: TopicSpec) -> bool:
        """See `WorldPublisher`."""
        faced = self._ros2_publishers.get(topic)
        return self._topics[topic].is_matched or (faced is not None and faced.is_matched)

    def publish(self, topic: TopicSpec, message: msgspec.Struct) -> None:
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
            key = DRIVE_STATE.key(self._world, agent)
            publisher = self._bus.advertise(key, DRIVE_STATE.encoding)
            self._agents[agent] = publisher
        publisher.send(encode(state, Format.MSGPACK))

    def forget_agent(self, agent: str) -> None:
        """See `WorldPublisher`."""
        if (publisher := self._agents.pop(agent, None)) is not None:
            publisher.close()
