"""Messages of topics from the network, subscribed while a client subscribes to them."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias, TypeVar

import msgspec

from zensim.foxglove.live_topics import LiveTopic, TopicContent
from zensim.foxglove.merged_transforms import (
    STAMP_BYTES,
    Transform,
    collect_transforms,
    join_transforms,
    prefix_frames,
)
from zensim.foxglove.scene_entities import update_scene, whole_scene
from zensim.foxglove.scene_messages import SceneEntity
from zensim.proto.bus.bus_session import Bus
from zensim.proto.cmd_vel_decoding import MIN_STAMPED_BYTES
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.message_times import choose_time, make_stamp_reader
from zensim.proto.messages.standard_messages import Clock, Twist, TwistStamped, time_from_ns
from zensim.spawner.client.topic_reader import WantedTopics, read_topic

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import BusSubscription

Item = TypeVar("Item")
TimedPayload: TypeAlias = tuple[int, bytes]
"""Time [ns] and bytes of a message."""
DEPTH: Final = 256
"""Messages of a topic between two takes; the newest are kept."""
SHARED_DEPTH: Final = 16_384
"""The same of a topic that all robots share."""
LATCHED_TIMEOUT_S: Final = 0.5
MAX_FRAMES: Final = 65_536
"""Distinct fixed transforms that are kept for later subscribers."""


class TopicSource(Protocol):
    """Messages of one topic."""

    def take(self, now_ns: int) -> list[TimedPayload]:
        """Take what is new; time is the simulation's [ns]."""

    def take_latched(self, now_ns: int) -> list[TimedPayload]:  # noqa: ARG002
        """Return what a new subscriber gets at once."""
        return []

    def close(self) -> None:
        """End the subscriptions."""


class MessageSource(TopicSource):
    """Messages as they come, converted to CDR where a program published another format."""

    def __init__(self, bus: Bus, topic: LiveTopic, depth: int = DEPTH) -> None:
        self._kind = topic.kind
        self._read_stamp = make_stamp_reader(topic.kind)
        self._subscriptions = [bus.subscribe(key, depth) for key in topic.keys]

    def take(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        read_stamp = self._read_stamp
        return [(choose_time(read_stamp(one), now_ns), one) for one in self.take_payloads()]

    def take_payloads(self) -> list[bytes]:
        """Take new messages in CDR."""
        return [
            cdr
            for subscription in self._subscriptions
            for payload in subscription.take_payloads()
            if (cdr := to_cdr(self._kind, payload)) is not None
        ]

    def close(self) -> None:
        """See `TopicSource`."""
        for subscription in self._subscriptions:
            subscription.close()


def to_cdr(kind: type[msgspec.Struct], payload: bytes) -> bytes | None:
    """Convert a message to CDR; None if it is not of this type."""
    if payload[:1] == b"\0":
        if kind in (Twist, TwistStamped):
            is_stamped = len(payload) >= MIN_STAMPED_BYTES
            return payload if is_stamped == (kind is TwistStamped) else None
        return payload
    try:
        return encode(decode(kind, payload), Format.CDR)
    except (MalformedPayload, ValueError):
        return None


class LatchedSource(MessageSource):
    """The last message of a topic, also for later subscribers."""

    def __init__(self, bus: Bus, topic: LiveTopic) -> None:
        super().__init__(bus, topic)
        self._bus, self._keys = bus, topic.keys
        self._last: bytes | None = None
        self._fetched: deque[bytes] = deque()
        """Messages that another thread has queried."""

    def fetch(self) -> None:
        """Query the message that was published before; blocks for `LATCHED_TIMEOUT_S` at most."""
        for key in self._keys:
            samples = self._bus.get(key, LATCHED_TIMEOUT_S)
            self._fetched += [one.payload for one in samples if "*" not in one.key]

    def take(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`; a message that is known already is left out."""
        fetched = [to_cdr(self._kind, one) for one in take_all(self._fetched)]
        found = [one for one in self.take_payloads() if one != self._last]
        if self._last is None and not found:
            found = [one for one in fetched if one is not None][:1]
        if found:
            self._last = found[-1]
        return [(now_ns, one) for one in found]

    def take_latched(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        return [] if self._last is None else [(now_ns, self._last)]


def take_all(queue: deque[Item]) -> Iterator[Item]:
    """Take what is in a queue that another thread fills."""
    for _ in range(len(queue)):
        yield queue.popleft()


class WorldFacts(Protocol):
    """What is known of a world besides its topics; values are replaced when they change."""

    @property
    def scene(self) -> Mapping[str, SceneEntity]:
        """What is drawn, by id."""

    @property
    def own_tf(self) -> frozenset[str]:
        """Namespaces of robots that publish transforms on their own topic only."""

    @property
    def odometry_frames(self) -> tuple[Transform, ...]:
        """Where the odometry frames of these robots are in the world."""


class RobotTransforms:
    """Transforms on the topic that robots share, and on those of robots that do not."""

    def __init__(self, bus: Bus, suffix: str, facts: WorldFacts) -> None:
        self._suffix, self._facts = suffix, facts
        self._shared = bus.subscribe(suffix, SHARED_DEPTH)
        self._own: WantedTopics[str, BusSubscription] = WantedTopics(
            lambda key: bus.subscribe(key, DEPTH)
        )
        self._followed: frozenset[str] = frozenset()
        self._prefixed: dict[tuple[str, bytes], bytes] = {}

    def take(self) -> list[Transform]:
        """Take new transforms, with frames of the whole world."""
        self._follow()
        found = collect_transforms(self._shared.take_payloads())
        for namespace, subscription in self._own:
            if payloads := subscription.take_payloads():
                found += self.read(namespace, payloads)
        return found

    def read(self, namespace: str, payloads: list[bytes]) -> list[Transform]:
        """Read messages of a robot's own topic."""
        known, found = self._prefixed, []
        for names, numbers in collect_transforms(payloads):
            key = namespace, names[STAMP_BYTES:]
            if key not in known:
                if len(known) >= MAX_FRAMES:
                    known.clear()
                known[key] = prefix_frames(key[1], f"{namespace}/".encode())
            found.append((names[:STAMP_BYTES] + known[key], numbers))
        return found

    def close(self) -> None:
        """End the subscriptions."""
        self._shared.close()
        self._own.close()

    def _follow(self) -> None:
        """Subscribe to exactly the robots that do not share the topic."""
        wanted = self._facts.own_tf
        if wanted is self._followed:
            return
        self._followed = wanted
        self._own.follow({one: f"{one}/{self._suffix}" for one in wanted})


class TransformSource(TopicSource):
    """The transforms of all robots in one message."""

    def __init__(self, bus: Bus, topic: LiveTopic, facts: WorldFacts) -> None:
        self._transforms = RobotTransforms(bus, topic.keys[0], facts)

    def take(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        found = self._transforms.take()
        return [(now_ns, join_transforms(found))] if found else []

    def close(self) -> None:
        """See `TopicSource`."""
        self._transforms.close()


class StaticTransformSource:
    """The fixed transforms of all robots, also for later subscribers."""

    def __init__(self, bus: Bus, topic: LiveTopic, facts: WorldFacts) -> None:
        self._bus, self._suffix, self._facts = bus, topic.keys[0], facts
        self._transforms = RobotTransforms(bus, topic.keys[0], facts)
        self._known: dict[bytes, bytes] = {}
        self._fetched: deque[tuple[str, bytes]] = deque()
        """Keys and messages that another thread has queried."""

    def fetch(self) -> None:
        """Query the transforms of each agent; blocks for `LATCHED_TIMEOUT_S` at most."""
        samples = self._bus.get_all(f"**/{self._suffix}", LATCHED_TIMEOUT_S)
        self._fetched += [(one.key, one.payload) for one in samples]

    def take(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`; transforms that are known already are left out."""
        new = [*self._facts.odometry_frames, *self._read_fetched(), *self._transforms.take()]
        changed = []
        for names, numbers in new:
            # The stamp of a fixed transform says nothing.
            frames = names[STAMP_BYTES:]
            if self._known.get(frames) != numbers and len(self._known) < MAX_FRAMES:
                self._known[frames] = numbers
                changed.append((frames, numbers))
        return [(now_ns, _join_static(changed))] if changed else []

    def take_latched(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        return [(now_ns, _join_static([*self._known.items()]))] if self._known else []

    def close(self) -> None:
        """See `TopicSource`."""
        self._transforms.close()

    def _read_fetched(self) -> list[Transform]:
        fetched = [*take_all(self._fetched)]
        found = collect_transforms(one for key, one in fetched if key == self._suffix)
        for key, payload in fetched:
            namespace = key.removesuffix(f"/{self._suffix}")
            if namespace in self._facts.own_tf:
                found += self._transforms.read(namespace, [payload])
        return found


def _join_static(transforms: list[Transform]) -> bytes:
    return join_transforms([(b"\0" * STAMP_BYTES + frames, one) for frames, one in transforms])


class JsonSource(TopicSource):
    """Messages of the world as JSON."""

    def __init__(self, bus: Bus, topic: LiveTopic) -> None:
        self._readers = [read_topic(bus, key, topic.kind, DEPTH) for key in topic.keys]

    def take(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        messages = (message for one in self._readers for message in one.take())
        return [(now_ns, encode(message, Format.JSON)) for message in messages]

    def close(self) -> None:
        """See `TopicSource`."""
        for reader in self._readers:
            reader.close()


class ClockSource:
    """The simulation time, when it has changed."""

    def __init__(self) -> None:
        self._sent_ns = -1

    def take(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        if now_ns == self._sent_ns:
            return []
        self._sent_ns = now_ns
        return self.take_latched(now_ns)

    def take_latched(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        return [(now_ns, encode(Clock(time_from_ns(now_ns)), Format.CDR))]

    def close(self) -> None:
        """See `TopicSource`."""


class SceneSource:
    """What is drawn of all entities, when it has changed."""

    def __init__(self, facts: WorldFacts) -> None:
        self._facts = facts
        self._sent: Mapping[str, SceneEntity] = {}

    def take(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        scene = self._facts.scene
        if scene is self._sent:
            return []
        update = update_scene(self._sent, scene)
        self._sent = scene
        has_news = update.deletions or update.entities
        return [(now_ns, encode(update, Format.CDR))] if has_news else []

    def take_latched(self, now_ns: int) -> list[TimedPayload]:
        """See `TopicSource`."""
        return [(now_ns, encode(whole_scene(self._sent), Format.CDR))]

    def close(self) -> None:
        """See `TopicSource`."""


def make_source(bus: Bus, topic: LiveTopic, facts: WorldFacts) -> TopicSource:
    """Subscribe to a topic."""
    makers: dict[TopicContent, Callable[[], TopicSource]] = {
        "messages": lambda: MessageSource(bus, topic),
        "latched": lambda: LatchedSource(bus, topic),
        "tf": lambda: TransformSource(bus, topic, facts),
        "tf_static": lambda: StaticTransformSource(bus, topic, facts),
        "json": lambda: JsonSource(bus, topic),
        "clock": ClockSource,
        "scene": lambda: SceneSource(facts),
    }
    return makers[topic.content]()
