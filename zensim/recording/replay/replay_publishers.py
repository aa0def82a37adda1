"""Publishers of a replay: plain keys and those of ROS 2, latched topics, clock."""

import re
from collections.abc import Callable
from functools import partial
from typing import Final

from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.standard_messages import (
    Clock,
    String,
    TFMessage,
    TransformStamped,
    time_from_ns,
)
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.network_protocols import TopicNetwork
from zensim.proto.ros2.qos_profiles import LATCHED
from zensim.proto.ros2.rmw_keys import make_data_key
from zensim.proto.ros2.ros_graph import RosTopic
from zensim.proto.schema import find_cdr_type
from zensim.proto.topic_catalog import CLOCK
from zensim.proto.topic_endpoints import (
    KeyPublisher,
    LazyTopicPublisher,
    TopicFactory,
    TopicPublisher,
)
from zensim.recording.latched_messages import SHARED_TOPIC
from zensim.recording.recorded_topics import HASH_METADATA
from zensim.recording.recording_reader import StoredTopic
from zensim.recording.replay.replayed_names import ReplayedNames, is_world_topic

Send = Callable[[bytes], None]
CDR_ENCODING: Final = Format.CDR.value


class ReplayPublishers:
    """Publishes the messages of a replay; each topic as it was recorded."""

    def __init__(
        self, network: TopicNetwork, topics: TopicFactory, names: ReplayedNames, step_ns: int = 0
    ) -> None:
        """Declare all publishers.

        Args:
            network: Session.
            topics: Declares topics of the replay's node.
            names: Keys of the topics.
            step_ns: Of the recorded world, for the step of its clock; 0 = unknown.
        """
        self._network, self._topics = network, topics
        self._latched: list[LatchedReplay] = []
        self._publishers: list[TopicPublisher] = []
        self._sends: dict[StoredTopic, Send] = {
            topic: self._declare(topic, key) for topic, key in names.keys.items()
        }
        self._clock = ReplayedClock(network, topics, names, step_ns)

    def prepare(self) -> None:
        """Find once whether each topic has subscribers: the first time takes longest."""
        for publisher in self._publishers:
            publisher.is_matched  # noqa: B018

    def publish(self, topic: StoredTopic, payload: bytes) -> None:
        """Publish a message."""
        self._sends[topic](payload)

    def publish_clock(self, time_ns: int, epoch: int) -> None:
        """Publish the time on `/clock` and on the key of the world."""
        self._clock.publish(time_ns, epoch)

    def serve(self) -> None:
        """Reply to late subscribers; to be called some times a second."""
        for one in self._latched:
            one.serve()
        self._clock.serve()

    def _declare(self, topic: StoredTopic, key: str) -> Send:
        if is_world_topic(key):
            return partial(_send_text, self._network.advertise(key, Format.JSON.value).send)
        kind = find_cdr_type(topic.ros_type)
        if kind is None or not topic.is_latched:
            publisher = (
                self._declare_unknown(topic, key)
                if kind is None
                else self._topics.publisher(RosTopic(key, kind, topic.qos))
            )
            self._publishers.append(publisher)
            return publisher.send
        is_shared = topic.name == SHARED_TOPIC
        latched = LatchedReplay(self._topics, RosTopic(key, kind, LATCHED), is_shared=is_shared)
        self._latched.append(latched)
        return latched.send

    def _declare_unknown(self, topic: StoredTopic, key: str) -> TopicPublisher:
        """Declare a topic whose type is none of zensim's."""
        encoding = f"{Format.CDR.value};{topic.ros_type}"
        publishers = [KeyPublisher(self._network.advertise(key, encoding))]
        node, type_hash = self._topics.node, topic.channel_metadata.get(HASH_METADATA, "")
        # Both come from a file, and become parts of a key.
        is_typed = TYPE_HASH.fullmatch(type_hash) and ROS_TYPE.fullmatch(topic.ros_type)
        if node is not None and is_typed:
            endpoint = node.add_endpoint(
                "MP", key, topic.ros_type, type_hash=type_hash, qos=topic.qos
            )
            ros_key = make_data_key(node.domain, key, topic.ros_type, type_hash)
            publishers.append(KeyPublisher(self._network.advertise(ros_key, encoding), endpoint))
        return TopicPublisher(publishers, ())


ROS_TYPE: Final = re.compile(r"[A-Za-z]\w*/[a-z]\w*/[A-Za-z]\w*", re.ASCII)
TYPE_HASH: Final = re.compile(r"RIHS01_[0-9a-f]{64}")


class LatchedReplay:
    """A latched topic: late subscribers get the last message; of `/tf_static` all transforms."""

    def __init__(self, topics: TopicFactory, topic: RosTopic, *, is_shared: bool) -> None:
        self._is_shared = is_shared
        self._last: bytes | None = None
        self._transforms: dict[str, TransformStamped] = {}
        self._publisher = LazyTopicPublisher(topics, topic, self._find_value, is_shared=is_shared)

    def send(self, payload: bytes) -> None:
        """Publish a message."""
        self._last = payload
        if self._is_shared:
            message = decode(TFMessage, payload, CDR_ENCODING)
            self._transforms.update((one.child_frame_id, one) for one in message.transforms)
            self._last = None
        self._publisher.send(payload)

    def serve(self) -> None:
        """Reply to late subscribers."""
        self._publisher.announce()
        self._publisher.reply_to_queries()

    def _find_value(self) -> bytes | None:
        if self._last is None and self._transforms:
            self._last = encode(TFMessage(tuple(self._transforms.values())), Format.CDR)
        return self._last


class ReplayedClock:
    """`/clock` and the clock of the world, which has an epoch."""

    def __init__(
        self, network: TopicNetwork, topics: TopicFactory, names: ReplayedNames, step_ns: int
    ) -> None:
        self._step_ns = step_ns
        self._world_key = CLOCK.key(names.world)
        self._world = network.advertise(self._world_key, CLOCK.encoding)
        self._queries = network.serve(self._world_key)
        self._root = topics.publisher(RosTopic(names.clock_key, Clock, CLOCK.qos))
        self._now: WorldClock | None = None

    def publish(self, time_ns: int, epoch: int) -> None:
        """Publish the time."""
        step = time_ns // self._step_ns if self._step_ns else 0
        now = self._now = WorldClock(time_from_ns(time_ns), step, epoch)
        if self._world.is_matched:
            self._world.send(encode(now, CLOCK.format))
        self._root.publish(lambda: encode(Clock(now.clock), Format.CDR))

    def serve(self) -> None:
        """Reply with the time."""
        for call in self._queries.take():
            if self._now is None:
                call.drop()
            else:
                call.reply(encode(self._now, CLOCK.format), CLOCK.encoding, self._world_key)


def _send_text(send: Send, payload: bytes) -> None:
    """Publish the JSON that a recording has as a text."""
    send(decode(String, payload, CDR_ENCODING).data.encode())
