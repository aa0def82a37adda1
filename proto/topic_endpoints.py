"""Publishers and subscriptions of a topic on its plain Zenoh key and on its ROS 2 key."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, TypeAlias

import msgspec

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.network_protocols import (
    Publisher,
    Query,
    QueryQueue,
    Sample,
    Stamp,
    Subscription,
    TopicNetwork,
)
from zensim.proto.ros2.action_messages import ActionKind, GoalStatusArray
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint
from zensim.proto.ros2.qos_profiles import LATCHED, RELIABLE_10
from zensim.proto.ros2.rmw_attachment import Attachment, write_attachment
from zensim.proto.ros2.rmw_keys import ANY_HASH, make_data_key, parse_data_key
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, RosTopic, gid_from_endpoint
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.topic_faults import TopicFaults

CACHE_DEPTH: Final = 64
CACHE_SUFFIX: Final = "@adv/pub"
"""Late subscribers of transient_local topics query this suffix."""
STAMPED_CHUNK: Final = "uhlc"
"""Stands for a publisher whose messages are ordered by their timestamps."""
QUERY_DEPTH: Final = 64
REPEAT_AFTER_S: Final = 0.5
"""Pause before a latched message is repeated; the heartbeats of rmw_zenoh have this period."""
PayloadFactory: TypeAlias = Callable[[], bytes | None]
"""Makes the last value; None while there is none."""
MakePayload: TypeAlias = Callable[[], msgspec.Struct | bytes | None]
"""Makes the last value, as a message or as its CDR bytes; None while there is none."""


def make_cache_key(key: str, zid: str) -> str:
    """Write the key of the last messages of a transient_local topic, as zenoh-ext writes it.

    It is that of a queryable and of a liveliness token: subscribers query it when it appears, so
    also after their link was cut.

    Args:
        key: ROS 2 data key.
        zid: Session of the publisher, in hexadecimal digits, as in the timestamps of its messages.
    """
    return f"{key}/{CACHE_SUFFIX}/{zid}/{STAMPED_CHUNK}/_"


class KeyPublisher:
    """Publisher of a topic on one key, with the attachments of ROS 2 if it has an endpoint."""

    def __init__(
        self,
        publisher: Publisher,
        endpoint: GraphEndpoint | None = None,
        stamp: Callable[[], Stamp] | None = None,
    ) -> None:
        """Wrap a publisher.

        Args:
            publisher: Publisher on the key.
            endpoint: In the ROS 2 graph; None on a plain key.
            stamp: Makes the timestamps of a latched topic; None for other topics.
        """
        self._publisher = publisher
        self._make_stamp = stamp
        self._last_stamped: tuple[bytes, Stamp] | None = None
        self._gid = gid_from_endpoint(endpoint) if endpoint else b""
        self._was_matched = False
        self._sent = 0
        self._unrepeated: tuple[bytes, bytes, Stamp] | None = None
        """Payload, attachment and timestamp of a message of a latched topic."""
        self._repeat_s = 0.0

    @property
    def is_matched(self) -> bool:
        """Whether there is a subscriber."""
        return self._publisher.is_matched

    def send(self, payload: bytes) -> None:
        """Publish a message."""
        self._sent += 1
        self._was_matched = True
        attachment, stamp = self.attachment(), self._find_stamp(payload)
        self._publisher.send(payload, attachment, stamp)
        if stamp is not None:
            self._unrepeated = payload, attachment, stamp
            self._repeat_s = time.monotonic() + REPEAT_AFTER_S

    def repeat(self) -> bool:
        """Publish the last message of a latched topic once more; whether that is done.

        The network drops what a link cannot take at a time; those who have it drop it by its stamp.
        """
        if self._unrepeated is None:
            return True
        if time.monotonic() < self._repeat_s:
            return False
        if self._publisher.is_matched:
            self._publisher.send(*self._unrepeated)
        self._unrepeated = None
        return True

    def attachment(self) -> bytes:
        """Write the attachment of the last message; of the first, if there was none."""
        if not self._gid:
            return b""
        number = max(self._sent, 1)
        return write_attachment(Attachment(number, time.time_ns(), self._gid))

    def add_reply(self, call: Query, key: str, payload: bytes, encoding: str) -> None:
        """Reply with the value; a subscriber drops a second sample with the same timestamp."""
        if (stamp := self._find_stamp(payload)) is not None:
            call.add_reply(key, payload, encoding, self.attachment(), stamp)

    def publish_to_new(self, payload: PayloadFactory) -> None:
        """Publish the value if a subscriber has appeared since the last call; else `repeat`."""
        is_matched = self._publisher.is_matched
        if is_matched and not self._was_matched and (value := payload()) is not None:
            self.send(value)
        self._was_matched = is_matched
        self.repeat()

    def close(self) -> None:
        """Undeclare the publisher."""
        self._publisher.close()

    def _find_stamp(self, payload: bytes) -> Stamp | None:
        """Find the timestamp of a value, which is the same until the value changes."""
        if self._make_stamp is None:
            return None
        if self._last_stamped is None or self._last_stamped[0] != payload:
            self._last_stamped = payload, self._make_stamp()
        return self._last_stamped[1]


class LatchedCache:
    """Replies with the last value on a ROS 2 key to late subscribers."""

    def __init__(self, queue: QueryQueue, publisher: KeyPublisher, key: str, encoding: str) -> None:
        self._queue = queue
        self._publisher = publisher
        self._key = key
        self._encoding = encoding

    def reply_to_late_joiners(self, payload: PayloadFactory) -> None:
        """Reply to all queued queries."""
        for call in self._queue.take():
            if (value := payload()) is not None:
                self._publisher.add_reply(call, self._key, value, self._encoding)
            call.drop()

    def close(self) -> None:
        """Undeclare the queryable."""
        self._queue.close()


class TopicPublisher:
    """Publisher of a topic on its plain key and on its ROS 2 key."""

    def __init__(self, publishers: Sequence[KeyPublisher], caches: Sequence[LatchedCache]) -> None:
        self._publishers = tuple(publishers)
        self._caches = tuple(caches)

    @property
    def is_matched(self) -> bool:
        """Whether any key has a subscriber."""
        return any(publisher.is_matched for publisher in self._publishers)

    def send(self, payload: bytes) -> None:
        """Publish a message on the keys that have a subscriber."""
        for publisher in self._publishers:
            if publisher.is_matched:
                publisher.send(payload)

    def publish(self, payload: PayloadFactory) -> None:
        """Make the value and publish it on the keys that have a subscriber."""
        value = None
        for publisher in self._publishers:
            if publisher.is_matched:
                if value is None and (value := payload()) is None:
                    return
                publisher.send(value)

    def publish_to_new(self, payload: PayloadFactory) -> None:
        """Publish the value on keys that have a new subscriber."""
        for publisher in self._publishers:
            publisher.publish_to_new(payload)

    def reply_to_late_joiners(self, payload: PayloadFactory) -> None:
        """Reply with the value to late subscribers, if the topic is latched."""
        for cache in self._caches:
            cache.reply_to_late_joiners(payload)

    def close(self) -> None:
        """Undeclare the topic."""
        for publisher in self._publishers:
            publisher.close()
        for cache in self._caches:
            cache.close()


class TopicSubscription(Subscription):
    """Subscription of a topic on its plain key and on its ROS 2 keys."""

    def __init__(self, plain: Subscription, ros: Sequence[Subscription]) -> None:
        self._plain = plain
        self._ros = tuple(ros)

    def take(self) -> list[Sample]:
        """Take all queued messages, oldest first on each key."""
        taken = self._plain.take()
        for subscription in self._ros:
            taken += [to_plain_sample(sample) for sample in subscription.take()]
        return taken

    def close(self) -> None:
        """Undeclare the subscriptions."""
        for subscription in (self._plain, *self._ros):
            subscription.close()


class TopicFactory:
    """Declares topics of one node; on plain keys only, if there is no ROS 2 node."""

    def __init__(
        self, network: TopicNetwork, node: RosNode | None = None, settings: RosSettings = NO_ROS
    ) -> None:
        self.settings = settings
        self.faults = TopicFaults()
        """Faults of the topics of this process."""
        self._network = network
        self._node = node

    @property
    def node(self) -> RosNode | None:
        """The node; None if there are no ROS 2 endpoints."""
        return self._node

    def publisher(self, topic: RosTopic) -> TopicPublisher:
        """Declare a publisher of CDR messages."""
        encoding = topic.encoding
        publishers = [KeyPublisher(self._network.advertise(topic.key, encoding))]
        if (node := self._node) is None or not self.settings.has_topic(topic.name):
            return TopicPublisher(publishers, ())
        key, endpoint = node.data_key(topic), node.add_topic_endpoint("MP", topic)
        publisher = self._network.advertise(key, encoding)
        if not topic.is_latched:
            return TopicPublisher([*publishers, KeyPublisher(publisher, endpoint)], ())
        publishers.append(KeyPublisher(publisher, endpoint, self._network.stamp))
        cache_key = make_cache_key(key, node.graph.zid)
        queue = self._network.serve(cache_key, CACHE_DEPTH)
        node.announce_cache(cache_key)
        return TopicPublisher(publishers, [LatchedCache(queue, publishers[1], key, encoding)])

    def subscription(
        self,
        key: str,
        kinds: Sequence[type[msgspec.Struct]],
        depth: int,
        max_bytes: int,
        *,
        name: str = "",
    ) -> TopicSubscription:
        """Subscribe to a topic of any of these types; samples name theirs in the encoding.

        See `RosTopic` for `name`.
        """
        plain = self._network.subscribe(key, depth, max_bytes)
        if (node := self._node) is None or not self.settings.has_topic(name):
            return TopicSubscription(plain, ())
        ros = []
        for kind in kinds:
            endpoint = node.add_topic_endpoint("MS", RosTopic(key, kind))
            # Any hash: publishers of humble have none.
            ros_key = make_data_key(endpoint.node.domain, key, endpoint.ros_type, ANY_HASH)
            ros.append(self._network.subscribe(ros_key, depth, max_bytes))
        return TopicSubscription(plain, ros)

    def serve(self, key: str, depth: int = QUERY_DEPTH, *, is_complete: bool = True) -> QueryQueue:
        """Declare a queryable on a plain key."""
        return self._network.serve(key, depth, is_complete=is_complete)

    def close(self) -> None:
        """Remove the node from the ROS 2 graph; the owner of a topic closes it."""
        if self._node is not None:
            self._node.close()


class LazyTopicPublisher:
    """Publisher that encodes only for subscribers, and replies to get with the last value."""

    def __init__(
        self, topics: TopicFactory, topic: RosTopic, value: MakePayload, *, is_shared: bool = False
    ) -> None:
        """Declare the topic.

        Args:
            topics: Declares publisher and queryable.
            topic: Key, type and QoS.
            value: Makes the value.
            is_shared: Whether other programs publish on this key, too; a get queries all.
        """
        self._key = topic.key
        self._encoding = topic.encoding
        self._value = value
        self._faults, self._message_type = topics.faults, topic.kind
        self._publisher = topics.publisher(topic)
        self._queries = topics.serve(topic.key, QUERY_DEPTH, is_complete=not is_shared)

    @property
    def is_matched(self) -> bool:
        """Whether there is a subscriber."""
        return self._publisher.is_matched

    def publish(self) -> None:
        """Publish the value if there is a subscriber."""
        if not self._faults.affects(self._key):
            self._publisher.publish(self._payload)
        elif self.is_matched and (payload := self._payload()) is not None:
            for one in self._faults.change(self._key, self._message_type, payload):
                self._publisher.publish(partial(bytes, one))

    def send(self, payload: bytes) -> None:
        """Publish the CDR bytes of a message, such as of a part of the value."""
        self._publisher.send(payload)

    def announce(self) -> None:
        """Publish the value to subscribers that are new since the last call."""
        self._publisher.publish_to_new(self._payload)

    def reply_to_queries(self) -> None:
        """Reply to all queued queries."""
        for call in self._queries.take():
            payload = self._payload()
            if payload is None:
                call.drop()
            else:
                call.reply(payload, self._encoding, self._key)
        self._publisher.reply_to_late_joiners(self._payload)

    def close(self) -> None:
        """Undeclare the topic."""
        self._publisher.close()
        self._queries.close()

    def _payload(self) -> bytes | None:
        value = self._value()
        return encode(value, Format.CDR) if isinstance(value, msgspec.Struct) else value


def advertise_action(
    topics: TopicFactory, name: str, kind: ActionKind
) -> dict[str, TopicPublisher]:
    """Declare the topics of an action, feedback and the latched status, by name.

    Args:
        topics: Of the node.
        name: Of the action, without a leading slash.
        kind: Its messages.
    """
    return {
        topic: topics.publisher(
            RosTopic(
                topic.strip("/"), message, LATCHED if message is GoalStatusArray else RELIABLE_10
            )
        )
        for topic, message in kind.list_topics(name).items()
    }


def make_topic_factory(
    network: TopicNetwork, graph: RosGraph | None, namespace: str, name: str
) -> TopicFactory:
    """Make a factory for a new node of the graph; on plain keys only, if the graph is None."""
    if graph is None:
        return TopicFactory(network)
    return TopicFactory(network, graph.add_node(namespace, name), graph.settings)


def to_plain_sample(sample: Sample) -> Sample:
    """Convert a sample of a ROS 2 key to its plain key, with its type in the encoding."""
    parsed = parse_data_key(sample.key)
    if parsed is None:
        return sample
    encoding = f"application/cdr;{parsed.ros_type}"
    return Sample(parsed.name.strip("/"), sample.payload, encoding, sample.attachment)
