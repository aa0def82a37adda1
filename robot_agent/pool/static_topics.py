"""Static topics of a pool's robots: equal messages are encoded once, fixed transforms joined."""

from collections.abc import Callable

import msgspec
import numpy as np

from zensim.proto import keys
from zensim.proto.codec.cdr import encode
from zensim.proto.fleet_topics.topic_members import TopicMember
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.topic_catalog import ROBOT_TOPICS, TF_STATIC
from zensim.proto.topic_endpoints import LazyTopicPublisher, TopicFactory
from zensim.robot_agent.pool.group_telemetry import (
    CDR_HEADER,
    COUNT_STRUCT,
    EMPTY_TRANSFORM,
    FIRST_OFFSET,
    LATER_OFFSET,
    MAX_TF_MESSAGE_BYTES,
    FindPublisher,
)
from zensim.robot_agent.robot_telemetry import (
    differs_in_namespace_only,
    list_own_static_messages,
    make_fixed_transforms,
    make_shared_transforms,
)

NAMESPACE_MARKS = ("\x01", "\x02")
"""Characters that no name has."""


class StaticValue:
    """A message that never changes; see `LastValues`."""

    def __init__(self, message: msgspec.Struct) -> None:
        self._payload = encode(message)

    def payload(self, row: int) -> bytes:  # noqa: ARG002 - of the protocol
        """Return the message."""
        return self._payload


class _MarkedBytes:
    """Bytes of a message that differ in one text of a fixed size, and where that is."""

    def __init__(self, one: bytes, other: bytes, size: int) -> None:
        """Compare a message with the same one with another text."""
        differs = np.frombuffer(one, np.uint8) != np.frombuffer(other, np.uint8)
        self.starts: list[int] = np.flatnonzero(differs)[::size].tolist() if size else []
        self._bytes, self._size = one, size

    def __len__(self) -> int:
        return len(self._bytes)

    def write(self, text: bytes) -> bytes:
        """Write the message with a text."""
        written = bytearray(self._bytes)
        for start in self.starts:
            written[start : start + self._size] = text
        return bytes(written)


class TransformTemplate:
    """Encoded transforms of robots whose namespaces have one size and are all that differs.

    They are bytes of a message: as the first transforms of it, and as later ones.
    """

    def __init__(self, make: Callable[[str], TFMessage], size: int) -> None:
        """Encode the transforms.

        Args:
            make: Makes them for a namespace.
            size: Of the namespaces [bytes].
        """
        one, other = (make(mark * size) for mark in NAMESPACE_MARKS)
        self.count = len(one.transforms)
        self.first = _MarkedBytes(_encode_first(one), _encode_first(other), size)
        self.later = _MarkedBytes(_encode_later(one), _encode_later(other), size)


def _encode_first(message: TFMessage) -> bytes:
    return encode(message)[FIRST_OFFSET:]


def _encode_later(message: TFMessage) -> bytes:
    return encode(TFMessage((EMPTY_TRANSFORM, *message.transforms)))[LATER_OFFSET:]


class StaticTransformBatch:
    """Fixed transforms of some robots, in one message on the shared topic."""

    def __init__(self, factory: TopicFactory) -> None:
        """Declare the topic."""
        self.size = 0
        """Approximate size of the message [bytes]."""
        self._robots: dict[int, tuple[TransformTemplate, bytes]] = {}
        """Transforms and namespace by claim."""
        self._payload: bytes | None = None
        self._has_news = False
        self._publisher = LazyTopicPublisher(
            factory, TF_STATIC.root(), self.payload, is_shared=True
        )

    def __contains__(self, claim: int) -> bool:
        return claim in self._robots

    @property
    def is_empty(self) -> bool:
        """Whether there are no robots."""
        return not self._robots

    def add(self, claim: Claim, transforms: TransformTemplate) -> None:
        """Add a robot; `announce` publishes the message again."""
        self._robots[claim.claim] = transforms, claim.namespace.encode()
        self.size += len(transforms.later)
        self._payload, self._has_news = None, True

    def remove(self, claim: int) -> None:
        """Remove a robot; subscribers keep its transforms, as tf does."""
        transforms, _ = self._robots.pop(claim)
        self.size -= len(transforms.later)
        self._payload = None

    def payload(self) -> bytes | None:
        """Write the message; None without robots."""
        if self._payload is None and self._robots:
            (first, namespace), *robots = self._robots.values()
            count = first.count + sum(one.count for one, _ in robots)
            parts = [one.later.write(name) for one, name in robots]
            head = (CDR_HEADER, COUNT_STRUCT.pack(count), first.first.write(namespace))
            self._payload = b"".join((*head, *parts))
        return self._payload

    def announce(self) -> None:
        """Publish the message if it has new robots, or to new subscribers."""
        if self._has_news:
            self._has_news = False
            self._publisher.publish()
        self._publisher.announce()

    def reply_to_queries(self) -> None:
        """Reply to queries and late subscribers."""
        self._publisher.reply_to_queries()

    def close(self) -> None:
        """Undeclare the topic."""
        self._publisher.close()


class SharedStaticTopic:
    """Fixed transforms of a pool's robots on the shared topic, in few messages.

    A subscriber of tf keeps a hundred messages, and a late one gets those of all pools at once.
    """

    def __init__(self, make_factory: Callable[[], TopicFactory]) -> None:
        """Create it without robots.

        Args:
            make_factory: Makes a factory for the node that publishes the topic.
        """
        self._make_factory = make_factory
        self._factory: TopicFactory | None = None
        self._batches: list[StaticTransformBatch] = []

    def add(self, claim: Claim, transforms: TransformTemplate) -> None:
        """Add a robot's transforms; `announce` publishes them."""
        most = MAX_TF_MESSAGE_BYTES - len(transforms.later)
        batch = next((one for one in self._batches if one.size <= most), None)
        if batch is None:
            if self._factory is None:
                self._factory = self._make_factory()
            batch = StaticTransformBatch(self._factory)
            self._batches.append(batch)
        batch.add(claim, transforms)

    def remove(self, claim: int) -> None:
        """Remove a robot, if it has such transforms."""
        batch = next((one for one in self._batches if claim in one), None)
        if batch is None:
            return
        batch.remove(claim)
        if batch.is_empty:
            self._batches.remove(batch)
            batch.close()
        if not self._batches and self._factory is not None:
            self._factory.close()
            self._factory = None

    def announce(self) -> None:
        """Publish what is new, and everything to new subscribers."""
        for batch in self._batches:
            batch.announce()

    def reply_to_queries(self) -> None:
        """Reply to queries and late subscribers."""
        for batch in self._batches:
            batch.reply_to_queries()


class StaticTopics:
    """Static topics of robots; equal messages are encoded once."""

    def __init__(
        self, find_publisher: FindPublisher, shared: SharedStaticTopic, ros: RosSettings = NO_ROS
    ) -> None:
        self._find_publisher = find_publisher
        self._shared = shared
        self._ros = ros
        self._fixed: dict[int, tuple[Model, TFMessage]] = {}
        self._templates: dict[tuple[int, int], TransformTemplate] = {}
        """Templates of models whose robots differ in the namespace alone, by model and its size."""
        self._values: dict[msgspec.Struct, StaticValue] = {}

    def add(self, claim: Claim, node: RosNode | None = None) -> tuple[TopicMember, ...]:
        """Declare a robot's static topics; its node is in the ROS 2 graph."""
        self.add_shared(claim)
        members, fixed = [], self._get_fixed_transforms(claim.model)
        for topic, key, message in list_own_static_messages(claim, fixed, self._ros):
            members.append(TopicMember(key, self._get_value(message), node=node))
            self._find_publisher(keys.make_pattern(key), topic).add(members[-1])
        return tuple(members)

    def add_shared(self, claim: Claim) -> None:
        """Publish a robot's fixed transforms on the shared topic only."""
        if self._ros.has_global_tf and (template := self._get_template(claim)).count:
            self._shared.add(claim, template)

    def remove(self, claim: int, members: tuple[TopicMember, ...]) -> None:
        """Undeclare a robot's static topics."""
        self._shared.remove(claim)
        for member in members:
            topic = ROBOT_TOPICS[keys.last_chunk(member.key)]
            self._find_publisher(keys.make_pattern(member.key), topic).remove(member)

    def __getstate__(self) -> dict[str, object]:
        """Leave out what is cached by the identity of models."""
        return {**self.__dict__, "_fixed": {}, "_templates": {}}

    def forget(self) -> None:
        """Drop the encoded messages, when no robot is left."""
        self._fixed.clear()
        self._templates.clear()
        self._values.clear()

    def _get_template(self, claim: Claim) -> TransformTemplate:
        fixed = self._get_fixed_transforms(claim.model)
        key = id(claim.model), len(claim.namespace.encode())
        if (found := self._templates.get(key)) is not None:
            return found
        if not differs_in_namespace_only(claim, fixed):
            message = make_shared_transforms(claim, fixed, self._ros)
            return TransformTemplate(lambda _: message, 0)

        def make(namespace: str) -> TFMessage:
            renamed = msgspec.structs.replace(claim, namespace=namespace)
            return make_shared_transforms(renamed, fixed, self._ros)

        found = self._templates[key] = TransformTemplate(make, key[1])
        return found

    def _get_fixed_transforms(self, model: Model) -> TFMessage:
        # The model is kept, so that no other gets its id.
        if id(model) not in self._fixed:
            self._fixed[id(model)] = (model, make_fixed_transforms(model))
        return self._fixed[id(model)][1]

    def _get_value(self, message: msgspec.Struct) -> StaticValue:
        if message not in self._values:
            self._values[message] = StaticValue(message)
        return self._values[message]
