"""Publishers and subscriptions of a topic on its plain Zenoh key and on its ROS 2 key."""

import time
from collections.abc import Callable, Sequence
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
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint
from zensim.proto.ros2.rmw_attachment import Attachment, write_attachment
from zensim.proto.ros2.rmw_keys import ANY_HASH, make_data_key, parse_data_key
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic, gid_from_endpoint
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings

CACHE_DEPTH: Final = 64
CACHE_SUFFIX: Final = "@adv/pub"
"""Where subscribers of transient_local topics ask for what was before them."""
QUERY_DEPTH: Final = 64
PayloadFactory: TypeAlias = Callable[[], bytes | None]
"""Makes the last value; None while there is none."""
MakePayload: TypeAlias = Callable[[], msgspec.Struct | bytes | None]
"""Makes the last value, as a message or as its CDR bytes; None while there is none."""


class KeyPublisher:
    """One form of a topic: a publisher, and what ROS 2 attaches to its messages."""

    def __init__(
        self,
        publisher: Publisher,
        endpoint: GraphEndpoint | None = None,
        stamp: Callable[[], Stamp] | None = None,
    ) -> None:
        """Take where it is put.

        Args:
            publisher: Puts it.
            endpoint: Of ROS 2; None on a plain key.
            stamp: Makes the stamps of a latched topic's values.
        """
        self._publisher = publisher
        self._make_stamp = stamp
        self._last_stamped: tuple[bytes, Stamp] | None = None
        self._gid = gid_from_endpoint(endpoint) if endpoint else b""
        self._was_matched = False
        self._sent = 0

    @property
    def is_matched(self) -> bool:
        """Whether anybody listens."""
        return self._publisher.is_matched

    def send(self, payload: bytes) -> None:
        """Put one message."""
        self._sent += 1
        self._publisher.send(payload, self.attachment(), self._find_stamp(payload))

    def attachment(self) -> bytes:
        """Write what goes with the last message, or will with the first."""
        if not self._gid:
            return b""
        number = max(self._sent, 1)
        return write_attachment(Attachment(number, time.time_ns(), self._gid))

    def add_reply(self, call: Query, key: str, payload: bytes, encoding: str) -> None:
        """Tell the value to somebody who came late; who hears it twice takes it for one."""
        if (stamp := self._find_stamp(payload)) is not None:
            call.add_reply(key, payload, encoding, self.attachment(), stamp)

    def publish_to_new(self, payload: PayloadFactory) -> None:
        """Put the value if somebody has begun to listen since the last time."""
        is_matched = self._publisher.is_matched
        if is_matched and not self._was_matched and (value := payload()) is not None:
            self.send(value)
        self._was_matched = is_matched

    def close(self) -> None:
        """Withdraw the publisher."""
        self._publisher.close()

    def _find_stamp(self, payload: bytes) -> Stamp | None:
        """Find the stamp of a value: the same as long as it is, since a stamp is heard once."""
        if self._make_stamp is None:
            return None
        if self._last_stamped is None or self._last_stamped[0] != payload:
            self._last_stamped = payload, self._make_stamp()
        return self._last_stamped[1]


class LatchedCache:
    """Tells the last value on ROS 2's face to those who come late."""

    def __init__(self, queue: QueryQueue, face: KeyPublisher, key: str, encoding: str) -> None:
        self._queue = queue
        self._publisher = face
        self._key = key
        self._encoding = encoding

    def reply_to_late_joiners(self, payload: PayloadFactory) -> None:
        """Tell everybody who has asked."""
        for call in self._queue.take():
            if (value := payload()) is not None:
                self._publisher.add_reply(call, self._key, value, self._encoding)
            call.drop()

    def close(self) -> None:
        """Stop telling."""
        self._queue.close()


class TopicPublisher:
    """One topic, on all its faces."""

    def __init__(self, faces: Sequence[KeyPublisher], caches: Sequence[LatchedCache]) -> None:
        self._publishers = tuple(faces)
        self._caches = tuple(caches)

    @property
    def is_matched(self) -> bool:
        """Whether anybody listens to any face."""
        return any(face.is_matched for face in self._publishers)

    def send(self, payload: bytes) -> None:
        """Put one message where somebody listens."""
        for face in self._publishers:
            if face.is_matched:
                face.send(payload)

    def publish(self, payload: PayloadFactory) -> None:
        """Make the value, if there is one, and put it where somebody listens."""
        value = None
        for face in self._publishers:
            if face.is_matched:
                if value is None and (value := payload()) is None:
                    return
                face.send(value)

    def publish_to_new(self, payload: PayloadFactory) -> None:
        """Put the value on faces that somebody has begun to listen to."""
        for face in self._publishers:
            face.publish_to_new(payload)

    def reply_to_late_joiners(self, payload: PayloadFactory) -> None:
        """Tell the value to those who come late; only latched topics have any."""
        for cache in self._caches:
            cache.reply_to_late_joiners(payload)

    def close(self) -> None:
        """Withdraw the topic."""
        for face in self._publishers:
            face.close()
        for cache in self._caches:
            cache.close()


class TopicSubscription:
    """Messages of one topic, whichever face they come by."""

    def __init__(self, plain: Subscription, ros: Sequence[Subscription]) -> None:
        self._plain = plain
        self._ros = tuple(ros)

    def take(self) -> list[Sample]:
        """Take all that have come, oldest first on each face."""
        taken = self._plain.take()
        for subscription in self._ros:
            taken += [to_plain_sample(sample) for sample in subscription.take()]
        return taken

    def newest(self) -> Sample | None:
        """Take all and keep the last."""
        taken = self.take()
        return taken[-1] if taken else None

    def close(self) -> None:
        """Stop listening."""
        for subscription in (self._plain, *self._ros):
            subscription.close()


class TopicFactory:
    """Declares topics for one node of ROS 2, or for nobody there."""

    def __init__(
        self, network: TopicNetwork, node: RosNode | None = None, settings: RosSettings = NO_ROS
    ) -> None:
        self.settings = settings
        self._network = network
        self._node = node

    def publisher(self, topic: Topic) -> TopicPublisher:
        """Declare a topic that is told; its messages are CDR."""
        encoding = topic.encoding
        faces = [KeyPublisher(self._network.advertise(topic.key, encoding))]
        if (node := self._node) is None:
            return TopicPublisher(faces, ())
        key, endpoint = node.data_key(topic), node.add_topic_endpoint("MP", topic)
        publisher = self._network.advertise(key, encoding)
        if not topic.is_latched:
            return TopicPublisher([*faces, KeyPublisher(publisher, endpoint)], ())
        faces.append(KeyPublisher(publisher, endpoint, self._network.stamp))
        queue = self._network.serve(
            f"{key}/{CACHE_SUFFIX}/{node.graph.zid}/{endpoint.number}/_", CACHE_DEPTH
        )
        return TopicPublisher(faces, [LatchedCache(queue, faces[1], key, encoding)])

    def subscription(
        self, key: str, kinds: Sequence[type[msgspec.Struct]], depth: int
    ) -> TopicSubscription:
        """Listen to a topic of any of these types; each sample says its type by its encoding."""
        plain = self._network.subscribe(key, depth)
        if (node := self._node) is None:
            return TopicSubscription(plain, ())
        heard = []
        for kind in kinds:
            endpoint = node.add_topic_endpoint("MS", Topic(key, kind))
            # Of any hash: humble's publishers have none.
            ros_key = make_data_key(endpoint.node.domain, key, endpoint.ros_type, ANY_HASH)
            heard.append(self._network.subscribe(ros_key, depth))
        return TopicSubscription(plain, heard)

    def serve(self, key: str, depth: int, *, is_complete: bool = True) -> QueryQueue:
        """Answer requests for a topic's value, on its bare key."""
        return self._network.serve(key, depth, is_complete=is_complete)

    def close(self) -> None:
        """Withdraw the node; its topics are closed by who has them."""
        if self._node is not None:
            self._node.close()


class LazyTopicPublisher:
    """A topic whose value is made only when it is wanted."""

    def __init__(
        self,
        faces: TopicFactory,
        topic: Topic,
        value: MakePayload,
        *,
        is_shared: bool = False,
    ) -> None:
        """Declare the topic.

        Args:
            faces: Where.
            topic: What to put on, and to be asked for.
            value: What is told.
            is_shared: Whether others tell this topic too, so that who asks has to ask all.
        """
        self._key = topic.key
        self._encoding = topic.encoding
        self._value = value
        self._publisher = faces.publisher(topic)
        self._queries = faces.serve(topic.key, QUERY_DEPTH, is_complete=not is_shared)

    def publish(self) -> None:
        """Put the value if anybody listens."""
        self._publisher.publish(self._payload)

    def announce(self) -> None:
        """Put the value now, and later each time that somebody begins to listen."""
        self._publisher.publish_to_new(self._payload)

    def answer(self) -> None:
        """Tell the value to everybody who has asked."""
        for call in self._queries.take():
            payload = self._payload()
            if payload is None:
                call.drop()
            else:
                call.reply(payload, self._encoding, self._key)
        self._publisher.reply_to_late_joiners(self._payload)

    def close(self) -> None:
        """Withdraw the topic."""
        self._publisher.close()
        self._queries.close()

    def _payload(self) -> bytes | None:
        value = self._value()
        return encode(value, Format.CDR) if isinstance(value, msgspec.Struct) else value


def make_topic_factory(
    network: TopicNetwork, graph: RosGraph | None, namespace: str, name: str
) -> TopicFactory:
    """Make faces for a node that is new in the graph, if there is one."""
    if graph is None:
        return TopicFactory(network)
    return TopicFactory(network, graph.add_node(namespace, name), graph.settings)


def to_plain_sample(sample: Sample) -> Sample:
    """Say a sample of ROS 2's face as one of the bare key; its type goes into its encoding."""
    parsed = parse_data_key(sample.key)
    if parsed is None:
        return sample
    encoding = f"application/cdr;{parsed.ros_type}"
    return Sample(parsed.name.strip("/"), sample.payload, encoding, sample.attachment)
