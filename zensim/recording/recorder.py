"""Takes the messages of a world from the network, gives them times, and hands them over."""

import time
from collections.abc import Iterable
from contextlib import suppress
from typing import Final, Literal, Protocol

import msgspec

from zensim.proto.bus import Bus, BusSubscription
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.standard_messages import ns_from_time
from zensim.proto.messages.telemetry_messages import Event, WorldClock
from zensim.proto.network_protocols import Sample
from zensim.proto.ros2.liveliness_tokens import TOKEN_SPACE, parse_endpoint_token
from zensim.proto.topic_catalog import CLOCK, EVENTS
from zensim.proto.topic_endpoints import to_plain_sample
from zensim.recording.message_times import choose_time
from zensim.recording.recorded_topics import RecordedMessage, TopicTable, make_clock_topic
from zensim.recording.topic_selection import (
    ANY_ROS_TYPE,
    CLOCK_TOPIC,
    TopicFilter,
    list_keys,
    list_ros_keys,
)

RING_DEPTH: Final = 32_768
"""Messages of one key expression between two takes; a longer queue takes more memory."""
EVENTS_DEPTH: Final = 1024
CLOCK_TIMEOUT_S: Final = 2.0
LATCHED_TIMEOUT_S: Final = 0.5
LATCHED_SUFFIXES: Final = ("tf_static", "robot_description", "map")

ARRIVALS: Final = ("spawned", "loaded")

TimeBase = Literal["simulation", "wall"]


class MessageSink(Protocol):
    """Where messages go."""

    def put(self, batch: list[RecordedMessage]) -> None:
        """Take messages over, in the order of their arrival."""

    def start_part(self, log_ns: int, publish_ns: int) -> None:
        """Begin a new file, as time was reset."""

    def note_event(self, event: Event) -> None:
        """Learn what happened in the world."""


class RecorderSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What is recorded, and by which clock."""

    world: str
    domain: int | None
    """Of ROS 2; None = only plain keys."""
    time_base: TimeBase = "simulation"
    """Of log times."""


class Recorder:
    """Subscriptions of a recording."""

    def __init__(
        self, bus: Bus, chosen: TopicFilter, settings: RecorderSettings, sink: MessageSink
    ) -> None:
        """Subscribe.

        Raises:
            TimeoutError: No server of the world is running.
        """
        self._bus, self._chosen, self._settings, self._sink = bus, chosen, settings, sink
        self._table = TopicTable(settings.world, chosen.accepts)
        self._clock_topic = make_clock_topic() if chosen.accepts(CLOCK_TOPIC) else None
        self._clock = bus.subscribe(CLOCK.key(settings.world), EVENTS_DEPTH)
        self._events = bus.subscribe(EVENTS.key(settings.world), EVENTS_DEPTH)
        self._keys = list_keys(chosen, settings.world, settings.domain)
        self._subscriptions = [self._subscribe(key) for key in self._keys]
        watches = chosen.is_broad and settings.domain is not None
        tokens = f"{TOKEN_SPACE}/{settings.domain}/**"
        self._tokens = bus.watch_tokens(tokens) if watches else None
        self._now_ns, self._epoch = self._read_first_clock()
        self.received = 0
        """Messages that were handed over."""
        self._has_arrivals = True
        self.malformed = 0
        """Messages that are left out, since they do not encode their type."""
        self.overflows = 0
        """How often messages arrived faster than they were taken, so that some were lost."""
        self._record_latched()

    @property
    def unknown_topics(self) -> tuple[str, ...]:
        """Topics that are left out, since their type is not known."""
        return tuple(sorted(self._table.unknown))

    def take(self) -> None:
        """Hand over all messages that arrived since the last call."""
        received_ns = time.time_ns()
        self._take_events()
        batch = self._take_clock(received_ns)
        for subscription, is_of_ros in self._subscriptions:
            samples = subscription.take()
            self.overflows += len(samples) >= RING_DEPTH
            plain = map(to_plain_sample, samples) if is_of_ros else samples
            self._convert(plain, received_ns, batch)
        self._hand_over(batch)
        self._subscribe_to_announced()

    def take_arrivals(self) -> bool:
        """Whether entities were spawned or a world was loaded since the last call; yes at first."""
        found, self._has_arrivals = self._has_arrivals, False
        return found

    def close(self) -> None:
        """End the subscriptions."""
        for one in (self._clock, self._events, *(one for one, _ in self._subscriptions)):
            one.close()
        if self._tokens is not None:
            self._tokens.close()

    def _hand_over(self, batch: list[RecordedMessage]) -> None:
        self.received += len(batch)
        self._sink.put(batch)

    def _convert(
        self, samples: Iterable[Sample], received_ns: int, batch: list[RecordedMessage]
    ) -> None:
        """Append the messages of the selected topics."""
        is_wall = self._settings.time_base == "wall"
        for sample in samples:
            topic = self._table.find(sample)
            if topic is None:
                continue
            try:
                payload = topic.to_cdr(sample)
            except MalformedPayload:
                self.malformed += 1
                continue
            if is_wall:
                log_ns = received_ns
            else:
                # A latched message may be from long ago.
                stamp = None if topic.is_latched else topic.read_stamp(payload)
                log_ns = choose_time(stamp, self._now_ns)
            batch.append((topic, log_ns, received_ns, payload))

    def _take_clock(self, received_ns: int) -> list[RecordedMessage]:
        """Read the clock; return its messages, if they are recorded."""
        batch: list[RecordedMessage] = []
        for sample in self._clock.take():
            try:
                clock = decode(WorldClock, sample.payload, sample.encoding)
            except MalformedPayload:
                continue
            self._now_ns = max(0, ns_from_time(clock.clock))
            log_ns = received_ns if self._settings.time_base == "wall" else self._now_ns
            if clock.epoch != self._epoch:
                self._epoch = clock.epoch
                self._hand_over(batch)
                batch = []
                self._sink.start_part(log_ns, received_ns)
            if self._clock_topic is not None:
                topic = self._clock_topic
                batch.append((topic, log_ns, received_ns, topic.to_cdr(sample)))
        return batch

    def _take_events(self) -> None:
        for sample in self._events.take():
            with suppress(MalformedPayload):
                event = decode(Event, sample.payload, sample.encoding)
                self._has_arrivals |= event.kind in ARRIVALS
                self._sink.note_event(event)

    def _read_first_clock(self) -> tuple[int, int]:
        deadline = time.monotonic() + CLOCK_TIMEOUT_S
        key = CLOCK.key(self._settings.world)
        while time.monotonic() < deadline:
            for sample in self._bus.get(key, LATCHED_TIMEOUT_S):
                with suppress(MalformedPayload):
                    clock = decode(WorldClock, sample.payload, sample.encoding)
                    return max(0, ns_from_time(clock.clock)), clock.epoch
        raise TimeoutError(
            f"no clock on {key} within {CLOCK_TIMEOUT_S:g} s; start a server, or check --world-name"
        )

    def _record_latched(self) -> None:
        """Ask for the latched messages, which were published before the subscriptions."""
        batch: list[RecordedMessage] = []
        for key in self._keys:
            if key.rsplit("/", 1)[-1] in LATCHED_SUFFIXES:
                # A service that the key expression covers replies, too.
                found = [one for one in self._bus.get(key, LATCHED_TIMEOUT_S) if is_of_robot(one)]
                self._convert(found, time.time_ns(), batch)
        self._hand_over(batch)

    def _subscribe_to_announced(self) -> None:
        """Subscribe to topics that ROS 2 nodes announce, and that no key expression covers."""
        if self._tokens is None or self._settings.domain is None:
            return
        endpoints = [parse_endpoint_token(key) for key, is_alive in self._tokens.take() if is_alive]
        announced = [one for one in endpoints if one is not None]
        for key in list_ros_keys(self._chosen, announced, self._keys, self._settings.domain):
            self._keys.append(key)
            self._subscriptions.append(self._subscribe(key))

    def _subscribe(self, key: str) -> tuple[BusSubscription, bool]:
        """Subscribe; say whether it is a key of ROS 2."""
        return self._bus.subscribe(key, RING_DEPTH), key.endswith(f"/{ANY_ROS_TYPE}")


def is_of_robot(sample: Sample) -> bool:
    """Whether a reply is from a topic of a robot, or of the root."""
    return not sample.key.startswith("sim/") and "*" not in sample.key
