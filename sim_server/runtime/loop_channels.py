"""Input and output of the loop: requests, commands and liveliness in, topics and states out."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol

import msgspec

from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.proto.network_protocols import (
    MAX_FLEET_COMMAND_BYTES,
    Publisher,
    Sample,
    ServerNetwork,
    ServiceCall,
    ServiceCallSource,
    TopicNetwork,
)
from zensim.proto.topic_catalog import (
    DRIVE_COMMAND,
    DRIVE_STATE,
    SENSORS_REPLY,
    TWISTS,
    WORLD_TOPICS,
    TopicSpec,
)
from zensim.proto.topic_endpoints import KeyPublisher, LazyTopicPublisher, TopicFactory

COMMAND_DEPTH = 8192
REPLY_DEPTH = 256
TWISTS_DEPTH = 1024
CALLS_DEPTH = 4096
"""Requests that wait to be taken. Each may keep a buffer of 64 KiB, in which it was received."""


class Inbox(Protocol):
    """Input of the loop, polled at every turn."""

    def take_calls(self) -> list[ServiceCall]:
        """Take the requests received."""

    def take_commands(self) -> list[Sample]:
        """Take the drive commands received."""

    def take_agents(self) -> list[tuple[str, bool]]:
        """Take the agents that appeared (True) or disappeared (False)."""

    def take_sensor_processes(self) -> list[tuple[str, bool]]:
        """Take the sensor processes that became active (True) or inactive (False)."""

    def take_sensor_libraries(self) -> list[tuple[str, str, bool]]:
        """Take what hosts of sensor processes lack (True), or no longer (False), by process."""

    def take_sensor_replies(self) -> list[Sample]:
        """Take the replies of sensor processes."""

    def take_bonds(self) -> list[tuple[str, bool]]:
        """Take the bonds that appeared (True) or disappeared (False)."""

    def take_clients(self) -> list[tuple[str, bool]]:
        """Take the clients that appeared (True) or disappeared (False)."""

    def take_twists(self) -> list[Sample]:
        """Take the orders of twists received."""

    def has_reply_backlog(self, client: str) -> bool:
        """Whether many replies to a client wait to be sent."""

    def settle_replies(self, timeout_s: float) -> None:
        """Wait until replies are sent, except to clients that have stopped reading."""


def declare_services(
    network: ServerNetwork, world: str, *, is_secured: bool
) -> tuple[ServiceCallSource, ...]:
    """Declare all services of a world; of a secured one those of its users, too."""
    wanted = (keys.services(world), *((keys.services_of_users(world),) if is_secured else ()))
    return tuple([network.serve(key, CALLS_DEPTH) for key in wanted])


class BusInbox:
    """Inbox on the keys of one world, and other sources of service calls."""

    def __init__(
        self,
        network: ServerNetwork,
        world: str,
        others: tuple[ServiceCallSource, ...] = (),
        *,
        is_secured: bool = False,
        declared: ServiceCallSource | None = None,
    ) -> None:
        """Declare what the loop receives.

        Args:
            network: Declares it.
            world: Name of the world, in all keys.
            others: Sources of further requests.
            is_secured: Whether users have services of their own.
            declared: Source of the requests of services that are declared; None = declare them.
        """
        if declared is None:
            services = declare_services(network, world, is_secured=is_secured)
        else:
            services = (declared,)
        self._services = (*services, *others)
        self._network = network
        self._agents = network.watch_tokens(keys.alive_agents(world))
        self._bonds = network.watch_tokens(keys.bonds(world))
        self._commands = network.subscribe(
            DRIVE_COMMAND.key(world, "*"), COMMAND_DEPTH, MAX_FLEET_COMMAND_BYTES
        )
        self._sensors = network.watch_tokens(keys.active_sensors(world, "*"))
        self._libraries = network.watch_tokens(keys.sensor_libraries(world, "*", "*"))
        self._sensor_replies = network.subscribe(SENSORS_REPLY.key(world, "*"), REPLY_DEPTH)
        self._clients = network.watch_tokens(keys.alive_clients(world))
        self._twists = network.subscribe(TWISTS.key(world), TWISTS_DEPTH, MAX_FLEET_COMMAND_BYTES)

    def take_calls(self) -> list[ServiceCall]:
        """See `Inbox`."""
        return [call for source in self._services for call in source.take()]

    def take_commands(self) -> list[Sample]:
        """See `Inbox`."""
        return self._commands.take()

    def take_agents(self) -> list[tuple[str, bool]]:
        """See `Inbox`."""
        return [(keys.parse_agent(key), alive) for key, alive in self._agents.take()]

    def take_sensor_processes(self) -> list[tuple[str, bool]]:
        """See `Inbox`."""
        changes = self._sensors.take()
        return [(keys.parse_sensor_process(key), alive) for key, alive in changes]

    def take_sensor_libraries(self) -> list[tuple[str, str, bool]]:
        """See `Inbox`."""
        changes = self._libraries.take()
        return [(*keys.parse_sensor_libraries(key), alive) for key, alive in changes]

    def take_sensor_replies(self) -> list[Sample]:
        """See `Inbox`."""
        return self._sensor_replies.take()

    def take_bonds(self) -> list[tuple[str, bool]]:
        """See `Inbox`."""
        return [(keys.last_chunk(key), alive) for key, alive in self._bonds.take()]

    def take_clients(self) -> list[tuple[str, bool]]:
        """See `Inbox`."""
        return [(keys.last_chunk(key), alive) for key, alive in self._clients.take()]

    def take_twists(self) -> list[Sample]:
        """See `Inbox`."""
        return self._twists.take()

    def has_reply_backlog(self, client: str) -> bool:
        """See `Inbox`."""
        return self._network.has_reply_backlog(client)

    def settle_replies(self, timeout_s: float) -> None:
        """See `Inbox`."""
        self._network.settle_replies(timeout_s)


class WorldPublisher(Protocol):
    """Output of the loop."""

    def is_wanted(self, topic: TopicSpec) -> bool:
        """Whether a topic has a subscriber."""

    def publish(self, topic: TopicSpec, message: msgspec.Struct) -> None:
        """Publish on a topic of the world."""

    def serve_late_subscribers(self) -> None:
        """Publish the last messages of latched topics to subscribers that are new."""

    def publish_drive_state(
        self, agent: str, state: DriveState, form: Format = Format.MSGPACK
    ) -> None:
        """Publish a drive state for one agent, in MessagePack or JSON."""

    def forget_agent(self, agent: str) -> None:
        """Close the publisher of an agent."""

    def hold_messages(self) -> AbstractContextManager[None]:
        """Hold what is published until the block ends, so that it takes few packets."""


class LatchedWorldTopic:
    """A topic of the world whose last message goes to late subscribers, too."""

    def __init__(
        self, topic: TopicSpec, publisher: Publisher, ros2_topics: TopicFactory | None
    ) -> None:
        """Declare it at the root, too.

        Args:
            topic: With a message at the root.
            publisher: On the key of the world.
            ros2_topics: Declares the root topic; None = no ROS 2.
        """
        self._plain = KeyPublisher(publisher)
        self._last: msgspec.Struct | None = None
        self._root: LazyTopicPublisher | None = None
        if ros2_topics is not None:
            self._root = LazyTopicPublisher(ros2_topics, topic.root(), lambda: self._last)

    @property
    def is_matched(self) -> bool:
        """Whether there is a subscriber."""
        return self._plain.is_matched or (self._root is not None and self._root.is_matched)

    def publish(self, message: msgspec.Struct) -> None:
        """Publish a message and keep it for late subscribers."""
        self._last = message
        if self._root is not None:
            self._root.publish()
        if self._root is None or self._plain.is_matched:
            self._plain.send(encode(message, Format.MSGPACK))

    def serve_late_subscribers(self) -> None:
        """Publish the last message to new subscribers; reply to queries."""
        self._plain.publish_to_new(self._write_last)
        if self._root is not None:
            self._root.announce()
            self._root.reply_to_queries()

    def _write_last(self) -> bytes | None:
        return None if self._last is None else encode(self._last, Format.MSGPACK)


class BusWorldPublisher:
    """Publisher on a world's keys in MessagePack, and on the root topics of ROS 2 in CDR."""

    def __init__(
        self,
        network: TopicNetwork,
        world: str,
        ros2_topics: TopicFactory | None = None,
        on_progress: Callable[[StepsProgress], None] | None = None,
    ) -> None:
        """Declare the topics.

        Args:
            network: Declares the publishers.
            world: Name of the world, in all keys.
            ros2_topics: Declares the root topics; None = no ROS 2.
            on_progress: Called with the progress of steps before it is published.
        """
        self._on_progress = on_progress
        self._network = network
        self._world = world
        self._topics = {
            topic: network.advertise(topic.key(world), topic.encoding) for topic in WORLD_TOPICS
        }
        self._root_topics = {
            topic: ros2_topics.publisher(topic.root())
            for topic in WORLD_TOPICS
            if ros2_topics and topic.root_message and not topic.is_latched
        }
        self._latched_topics = {
            topic: LatchedWorldTopic(topic, self._topics[topic], ros2_topics)
            for topic in WORLD_TOPICS
            if topic.is_latched
        }
        self._agents: dict[str, Publisher] = {}

    def is_wanted(self, topic: TopicSpec) -> bool:
        """See `WorldPublisher`."""
        if (latched := self._latched_topics.get(topic)) is not None:
            return latched.is_matched
        root = self._root_topics.get(topic)
        return self._topics[topic].is_matched or (root is not None and root.is_matched)

    def publish(self, topic: TopicSpec, message: msgspec.Struct) -> None:
        """See `WorldPublisher`."""
        if self._on_progress is not None and isinstance(message, StepsProgress):
            self._on_progress(message)
        if (latched := self._latched_topics.get(topic)) is not None:
            latched.publish(message)
            return
        root = self._root_topics.get(topic)
        if root is not None and root.is_matched:
            root.send(encode(message, Format.CDR))
        if root is None or self._topics[topic].is_matched:
            self._topics[topic].send(encode(message, Format.MSGPACK))

    def serve_late_subscribers(self) -> None:
        """See `WorldPublisher`."""
        for latched in self._latched_topics.values():
            latched.serve_late_subscribers()

    def publish_drive_state(
        self, agent: str, state: DriveState, form: Format = Format.MSGPACK
    ) -> None:
        """See `WorldPublisher`."""
        if (publisher := self._agents.get(agent)) is None:
            key = DRIVE_STATE.key(self._world, agent)
            publisher = self._network.advertise(key, make_encoding(DriveState, form))
            self._agents[agent] = publisher
        publisher.send(encode(state, form))

    def hold_messages(self) -> AbstractContextManager[None]:
        """See `WorldPublisher`."""
        return self._network.hold_messages()

    def forget_agent(self, agent: str) -> None:
        """See `WorldPublisher`."""
        if (publisher := self._agents.pop(agent, None)) is not None:
            publisher.close()
