"""Topics with every face they have: plain Zenoh's bare key, and ROS 2's key when there is a node.

Nothing is encoded for a face that nobody looks at, and nothing is put on it.
"""

import time
from collections.abc import Callable, Sequence
from typing import Final, Protocol, TypeAlias

import msgspec

from zensim.proto.channels import Sample, Stamp
from zensim.proto.codec import Format, encoding_of
from zensim.proto.ros2.attachment import Attachment, write_attachment
from zensim.proto.ros2.keys import ANY_HASH, data_key, parse_data_key
from zensim.proto.ros2.settings import NO_ROS, RosSettings
from zensim.proto.ros2.tokens import Endpoint
from zensim.proto.ros_graph import RosGraph, RosNode, Topic, gid_of_endpoint

CACHE_DEPTH: Final = 64
CACHE: Final = "@adv/pub"
"""Where subscribers of transient_local topics ask for what was before them."""
Payload: TypeAlias = Callable[[], bytes | None]
"""Makes the value of now; None while there is none."""


class Publisher(Protocol):
    """One key to put on."""

    @property
    def is_matched(self) -> bool:
        """Whether anybody listens."""

    def send(self, payload: bytes, attachment: bytes = b"", stamp: Stamp | None = None) -> None:
        """Put one message."""

    def close(self) -> None:
        """Withdraw the publisher."""


class Subscription(Protocol):
    """Messages on a key expression."""

    def take(self) -> list[Sample]:
        """Take all that have come, oldest first."""

    def close(self) -> None:
        """Stop listening."""


class Call(Protocol):
    """A request that waits for its answer."""

    def reply(self, payload: bytes, encoding: str, key: str = "") -> None:
        """Answer."""

    def add_reply(
        self, key: str, payload: bytes, encoding: str, attachment: bytes, stamp: Stamp
    ) -> None:
        """Answer with one sample of several."""

    def drop(self) -> None:
        """Let the caller go."""


class CallQueue(Protocol):
    """Requests on a key expression."""

    def take(self) -> Sequence[Call]:
        """Take all that have come, oldest first."""

    def close(self) -> None:
        """Stop serving."""


class Network(Protocol):
    """Where faces are."""

    def stamp(self) -> Stamp:
        """Make a stamp of now."""

    def advertise(self, key: str, encoding: str) -> Publisher:
        """Declare a publisher."""

    def subscribe(self, key: str, depth: int = 1) -> Subscription:
        """Listen to a key expression."""

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> CallQueue:
        """Answer requests on a key expression, alone unless it is said that others do too."""


class Face:
    """One form of a topic: a publisher, and what ROS 2 attaches to its messages."""

    def __init__(
        self,
        publisher: Publisher,
        endpoint: Endpoint | None = None,
        stamp: Callable[[], Stamp] | None = None,
    ) -> None:
        """Take where it is put.

        Args:
            publisher: Puts it.
            endpoint: Of ROS 2; None on a plain key.
            stamp: Makes the stamps of a latched topic's values.
        """
        self._publisher = publisher
        self._stamp = stamp
        self._told: tuple[bytes, Stamp] | None = None
        self._gid = gid_of_endpoint(endpoint) if endpoint else b""
        self._was_matched = False
        self._sent = 0

    @property
    def is_matched(self) -> bool:
        """Whether anybody listens."""
        return self._publisher.is_matched

    def send(self, payload: bytes) -> None:
        """Put one message."""
        self._sent += 1
        self._publisher.send(payload, self.attachment(), self._stamp_of(payload))

    def attachment(self) -> bytes:
        """Write what goes with the last message, or will with the first."""
        if not self._gid:
            return b""
        number = max(self._sent, 1)
        return write_attachment(Attachment(number, time.time_ns(), self._gid))

    def add_reply(self, call: Call, key: str, payload: bytes, encoding: str) -> None:
        """Tell the value to somebody who came late; who hears it twice takes it for one."""
        if (stamp := self._stamp_of(payload)) is not None:
            call.add_reply(key, payload, encoding, self.attachment(), stamp)

    def greet(self, payload: Payload) -> None:
        """Put the value if somebody has begun to listen since the last time."""
        is_matched = self._publisher.is_matched
        if is_matched and not self._was_matched and (value := payload()) is not None:
            self.send(value)
        self._was_matched = is_matched

    def close(self) -> None:
        """Withdraw the publisher."""
        self._publisher.close()

    def _stamp_of(self, payload: bytes) -> Stamp | None:
        """Find the stamp of a value: the same as long as it is, since a stamp is heard once."""
        if self._stamp is None:
            return None
        if self._told is None or self._told[0] != payload:
            self._told = payload, self._stamp()
        return self._told[1]


class Cache:
    """Tells the last value on ROS 2's face to those who come late."""

    def __init__(self, queue: CallQueue, face: Face, key: str, encoding: str) -> None:
        self._queue = queue
        self._face = face
        self._key = key
        self._encoding = encoding

    def answer(self, payload: Payload) -> None:
        """Tell everybody who has asked."""
        for call in self._queue.take():
            if (value := payload()) is not None:
                self._face.add_reply(call, self._key, value, self._encoding)
            call.drop()

    def close(self) -> None:
        """Stop telling."""
        self._queue.close()


class TopicPublisher:
    """One topic, on all its faces."""

    def __init__(self, faces: Sequence[Face], caches: Sequence[Cache]) -> None:
        self._faces = tuple(faces)
        self._caches = tuple(caches)

    @property
    def is_matched(self) -> bool:
        """Whether anybody listens to any face."""
        return any(face.is_matched for face in self._faces)

    def send(self, payload: bytes) -> None:
        """Put one message where somebody listens."""
        for face in self._faces:
            if face.is_matched:
                face.send(payload)

    def publish(self, payload: Payload) -> None:
        """Make the value, if there is one, and put it where somebody listens."""
        value = None
        for face in self._faces:
            if face.is_matched:
                if value is None and (value := payload()) is None:
                    return
                face.send(value)

    def greet(self, payload: Payload) -> None:
        """Put the value on faces that somebody has begun to listen to."""
        for face in self._faces:
            face.greet(payload)

    def answer(self, payload: Payload) -> None:
        """Tell the value to those who come late; only latched topics have any."""
        for cache in self._caches:
            cache.answer(payload)

    def close(self) -> None:
        """Withdraw the topic."""
        for face in self._faces:
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
            taken += [as_plain(sample) for sample in subscription.take()]
        return taken

    def newest(self) -> Sample | None:
        """Take all and keep the last."""
        taken = self.take()
        return taken[-1] if taken else None

    def close(self) -> None:
        """Stop listening."""
        for subscription in (self._plain, *self._ros):
            subscription.close()


class Faces:
    """Declares topics for one node of ROS 2, or for nobody there."""

    def __init__(
        self, network: Network, node: RosNode | None = None, settings: RosSettings = NO_ROS
    ) -> None:
        self.settings = settings
        self._network = network
        self._node = node

    def publisher(self, topic: Topic) -> TopicPublisher:
        """Declare a topic that is told; its messages are CDR."""
        encoding = encoding_of(topic.kind, Format.CDR)
        faces = [Face(self._network.advertise(topic.key, encoding))]
        if (node := self._node) is None:
            return TopicPublisher(faces, ())
        key, endpoint = node.data_key(topic), node.join_topic("MP", topic)
        publisher = self._network.advertise(key, encoding)
        if not topic.is_latched:
            return TopicPublisher([*faces, Face(publisher, endpoint)], ())
        faces.append(Face(publisher, endpoint, self._network.stamp))
        queue = self._network.serve(
            f"{key}/{CACHE}/{node.graph.zid}/{endpoint.number}/_", CACHE_DEPTH
        )
        return TopicPublisher(faces, [Cache(queue, faces[1], key, encoding)])

    def subscription(
        self, key: str, kinds: Sequence[type[msgspec.Struct]], depth: int
    ) -> TopicSubscription:
        """Listen to a topic of any of these types; each sample says its type by its encoding."""
        plain = self._network.subscribe(key, depth)
        if (node := self._node) is None:
            return TopicSubscription(plain, ())
        heard = []
        for kind in kinds:
            endpoint = node.join_topic("MS", Topic(key, kind))
            # Of any hash: humble's publishers have none.
            ros_key = data_key(endpoint.node.domain, key, endpoint.ros_type, ANY_HASH)
            heard.append(self._network.subscribe(ros_key, depth))
        return TopicSubscription(plain, heard)

    def serve(self, key: str, depth: int, *, is_complete: bool = True) -> CallQueue:
        """Answer requests for a topic's value, on its bare key."""
        return self._network.serve(key, depth, is_complete=is_complete)

    def close(self) -> None:
        """Withdraw the node; its topics are closed by who has them."""
        if self._node is not None:
            self._node.close()


def faces_of(network: Network, graph: RosGraph | None, namespace: str, name: str) -> Faces:
    """Make faces for a node that is new in the graph, if there is one."""
    if graph is None:
        return Faces(network)
    return Faces(network, graph.node(namespace, name), graph.settings)


def as_plain(sample: Sample) -> Sample:
    """Say a sample of ROS 2's face as one of the bare key; its type goes into its encoding."""
    parsed = parse_data_key(sample.key)
    if parsed is None:
        return sample
    encoding = f"application/cdr;{parsed.ros_type}"
    return Sample(parsed.name.strip("/"), sample.payload, encoding, sample.attachment)
