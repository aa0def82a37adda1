"""What a recorder subscribes to and hands over, from an in-memory network."""

import json
from collections.abc import Callable, Iterator
from typing import Any, cast

import msgspec
import pytest

from tests.fakes import MemoryBus, MemoryToken, MemoryTokenWatch
from zensim.api.in_process_recorder import newest_of
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.input_messages import Inputs, ServiceRequest
from zensim.proto.messages.standard_messages import (
    Header,
    Imu,
    Odometry,
    String,
    Time,
    Twist,
    time_from_ns,
)
from zensim.proto.messages.telemetry_messages import Event, WorldClock
from zensim.proto.network_protocols import Sample
from zensim.proto.newest_messages import NewestMessages
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint, GraphNode, make_endpoint_token
from zensim.proto.topic_catalog import CLOCK, EVENTS, INPUTS
from zensim.recording import recorder as recorder_module
from zensim.recording.recorded_topics import RecordedMessage, RecordedTopic, TopicTable
from zensim.recording.recorder import (
    EVENTS_DEPTH,
    LONG_PERIOD_S,
    MANY_TAKEN,
    MOST_OPENED,
    SHORT_PERIOD_S,
    WALL_PERIOD_S,
    MessageNetwork,
    Recorder,
    RecorderSettings,
)
from zensim.recording.topic_selection import TopicFilter, TopicSelection

WORLD = "default"
STEP_NS = 10_000_000
SECOND_NS = 1_000_000_000


class MessageList:
    """Keeps what a recorder hands over."""

    def __init__(self) -> None:
        self.messages: list[RecordedMessage] = []
        self.parts: list[int] = []
        self.begins: list[int] = []
        """Number of messages before each part."""

    def put(self, batch: list[RecordedMessage]) -> None:
        self.messages += batch

    def start_part(self, log_ns: int, publish_ns: int) -> None:
        del publish_ns
        self.parts.append(log_ns)
        self.begins.append(len(self.messages))

    def note_event(self, event: Event) -> None:
        del event

    def texts_of(self, topic: str) -> list[str]:
        encoding = make_encoding(String, Format.CDR)
        return [
            decode(String, payload, encoding).data
            for found, _, _, payload in self.messages
            if found.name == topic
        ]


@pytest.fixture
def bus() -> MemoryBus:
    bus = MemoryBus()
    clock = bus.serve(CLOCK.key(WORLD))
    message = encode(WorldClock(Time(1, 0), 100, 0), Format.MSGPACK)

    def reply() -> None:
        for call in clock.take():
            call.reply(message, CLOCK.encoding)

    bus.pumps.append(reply)
    return bus


class ListedFleet:
    """Robots of a fleet, of which it is listed what is to be recorded."""

    def __init__(self) -> None:
        self.keys: set[str] = set()
        self.kept: list[tuple[int, RecordedTopic, bytes]] = []
        """Messages of the current epoch."""
        self.epochs: list[int] = []
        self.cleared = 0

    def collect(self, epoch: int) -> None:
        self.epochs.append(epoch)

    def take(self) -> Iterator[tuple[int, RecordedTopic, bytes]]:
        taken, self.kept = self.kept, []
        return iter(taken)

    def find_single_keys(self, now_ns: int) -> set[str]:
        del now_ns
        return self.keys

    def note_event(self, event: Event) -> None:
        del event

    def clear(self) -> None:
        self.cleared += 1

    def close(self) -> None:
        pass


@pytest.fixture
def fleet() -> ListedFleet:
    return ListedFleet()


@pytest.fixture
def fleet_recorder(bus: MemoryBus, fleet: ListedFleet) -> tuple[Recorder, MessageList]:
    """Recorder of a large fleet."""
    chosen = TopicFilter(TopicSelection(topics=("*/odom",)))
    settings = RecorderSettings(world=WORLD, domain=None)
    sink = MessageList()
    network = cast("MessageNetwork", bus)
    return Recorder(network, chosen, settings, sink, lambda _: fleet), sink


def list_odometry_keys(bus: MemoryBus) -> list[str]:
    return [key for key in bus.subscribed_keys if key.endswith("/odom")]


def test_topics_of_single_robots_are_subscribed_to_once_and_as_long_as_listed(
    bus: MemoryBus, fleet: ListedFleet, fleet_recorder: tuple[Recorder, MessageList]
) -> None:
    recorder, sink = fleet_recorder
    fleet.keys = {"r1/odom", "r2/odom"}
    for _ in range(3):
        recorder.take()
    before = sorted(list_odometry_keys(bus))
    bus.put_message("r1/odom", Odometry(Header(Time(2))), Format.CDR)
    recorder.take()
    fleet.keys = {"r2/odom"}
    recorder.take()

    assert before == ["r1/odom", "r2/odom"]
    assert list_odometry_keys(bus) == ["r2/odom"]
    assert [one[0].name for one in sink.messages] == ["/r1/odom"]
    recorder.close()
    assert list_odometry_keys(bus) == []


def test_few_subscriptions_begin_at_once(
    bus: MemoryBus, fleet: ListedFleet, fleet_recorder: tuple[Recorder, MessageList]
) -> None:
    recorder, _ = fleet_recorder
    fleet.keys = {f"r{number}/odom" for number in range(MOST_OPENED + 10)}
    recorder.take()
    first = len(list_odometry_keys(bus))
    recorder.take()

    assert (first, len(list_odometry_keys(bus))) == (MOST_OPENED, MOST_OPENED + 10)


def test_robots_are_found_again_when_events_were_lost(
    bus: MemoryBus, fleet: ListedFleet, fleet_recorder: tuple[Recorder, MessageList]
) -> None:
    recorder, _ = fleet_recorder
    found = []
    for count in (10, EVENTS_DEPTH):
        for number in range(count):
            bus.put_message(EVENTS.key(WORLD), Event("deleted", f"e{number}"), Format.MSGPACK)
        recorder.take()
        found.append(fleet.cleared)

    assert found == [0, 1]


def test_last_messages_before_a_reset_are_collected(
    bus: MemoryBus, fleet: ListedFleet, fleet_recorder: tuple[Recorder, MessageList]
) -> None:
    recorder, sink = fleet_recorder
    table = TopicTable(WORLD, lambda *_: True)
    payload = encode(Odometry(), Format.CDR)
    topic = table.find(Sample("r1/odom", payload, make_encoding(Odometry, Format.CDR)))
    assert topic is not None
    fleet.kept = [(SECOND_NS, topic, payload)]
    bus.put_message(CLOCK.key(WORLD), WorldClock(Time(0, 0), 0, 1), Format.MSGPACK)

    recorder.take()

    assert fleet.epochs == [0, 1]
    assert len(sink.messages) == 1


Make = Callable[..., tuple[Recorder, MessageList]]


@pytest.fixture
def make(bus: MemoryBus) -> Make:
    def make(*, period_ns: int = 0, **selected: object) -> tuple[Recorder, MessageList]:
        chosen = TopicFilter(msgspec.convert(selected, TopicSelection))
        settings = RecorderSettings(world=WORLD, domain=0, step_ns=STEP_NS, period_ns=period_ns)
        sink = MessageList()
        # It thins nothing here.
        return Recorder(cast("MessageNetwork", bus), chosen, settings, sink), sink

    return make


def test_recorder_expects_messages_on_keys_that_it_records(bus: MemoryBus, make: Make) -> None:
    recorder, _ = make(wants_all=True, exclude_topics=("r2/odom",))

    for _ in range(2):
        for key in ("r1/odom", "r2/odom", "r3/odom"):
            bus.put_message(key, Odometry())
        recorder.take()

    assert bus.expected_keys == ["r1/odom", "r3/odom"]


def announce(bus: MemoryBus, topic: str, number: int) -> MemoryToken:
    """Announce a publisher of a ROS 2 node."""
    endpoint = GraphEndpoint(
        node=GraphNode(domain=0, zid="ab12", number=0, name="talker"),
        number=number,
        kind="MP",
        name=f"/{topic}",
        ros_type="std_msgs/msg/String",
        type_hash="RIHS01_0",
    )
    return bus.token(make_endpoint_token(endpoint))


def test_subscription_ends_with_the_last_publisher_of_its_topic(bus: MemoryBus, make: Make) -> None:
    recorder, sink = make(wants_all=True)
    first, second = announce(bus, "chatter", 1), announce(bus, "chatter", 2)
    recorder.take()
    before = [key for key in bus.subscribed_keys if "chatter" in key]

    first.close()
    recorder.take()
    between = [key for key in bus.subscribed_keys if "chatter" in key]
    second.close()
    recorder.take()
    after = [key for key in bus.subscribed_keys if "chatter" in key]

    assert (len(before), between, after) == (1, before, [])
    assert sink.messages == []


def test_topic_that_comes_back_is_subscribed_to_again(bus: MemoryBus, make: Make) -> None:
    recorder, _ = make(wants_all=True)
    for number in range(3):
        token = announce(bus, "chatter", number)
        recorder.take()
        assert sum("chatter" in key for key in bus.subscribed_keys) == 1
        token.close()
        recorder.take()

    assert not any("chatter" in key for key in bus.subscribed_keys)


class LateMessages:
    """Watch of tokens; messages arrive before it is read, and after all else was."""

    def __init__(self, watch: MemoryTokenWatch, arrive: Callable[[], object]) -> None:
        self._watch, self._arrive = watch, arrive

    def take(self) -> list[tuple[str, bool]]:
        self._arrive()
        return self._watch.take()

    def close(self) -> None:
        self._watch.close()


def test_messages_of_an_ended_topic_are_known_to_be_too_many(
    bus: MemoryBus, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "RING_DEPTH", 3)
    watch, sent = bus.watch_tokens, list[str]()
    key = "0/chatter/std_msgs::msg::dds_::String_/RIHS01_0"

    def arrive() -> None:
        for text in sent:
            bus.put(key, encode(String(text), Format.CDR))

    monkeypatch.setattr(bus, "watch_tokens", lambda key: LateMessages(watch(key), arrive))
    recorder, sink = make(wants_all=True)
    token = announce(bus, "chatter", 1)
    recorder.take()

    sent += ["a", "b", "c", "d"]
    token.close()
    recorder.take()

    assert sink.texts_of("/chatter") == ["b", "c", "d"]
    assert recorder.overflows == 1


REQUEST = ServiceRequest(90, "spawn_entity", "client_1", '{"name":"r1"}')
STEPS = ServiceRequest(91, "simulate_steps", "client_1", '{"steps":1}')
DEEP = ServiceRequest(95, "load_world", "", "[" * 100_000)
CUT = ServiceRequest(95, "load_world", "", '{"uri":"wal', 1)


@pytest.mark.parametrize(
    "selected",
    [
        {"wants_all": True},
        {"topics": ("sim/default/requests",)},
        {"topics": ("sim/*/requests", "r1/odom")},
        {"regex": "requests$"},
        {"wants_all": True, "exclude_topics": ("sim/default/inputs",)},
    ],
)
def test_requests_are_readable_texts_at_their_steps(
    bus: MemoryBus, make: Make, selected: dict[str, object]
) -> None:
    recorder, sink = make(**selected)

    inputs = Inputs("log", 0, 0, 100, (REQUEST, STEPS, CUT), b"")
    bus.put_message(INPUTS.key(WORLD), inputs, Format.MSGPACK)
    recorder.take()

    first, second = map(json.loads, sink.texts_of("/sim/default/requests"))
    assert (first["service"], first["request"], first["code"]) == (
        "spawn_entity",
        {"name": "r1"},
        1,
    )
    assert (second["request"], second["is_cut"]) == ('{"uri":"wal', True)
    times = [log_ns for topic, log_ns, _, _ in sink.messages if "requests" in topic.name]
    assert times == [90 * STEP_NS, 95 * STEP_NS]
    inputs_count = sum(topic.name == "/sim/default/inputs" for topic, *_ in sink.messages)
    assert inputs_count == (selected == {"wants_all": True})


def test_request_whose_json_is_too_deep_remains_a_text(bus: MemoryBus, make: Make) -> None:
    recorder, sink = make(wants_all=True)

    inputs = Inputs("log", 0, 0, 100, (DEEP, REQUEST), b"")
    bus.put_message(INPUTS.key(WORLD), inputs, Format.MSGPACK)
    recorder.take()

    deep, other = map(json.loads, sink.texts_of("/sim/default/requests"))
    assert (deep["request"], deep["is_cut"]) == (DEEP.request, True)
    assert other["request"] == {"name": "r1"}


def test_topics_are_recorded_by_their_types(bus: MemoryBus, make: Make) -> None:
    recorder, sink = make(types=(Odometry.ros_type,))

    bus.put_message("r1/odom", Odometry())
    bus.put_message("r1/cmd_vel", Twist())
    recorder.take()

    assert {topic.name for topic, *_ in sink.messages} == {"/r1/odom"}


def test_requests_are_left_out_on_demand(bus: MemoryBus, make: Make) -> None:
    recorder, sink = make(wants_all=True, exclude_topics=("sim/default/requests",))

    inputs = Inputs("log", 0, 0, 100, (REQUEST,), b"")
    bus.put_message(INPUTS.key(WORLD), inputs, Format.MSGPACK)
    recorder.take()

    assert {topic.name for topic, *_ in sink.messages} == {"/sim/default/inputs"}


def test_new_epoch_or_an_older_time_than_that_before_begins_a_file(
    bus: MemoryBus, make: Make
) -> None:
    recorder, sink = make(topics=("r1/odom",))
    # The service said 1 s. A server that was started again is at 1 s, too.
    for seconds, epoch in ((0, 0), (3, 0), (1, 0), (2, 1)):
        clock = WorldClock(Time(seconds, 0), seconds * 100, epoch)
        bus.put_message(CLOCK.key(WORLD), clock, Format.MSGPACK)
        bus.put_message("r1/odom", Odometry())
        recorder.take()

    assert sink.parts == [1_000_000_000, 2_000_000_000]


@pytest.mark.parametrize("period_ns", [0, 10 * SECOND_NS], ids=["all", "thinned"])
def test_messages_of_the_time_after_a_reset_are_in_its_file(
    bus: MemoryBus, make: Make, period_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def subscribe_newest(
        key: str, depth: int, keeps_all: Callable[[str], bool]
    ) -> NewestMessages[Sample]:
        return newest_of(bus.subscribe(key, depth), keeps_all)

    monkeypatch.setattr(bus, "subscribe_newest", subscribe_newest, raising=False)
    recorder, sink = make(period_ns=period_ns, topics=("r1/*", "clock", "sim/default/inputs"))
    put_clock(bus, 30.0, epoch=0)
    bus.put_message("r1/odom", Odometry(Header(Time(29, 990_000_000))))
    bus.put_message("r1/cmd_vel", Twist())
    put_clock(bus, 0.0, epoch=1)
    bus.put_message("r1/imu", Imu(Header(Time(0, 50_000_000))))
    put_clock(bus, 0.06, epoch=1)
    for epoch in (0, 1):
        inputs = Inputs("log", sequence=epoch, epoch=epoch)
        bus.put_message(INPUTS.key(WORLD), inputs, Format.MSGPACK)

    recorder.take()
    recorder.take(is_last=True)

    (begin,) = sink.begins
    before, after = (
        [(topic.name, log_ns) for topic, log_ns, *_ in part if topic.name != "/clock"]
        for part in (sink.messages[:begin], sink.messages[begin:])
    )
    assert sorted(before) == [
        ("/r1/cmd_vel", 30 * SECOND_NS),
        ("/r1/odom", 29_990_000_000),
        ("/sim/default/inputs", 30 * SECOND_NS),
    ]
    assert sorted(after) == [("/r1/imu", 50_000_000), ("/sim/default/inputs", 60_000_000)]


def test_inputs_of_two_resets_between_two_takes_are_in_the_file_of_each(
    bus: MemoryBus, make: Make
) -> None:
    recorder, sink = make(topics=("sim/default/inputs",))
    put_clock(bus, 30.0, epoch=0)
    for epoch in (1, 2):
        put_clock(bus, 0.0, epoch=epoch)
    inputs = [Inputs("log", epoch, epoch) for epoch in (0, 1, 2)]
    for one in inputs:
        bus.put_message(INPUTS.key(WORLD), one, Format.MSGPACK)

    recorder.take()

    assert sink.begins == [1, 2]
    for one, (*_, payload) in zip(inputs, sink.messages, strict=True):
        assert encode(one, Format.MSGPACK) in payload


def test_inputs_that_come_before_the_clock_of_their_time_are_in_its_file(
    bus: MemoryBus, make: Make
) -> None:
    recorder, sink = make(topics=("sim/default/inputs",))
    put_clock(bus, 30.0, epoch=0)
    bus.put_message(INPUTS.key(WORLD), Inputs("log", 1, 1), Format.MSGPACK)
    recorder.take()
    assert sink.messages == []

    put_clock(bus, 0.0, epoch=1)
    recorder.take()
    bus.put_message(INPUTS.key(WORLD), Inputs("log", 2, 2), Format.MSGPACK)
    recorder.take(is_last=True)

    assert sink.begins == [0]
    assert len(sink.messages) == 2


def put_clock(bus: MemoryBus, time_s: float, *, epoch: int) -> None:
    clock = WorldClock(time_from_ns(round(time_s * SECOND_NS)), round(time_s * 100), epoch)
    bus.put_message(CLOCK.key(WORLD), clock, Format.MSGPACK)


@pytest.mark.parametrize(
    ("messages", "settings", "period_s"),
    [
        ((Odometry(Header(Time(1, 0))),), {}, LONG_PERIOD_S),
        ((), {}, LONG_PERIOD_S),
        ((Odometry(Header(Time(1, 0))), Twist()), {}, SHORT_PERIOD_S),
        ((Odometry(Header(Time(1, 0))),) * 2 * MANY_TAKEN, {}, SHORT_PERIOD_S),
        ((Odometry(Header(Time(1, 0))),), {"time_base": "wall"}, WALL_PERIOD_S),
    ],
    ids=["stamped", "none", "unstamped", "many", "wall"],
)
def test_messages_are_taken_as_often_as_their_times_need(
    bus: MemoryBus, messages: tuple[msgspec.Struct, ...], settings: dict[str, Any], period_s: float
) -> None:
    chosen = TopicFilter(TopicSelection(topics=("r1/*",)))
    made = RecorderSettings(world=WORLD, domain=None, **settings)
    recorder = Recorder(cast("MessageNetwork", bus), chosen, made, MessageList())

    for message in messages:
        bus.put_message(f"r1/{'cmd_vel' if isinstance(message, Twist) else 'odom'}", message)
    recorder.take()

    assert recorder.take_period_s == period_s
