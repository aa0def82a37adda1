"""Takes the messages of a world from the network, gives them times, and hands them over."""

import time
from collections.abc import Callable, Iterable
from collections.abc import Set as AbstractSet
from contextlib import suppress
from typing import Any, Final, Literal, Protocol

import msgspec

from zensim.proto import keys
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.message_times import choose_time, count_missing
from zensim.proto.messages.input_messages import Inputs, ServiceRequest
from zensim.proto.messages.standard_messages import Clock, String, ns_from_time
from zensim.proto.messages.telemetry_messages import Event, WorldClock
from zensim.proto.network_protocols import Sample, Subscription, TokenWatch
from zensim.proto.newest_messages import NewestMessages
from zensim.proto.ros2.liveliness_tokens import TOKEN_SPACE, parse_endpoint_token
from zensim.proto.service_catalog import SIMULATE_STEPS
from zensim.proto.topic_catalog import CLOCK, EVENTS, INPUTS, TF, TopicSpec
from zensim.proto.topic_endpoints import to_plain_sample
from zensim.recording.fleet_robots import FleetSelection, RobotMessageSource, is_of_many
from zensim.recording.recorded_topics import (
    RecordedMessage,
    RecordedTopic,
    TopicTable,
    make_clock_topic,
    make_requests_topic,
    write_request,
)
from zensim.recording.topic_selection import (
    ANY_ROS_TYPE,
    CLOCK_TOPIC,
    LATCHED_SUFFIXES,
    PUBLISHER,
    TopicFilter,
    list_keys,
    list_paced_topics,
    list_ros_keys,
    make_ros_key,
    name_requests_topic,
)
from zensim.spawner.client.topic_reader import TopicReader, read_as

RING_DEPTH: Final = 8192
"""Messages of one key expression between two takes: 1.6 s of a hundred robots. A longer queue
takes more memory, as each of its places is used in turn: 0.4 kB a place."""
MANY_TAKEN: Final = 100
"""Messages of one key expression that a take should find at most: what waits takes memory."""
WALL_PERIOD_S: Final = 0.01
"""Time between two takes, where the time of a take is the log time of its messages."""
SHORT_PERIOD_S: Final = 0.02
"""Time between two takes where messages have the clock of the take, or many arrive."""
LEAST_PERIOD_S, LONG_PERIOD_S = 0.002, 0.1
"""Shortest time between two takes; longest where all have stamps: a take costs 20 messages."""
EVENTS_DEPTH: Final = 1024
MOST_OPENED: Final = 256
"""Subscriptions to topics of single robots that a take begins."""
CLOCK_TIMEOUT_S: Final = 2.0
LATCHED_TIMEOUT_S: Final = 0.5
PAUSED_PERIOD_S: Final = 1.0
"""Wall time after which thinned messages are taken while the clock stands still."""

ARRIVALS: Final = ("spawned", "loaded")

TimeBase = Literal["simulation", "wall"]
MakeFleet = Callable[[FleetSelection], RobotMessageSource]


class MessageSink(Protocol):
    """Where messages go."""

    def put(self, batch: list[RecordedMessage]) -> None:
        """Take messages, in the order of their arrival."""

    def start_part(self, log_ns: int, publish_ns: int) -> None:
        """Begin a new file, as time was reset."""

    def note_event(self, event: Event) -> None:
        """Take an event of the world."""


class MessageNetwork(Protocol):
    """Where a recorder subscribes: the network, or the world of this process."""

    def subscribe(self, key: str, depth: int = 1) -> Subscription:
        """Subscribe to a key expression, keeping the newest `depth` messages."""

    def subscribe_newest(
        self, key: str, depth: int, keeps_all: Callable[[str], bool]
    ) -> NewestMessages[Any]:
        """Subscribe to the newest message of each key, and to all of some keys."""

    def expect_key(self, key: str) -> None:
        """Note a key on which many messages come, which makes each cheaper."""

    def get(self, key: str, timeout_s: float = 1.0) -> list[Sample]:
        """Get the last messages of a key expression."""

    def watch_tokens(self, key: str) -> TokenWatch:
        """Watch liveliness tokens, beginning with the present ones."""


class RecorderSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What is recorded, and by which clock."""

    world: str
    domain: int | None
    """Domain of ROS 2; None = only plain keys."""
    time_base: TimeBase = "simulation"
    """Clock of log times."""
    period_ns: int = 0
    """Simulation time in which the newest message of each topic is kept; 0 = all are."""
    step_ns: int = 0
    """Physics step, of which events name the number."""
    is_reproducible: bool = False
    """Whether times are simulation times only, and what depends on the host is left out."""
    is_in_process: bool = False
    """Whether all is published in simulation time, and taken at the step at which it is."""


class RecordedKeys(msgspec.Struct, frozen=True, eq=False):
    """Subscription on a key expression."""

    key: str
    subscription: Subscription | NewestMessages[Any]
    newest: NewestMessages[Any] | None
    """The subscription, if messages are thinned."""
    is_of_ros: bool

    def take(self, *, is_due: bool) -> list[Sample]:
        """Take the messages; thinned ones only at the end of a period."""
        if self.newest is not None and not is_due:
            self.newest.collect()
            return []
        samples = self.subscription.take()
        return [*map(to_plain_sample, samples)] if self.is_of_ros else samples

    def is_overflown(self, samples: list[Sample]) -> bool:
        """Whether messages were lost before they were taken."""
        return len(samples) >= RING_DEPTH and self.newest is None


def list_left_out(settings: RecorderSettings) -> AbstractSet[str]:
    """List the topics of which the host decides how many are published, where files are equal."""
    by_wall = settings.is_reproducible and not settings.is_in_process
    return list_paced_topics(settings.world) if by_wall else frozenset()


class Recorder:
    """Subscriptions of a recording."""

    received = 0
    """Messages that were handed over."""
    malformed = 0
    """Messages that are left out, since they do not encode their type."""
    overflows = 0
    """How often messages arrived faster than they were taken, so that some were lost."""
    missing = 0
    """Approximate number of messages lost by overflows, by the gaps between stamps."""
    _has_arrivals = True
    _has_unstamped = _is_ending = False
    _period, _taken_ns, _taken_s = 0, 0, 0.0
    _most_taken = 0
    """Messages of one key expression in the last take."""
    _thinned_period_s = SHORT_PERIOD_S
    """Half of the wall time of a period, where messages are thinned."""
    _stamped_period_s = SHORT_PERIOD_S
    """Time between two takes where all messages have stamps."""

    def __init__(
        self,
        bus: MessageNetwork,
        chosen: TopicFilter,
        settings: RecorderSettings,
        sink: MessageSink,
        make_fleet: MakeFleet | None = None,
    ) -> None:
        """Subscribe.

        Args:
            bus: Network.
            chosen: Which topics are recorded.
            settings: What is kept of them.
            sink: Takes the messages.
            make_fleet: Makes the source of odometry and transforms of large fleets, if messages are
                thinned; None = all robots publish their own.

        Raises:
            TimeoutError: No server of the world is running.
        """
        self._bus, self._chosen, self._settings, self._sink = bus, chosen, settings, sink
        self._left_out, self._follows_clock = list_left_out(settings), settings.is_in_process
        self._table = TopicTable(settings.world, self._accepts, settings.step_ns, bus.expect_key)
        self._clock_topic = make_clock_topic() if self._accepts_clock() else None
        self._inputs_key = INPUTS.key(settings.world)
        self._requests_topic = self._find_requests_topic()
        self._clock = TopicReader(self._follow(CLOCK), read_clock)
        self._events = TopicReader(self._follow(EVENTS), read_as(Event))
        self._keys = list_keys(chosen, settings.world, settings.domain)
        self._fleet = self._make_fleet(make_fleet) if make_fleet is not None else None
        self._subscriptions = [self._subscribe(key) for key in self._keys]
        self._of_robots: dict[str, RecordedKeys] = {}  # topics of single robots of a fleet
        self._tokens = self._watch_tokens()
        self._announced: dict[str, set[str]] = {}
        """Tokens of the publishers of each key that is subscribed to as they announce it."""
        self._now_ns, self._epoch = self._read_first_clock()
        self._last_ns: dict[RecordedTopic, int] = {}
        self._early: list[Sample] = []  # of the time after a reset, until they are due
        self._record_latched()

    @property
    def unknown_topics(self) -> tuple[str, ...]:
        """Topics that are left out, since their type is not known."""
        return tuple(sorted(self._table.unknown))

    @property
    def now_ns(self) -> int:
        """Newest time of the world's clock."""
        return self._now_ns

    @property
    def take_period_s(self) -> float:
        """Wall time [s] until the next call of `take`."""
        settings = self._settings
        if settings.time_base == "wall":
            return WALL_PERIOD_S
        if settings.period_ns:
            return self._thinned_period_s
        return SHORT_PERIOD_S if self._has_unstamped else self._stamped_period_s

    def take(self, *, is_last: bool = False) -> None:
        """Hand over all messages that arrived since the last call.

        Args:
            is_last: Whether thinned messages are handed over before their period ends.
        """
        received_ns = time.time_ns()
        self._most_taken = 0
        self._is_ending = is_last
        self._take_events()
        clock = self._take_clock(received_ns)
        is_due = self._is_period_over() or is_last
        if self._settings.period_ns:
            clock = clock[-1:] if is_due else []
        self._take_fleet(received_ns, clock, is_due=is_due)
        self._take_samples(received_ns, clock, is_due=is_due)
        self._follow_announced()
        fitting_s = self._stamped_period_s * MANY_TAKEN / max(1, self._most_taken)
        self._stamped_period_s = min(LONG_PERIOD_S, max(SHORT_PERIOD_S, fitting_s))

    def take_arrivals(self) -> bool:
        """Whether entities were spawned or a world was loaded since the last call; yes at first."""
        found, self._has_arrivals = self._has_arrivals, False
        return found

    def close(self) -> None:
        """End the subscriptions."""
        recorded = (*self._subscriptions, *self._of_robots.values())
        for one in (self._clock, self._events, *(one.subscription for one in recorded)):
            one.close()
        if self._tokens is not None:
            self._tokens.close()
        if self._fleet is not None:
            self._fleet.close()

    def _watch_tokens(self) -> TokenWatch | None:
        """Watch what ROS 2 nodes announce, if topics are chosen among all."""
        domain = self._settings.domain
        if not self._chosen.is_broad or domain is None:
            return None
        return self._bus.watch_tokens(f"{TOKEN_SPACE}/{domain}/**")

    def _make_fleet(self, make: MakeFleet) -> RobotMessageSource:
        """Take key expressions of many robots from their agents instead."""
        taken = [one for one in self._keys if is_of_many(one)]
        # The joint topic of all transforms is no robot's own.
        has_shared = any(keys.intersect(one, TF.suffix) for one in taken)
        self._keys = [one for one in self._keys if one not in taken]
        self._keys += [TF.suffix] if has_shared and TF.suffix not in self._keys else []
        return make(FleetSelection(tuple(taken), self._table.find))

    def _take_fleet(self, received_ns: int, batch: list[RecordedMessage], *, is_due: bool) -> None:
        """Append the messages of a fleet, and subscribe to those that agents do not send."""
        if self._fleet is None:
            return
        self._fleet.collect(self._epoch)
        if is_due:
            self._follow_robots(self._fleet.find_single_keys(self._now_ns))
            self._append_fleet(received_ns, batch)

    def _follow_robots(self, wanted: AbstractSet[str]) -> None:
        """Subscribe to topics of single robots; some at once, as each takes time."""
        for key in self._of_robots.keys() - wanted:
            # What waits there is made of the odometry of agents again, or of a deleted robot.
            self._of_robots.pop(key).subscription.close()
        for key in sorted(wanted - self._of_robots.keys())[:MOST_OPENED]:
            self._of_robots[key] = self._subscribe(key)

    def _append_fleet(self, received_ns: int, batch: list[RecordedMessage]) -> None:
        if self._fleet is None:
            return
        has_wall_times, now_ns = self._settings.time_base == "wall", self._now_ns
        for stamp_ns, topic, payload in self._fleet.take():
            log_ns = received_ns if has_wall_times else choose_time(stamp_ns, now_ns)
            batch.append((topic, log_ns, received_ns, payload))

    def _accepts(self, topic: str, ros_type: str | None) -> bool:
        return self._chosen.accepts(topic, ros_type) and topic not in self._left_out

    def _accepts_clock(self) -> bool:
        return self._accepts(CLOCK_TOPIC, Clock.ros_type)

    def _find_requests_topic(self) -> RecordedTopic | None:
        world = self._settings.world
        if not self._accepts(name_requests_topic(world), String.ros_type):
            return None
        return make_requests_topic(world, self._settings.step_ns)

    def _is_period_over(self) -> bool:
        """Whether the clock has passed the end of a period; always, if there is none."""
        period_ns = self._settings.period_ns
        if not period_ns:
            return True
        period, now_s = self._now_ns // period_ns, time.monotonic()
        is_paused = self._now_ns == self._taken_ns and now_s >= self._taken_s + PAUSED_PERIOD_S
        is_over = period != self._period or is_paused
        if is_over:
            passed_s, passed_ns = now_s - self._taken_s, self._now_ns - self._taken_ns
            fitting_s = passed_s * period_ns / passed_ns / 2 if passed_ns > 0 else SHORT_PERIOD_S
            self._thinned_period_s = min(SHORT_PERIOD_S, max(LEAST_PERIOD_S, fitting_s))
            self._period, self._taken_ns, self._taken_s = period, self._now_ns, now_s
        return is_over

    def _take_samples(
        self, received_ns: int, batch: list[RecordedMessage], *, is_due: bool
    ) -> None:
        """Append what was received to a batch, and hand it over."""
        if is_due:
            early, self._early = self._early, []
            self._convert(early, received_ns, batch)
        for one in (*self._subscriptions, *self._of_robots.values()):
            self._take_one(one, received_ns, batch, is_due=is_due)
        self._hand_over(batch)

    def _take_before(
        self, reset: WorldClock, received_ns: int, batch: list[RecordedMessage]
    ) -> None:
        """Hand over what was received and is of the time before a reset; keep the rest.

        Args:
            reset: Clock after the reset.
            received_ns: Time of day.
            batch: What is handed over, too.
        """
        early, self._early = self._early, []
        self._convert(self._keep_early(early, reset), received_ns, batch)
        for one in (*self._subscriptions, *self._of_robots.values()):
            self._take_one(one, received_ns, batch, is_due=True, reset=reset)
        self._hand_over(batch)

    def _keep_early(self, samples: Iterable[Sample], reset: WorldClock) -> list[Sample]:
        """Keep messages that are of the time after a reset; return the others."""
        before: list[Sample] = []
        for sample in samples:
            (self._early if self._is_after(sample, reset) else before).append(sample)
        return before

    def _is_after(self, sample: Sample, reset: WorldClock) -> bool:
        """Whether the epoch of inputs, or the stamp of a message, is of the time after a reset."""
        if sample.key == self._inputs_key:
            # More resets may follow. A server that was started again may begin at 0.
            return self._epoch != self._read_epoch(sample) >= reset.epoch
        stamp_ns, reset_ns = self._read_stamp(sample), ns_from_time(reset.clock)
        return stamp_ns is not None and abs(stamp_ns - reset_ns) < abs(stamp_ns - self._now_ns)

    def _read_epoch(self, sample: Sample) -> int:
        """Read the epoch of inputs; that of now if they are malformed."""
        try:
            return decode(Inputs, sample.payload, sample.encoding).epoch
        except MalformedPayload:
            return self._epoch

    def _read_stamp(self, sample: Sample) -> int | None:
        topic = self._table.find(sample)
        if topic is None or topic.is_latched:
            return None
        try:
            return topic.read_stamp(topic.to_cdr(sample))
        except MalformedPayload:
            return None  # counted when it is converted

    def _take_one(
        self,
        one: RecordedKeys,
        received_ns: int,
        batch: list[RecordedMessage],
        *,
        is_due: bool,
        reset: WorldClock | None = None,
    ) -> None:
        """Append what a subscription received; estimate how many were lost if it was full."""
        samples, start = one.take(is_due=is_due), len(batch)
        self._most_taken = max(self._most_taken, len(samples))
        is_overflown = one.is_overflown(samples)
        if reset is not None:
            samples = self._keep_early(samples, reset)
        self._convert(samples, received_ns, batch)
        if is_overflown:
            self.overflows += 1
            self.missing += self._count_missing(batch[start:])

    def _count_missing(self, batch: Iterable[RecordedMessage]) -> int:
        times: dict[RecordedTopic, list[int]] = {}
        for topic, log_ns, _, _ in batch:
            times.setdefault(topic, []).append(log_ns)
        return sum(count_missing(self._last_ns.get(topic), one) for topic, one in times.items())

    def _hand_over(self, batch: list[RecordedMessage]) -> None:
        self._last_ns.update({topic: log_ns for topic, log_ns, _, _ in batch})
        self.received += len(batch)
        self._sink.put(batch)

    def _convert(
        self, samples: Iterable[Sample], received_ns: int, batch: list[RecordedMessage]
    ) -> None:
        """Append the messages of the selected topics."""
        find, now_ns = self._table.find, self._now_ns
        has_wall_times = self._settings.time_base == "wall"
        is_reproducible = self._settings.is_reproducible
        by_wall = is_reproducible and not self._settings.is_in_process
        latched_ns, inputs_key = 0 if by_wall else max(0, now_ns), self._inputs_key
        for sample in samples:
            if sample.key == inputs_key:
                if self._read_epoch(sample) > self._epoch and not self._is_ending:
                    self._early.append(sample)  # the clock of its time comes after it
                    continue
                self._add_requests(sample, received_ns, batch)
            if (topic := find(sample)) is None:
                continue
            try:
                payload = topic.to_cdr(sample)
            except MalformedPayload:
                self.malformed += 1
                continue
            if has_wall_times:
                log_ns = received_ns
            elif topic.is_latched:
                # It may be from long ago, and it arrives at any time.
                log_ns = latched_ns
            else:
                stamp_ns = topic.read_stamp(payload)
                self._has_unstamped |= stamp_ns is None
                log_ns = choose_time(stamp_ns, now_ns)
            batch.append((topic, log_ns, log_ns if is_reproducible else received_ns, payload))

    def note_requests(self, requests: Iterable[ServiceRequest]) -> None:
        """Record requests that changed the world."""
        batch: list[RecordedMessage] = []
        self._convert_requests(requests, time.time_ns(), batch)
        self._hand_over(batch)

    def _add_requests(self, sample: Sample, received_ns: int, batch: list[RecordedMessage]) -> None:
        """Append the requests of a message of inputs."""
        if self._requests_topic is not None:
            with suppress(MalformedPayload):  # counted below
                inputs = decode(Inputs, sample.payload, sample.encoding)
                self._convert_requests(inputs.requests, received_ns, batch)

    def _convert_requests(
        self, requests: Iterable[ServiceRequest], received_ns: int, batch: list[RecordedMessage]
    ) -> None:
        if (topic := self._requests_topic) is not None:
            settings = self._settings
            # Each control step has a request for steps, which are no change of their own.
            for request in (one for one in requests if one.service != SIMULATE_STEPS.name):
                payload = write_request(request)
                log_ns = choose_time(topic.read_stamp(payload), self._now_ns)
                log_ns = received_ns if settings.time_base == "wall" else log_ns
                publish_ns = log_ns if settings.is_reproducible else received_ns
                batch.append((topic, log_ns, publish_ns, payload))

    def _take_clock(self, received_ns: int) -> list[RecordedMessage]:
        """Read the clock; return its messages, if they are recorded."""
        batch: list[RecordedMessage] = []
        for clock, sample in self._clock.take():
            now_ns = max(0, ns_from_time(clock.clock))
            log_ns = received_ns if self._settings.time_base == "wall" else now_ns
            publish_ns = log_ns if self._settings.is_reproducible else received_ns
            # On the network, the first time that was read may be later than what waits here. A
            # server that was started again begins with the same epoch.
            is_back = self._follows_clock and now_ns < self._now_ns
            self._follows_clock = True
            if clock.epoch != self._epoch or is_back:
                if self._fleet is not None:
                    self._fleet.collect(self._epoch)
                self._append_fleet(received_ns, batch)
                if self._settings.is_in_process:
                    # Nothing has been published since.
                    self._take_samples(received_ns, batch, is_due=True)
                else:
                    self._take_before(clock, received_ns, batch)
                batch = []
                self._epoch = clock.epoch
                self._last_ns.clear()
                self._sink.start_part(log_ns, publish_ns)
            self._now_ns = now_ns
            if self._clock_topic is not None:
                topic = self._clock_topic
                batch.append((topic, log_ns, publish_ns, topic.to_cdr(sample)))
        return batch

    def _take_events(self) -> None:
        events = self._events.take()
        for event in events:
            self._has_arrivals |= event.kind in ARRIVALS
            self._sink.note_event(event)
            if self._fleet is not None:
                self._fleet.note_event(event)
        if self._fleet is not None and len(events) >= EVENTS_DEPTH:
            self._fleet.clear()  # events were lost, as of robots that were deleted

    def _read_first_clock(self) -> tuple[int, int]:
        deadline = time.monotonic() + CLOCK_TIMEOUT_S
        key = CLOCK.key(self._settings.world)
        while time.monotonic() < deadline:
            for sample in self._bus.get(key, LATCHED_TIMEOUT_S):
                with suppress(MalformedPayload):
                    clock = decode(WorldClock, sample.payload, sample.encoding)
                    return max(0, ns_from_time(clock.clock)), clock.epoch
        raise TimeoutError(
            f"no clock on {key} within {CLOCK_TIMEOUT_S:g} s; start a server, or check `world_name`"
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

    def _follow_announced(self) -> None:
        """Subscribe to topics that ROS 2 nodes announce, as long as one publishes them.

        They are those that no key expression covers.
        """
        for token, is_alive in self._tokens.take() if self._tokens is not None else ():
            if is_alive:
                self._add_announced(token)
            else:
                self._remove_announced(token)

    def _add_announced(self, token: str) -> None:
        endpoint, domain = parse_endpoint_token(token), self._settings.domain
        if endpoint is None or domain is None or endpoint.kind != PUBLISHER:
            return
        key = make_ros_key(endpoint.key, domain)
        if key not in self._announced:
            if not list_ros_keys(self._chosen, [endpoint], self._keys, domain):
                return
            self._announced[key] = set()
            self._keys.append(key)
            self._subscriptions.append(self._subscribe(key))
        self._announced[key].add(token)

    def _remove_announced(self, token: str) -> None:
        for key, tokens in tuple(self._announced.items()):
            tokens.discard(token)
            if not tokens:
                del self._announced[key]
                self._keys.remove(key)
                self._end(next(one for one in self._subscriptions if one.key == key))

    def _end(self, one: RecordedKeys) -> None:
        """Hand over the last messages of a subscription, and close it."""
        self._subscriptions.remove(one)
        batch: list[RecordedMessage] = []
        self._take_one(one, time.time_ns(), batch, is_due=True)
        self._hand_over(batch)
        one.subscription.close()

    def _follow(self, topic: TopicSpec) -> Subscription:
        return self._bus.subscribe(topic.key(self._settings.world), EVENTS_DEPTH)

    def _subscribe(self, key: str) -> RecordedKeys:
        is_of_ros = key.endswith(f"/{ANY_ROS_TYPE}")
        if self._settings.period_ns and not keeps_all(key):
            found = self._bus.subscribe_newest(key, RING_DEPTH, keeps_all)
            return RecordedKeys(key, found, found, is_of_ros)
        return RecordedKeys(key, self._bus.subscribe(key, RING_DEPTH), None, is_of_ros)


def read_clock(sample: Sample) -> tuple[WorldClock, Sample]:
    """Read a message of the clock, with its bytes; raises MalformedPayload."""
    return decode(WorldClock, sample.payload, sample.encoding), sample


def is_of_robot(sample: Sample) -> bool:
    """Whether a reply is from a topic of a robot, or of the root."""
    return not sample.key.startswith("sim/") and "*" not in sample.key


def is_latched(key: str) -> bool:
    """Whether late subscribers of a key get the last message."""
    return any(f"/{suffix}/" in f"/{key}/" for suffix in LATCHED_SUFFIXES)


def keeps_all(key: str) -> bool:
    """Whether a key is never thinned: what the server publishes, and latched messages."""
    return key.startswith("sim/") or is_latched(key)
