"""Topics of sensors: publishers on plain and ROS 2 keys, and who has subscribers."""

from collections.abc import Iterable, Sequence

import msgspec

from zensim.proto import keys
from zensim.proto.fleet_topics.fleet_publisher import FleetTopicPublisher
from zensim.proto.fleet_topics.ros_fleet_publisher import RosFleetPublisher
from zensim.proto.fleet_topics.topic_members import TopicMember
from zensim.proto.network_protocols import MAX_COMMAND_BYTES, AgentNetwork
from zensim.proto.ros2.node_services import NodeServices
from zensim.proto.ros2.ros_graph import RosGraph, RosNode
from zensim.proto.subscriber_search import SubscriberWatches
from zensim.proto.topic_catalog import IMAGE_TRIGGER, TopicSpec
from zensim.proto.topic_endpoints import TopicFactory, TopicSubscription
from zensim.proto.topic_faults import TopicFaults

NODE_NAME = "sensors"
"""Name of the ROS 2 node of each robot."""


class SensorAddress(msgspec.Struct, frozen=True):
    """A topic of one sensor."""

    topic: TopicSpec
    key: str
    namespace: str
    """Namespace of the ROS 2 node."""


SUBSCRIPTION_DEPTH = 16


def is_subscribed(address: SensorAddress) -> bool:
    """Whether sensors subscribe to a topic, which others publish."""
    return address.topic is IMAGE_TRIGGER


class LastPayloads:
    """The last message of each sensor on one topic, by row."""

    def __init__(self) -> None:
        self._payloads: dict[int, bytes] = {}
        self._next_row = 0

    def add_row(self) -> int:
        """Add a sensor without a message."""
        self._next_row += 1
        return self._next_row

    def store(self, member: TopicMember, payload: bytes) -> None:
        """Store the last message of a sensor."""
        self._payloads[member.row] = payload

    def payload(self, row: int) -> bytes | None:
        """See `LastValues`."""
        return self._payloads.get(row)

    def forget(self, member: TopicMember) -> None:
        """Forget a sensor."""
        self._payloads.pop(member.row, None)


class SensorTopics:
    """All topics of the sensors of a world; messages are published on those of a share."""

    def __init__(
        self, network: AgentNetwork, graph: RosGraph, watches: SubscriberWatches | None = None
    ) -> None:
        """Create them without sensors.

        Args:
            network: Session of the publishers.
            graph: ROS 2 graph of the sensors' nodes.
            watches: As of `FleetTopicPublisher`.
        """
        self._network = network
        self._graph = graph
        self._watches = watches
        self._publishers: dict[tuple[str, TopicSpec], FleetTopicPublisher] = {}
        self._members: dict[SensorAddress, tuple[TopicMember, FleetTopicPublisher]] = {}
        self._nodes: dict[str, RosNode] = {}
        self._node_services = NodeServices(network, graph.domain, f"**/{NODE_NAME}")
        self._payloads = LastPayloads()
        self.faults = TopicFaults()
        self._subscriptions: dict[SensorAddress, TopicSubscription] = {}

    @property
    def is_wanted(self) -> bool:
        """Whether any topic has subscribers, also one of another process's share."""
        return any(publisher.is_wanted for publisher in self._publishers.values())

    def set_addresses(self, every: Iterable[SensorAddress], share: Iterable[SensorAddress]) -> None:
        """Set the topics of all sensors, and those of the share of this process."""
        patterns = {
            (keys.make_pattern(one.key), one.topic) for one in every if not is_subscribed(one)
        }
        for pattern, topic in patterns - self._publishers.keys():
            self._publishers[pattern, topic] = self._make_publisher(pattern, topic)
        wanted = dict.fromkeys(share)
        self._set_subscriptions([one for one in wanted if is_subscribed(one)])
        wanted = dict.fromkeys(one for one in wanted if not is_subscribed(one))
        for address in [one for one in self._members if one not in wanted]:
            self._remove(address)
        for address in [one for one in wanted if one not in self._members]:
            self._add(address)
        for used in [one for one in self._publishers if one not in patterns]:
            self._publishers.pop(used).close()
        self._close_unused_nodes()

    def has_subscribers(self, address: SensorAddress) -> bool:
        """Whether a topic of the share has subscribers."""
        if (found := self._members.get(address)) is None:
            return False
        member, publisher = found
        return publisher.has_subscribers(member)

    def put(self, addresses: Sequence[SensorAddress], payloads: Sequence[bytes]) -> None:
        """Publish messages of one topic of the share to those with subscribers."""
        by_publisher: dict[FleetTopicPublisher, tuple[list[TopicMember], list[bytes]]] = {}
        for address, payload in zip(addresses, payloads, strict=True):
            member, publisher = self._members[address]
            self._payloads.store(member, payload)
            members, listed = by_publisher.setdefault(publisher, ([], []))
            members.append(member)
            listed.append(payload)
        for publisher, (members, listed) in by_publisher.items():
            publisher.put(members, listed)

    def take_count(self, address: SensorAddress) -> int:
        """Count the messages on a subscribed topic of the share since the last call."""
        return len(self._subscriptions[address].take()) if address in self._subscriptions else 0

    def check_all(self) -> None:
        """Declare all missing publishers, and check which have subscribers."""
        for publisher in self._publishers.values():
            publisher.check_all()

    def poll(self) -> None:
        """Declare missing publishers, and reply to queries with the last messages."""
        for publisher in self._publishers.values():
            publisher.declare_some()
            while publisher.is_declaring:
                publisher.declare_some()
            publisher.reply_to_queries()
        self._node_services.poll()

    def close(self) -> None:
        """Undeclare everything."""
        self.set_addresses((), ())
        self._node_services.close()

    def _make_publisher(self, pattern: str, topic: TopicSpec) -> FleetTopicPublisher:
        endpoint = topic.at(pattern)
        settings = self._graph.settings
        has_ros = settings.domain is not None and settings.has_topic(endpoint.name)
        network, watches = self._network, self._watches
        ros = RosFleetPublisher(network, self._graph, endpoint, watches) if has_ros else None
        return FleetTopicPublisher(network, pattern, endpoint.kind, ros, self.faults, watches)

    def _set_subscriptions(self, wanted: Sequence[SensorAddress]) -> None:
        for address in [one for one in self._subscriptions if one not in wanted]:
            self._subscriptions.pop(address).close()
        for address in [one for one in wanted if one not in self._subscriptions]:
            factory = TopicFactory(self._network, self._find_node(address), self._graph.settings)
            self._subscriptions[address] = factory.subscription(
                address.key,
                address.topic.messages,
                SUBSCRIPTION_DEPTH,
                MAX_COMMAND_BYTES,
                name=address.topic.name,
            )

    def _find_node(self, address: SensorAddress) -> RosNode | None:
        if address.namespace not in self._nodes:
            node = self._graph.add_robot(address.namespace, NODE_NAME)
            if node is not None:
                self._nodes[address.namespace] = node
                self._node_services.add(node)
        return self._nodes.get(address.namespace)

    def _add(self, address: SensorAddress) -> None:
        member = TopicMember(
            address.key, self._payloads, self._payloads.add_row(), self._find_node(address)
        )
        publisher = self._publishers[keys.make_pattern(address.key), address.topic]
        self._members[address] = member, publisher
        publisher.add(member)

    def _remove(self, address: SensorAddress) -> None:
        member, publisher = self._members.pop(address)
        self._payloads.forget(member)
        publisher.remove(member)

    def _close_unused_nodes(self) -> None:
        used = {address.namespace for address in (*self._members, *self._subscriptions)}
        for namespace in [one for one in self._nodes if one not in used]:
            self._nodes.pop(namespace).close()
