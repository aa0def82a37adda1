"""Clients of the hub: what they subscribe to in the network, and what they get."""

import json
import struct
from typing import Any

import pytest

from tests.foxglove.fake_bus import FakeBus, FakeSubscription
from zensim.foxglove.foxglove_protocol import frame_message
from zensim.foxglove.live_hub import MAX_WARNINGS, Job, LiveHub
from zensim.foxglove.scene_messages import SceneUpdate
from zensim.foxglove.world_control import WorldControl
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Shape
from zensim.proto.messages.standard_messages import (
    Header,
    Odometry,
    Point,
    Pose,
    String,
    TFMessage,
    Time,
    TransformStamped,
    Twist,
    Vector3,
)
from zensim.proto.messages.telemetry_messages import (
    EntityModel,
    Event,
    GetModelsResponse,
    WorldClock,
)
from zensim.proto.network_protocols import Sample
from zensim.proto.topic_catalog import CLOCK, EVENTS

WORLD = "w"
ROOTS = {CLOCK.key(WORLD), EVENTS.key(WORLD)}
BOX = Shape("box", (0.2, 0.2, 0.1), rgba=(1.0, 0.0, 0.0, 1.0))
WHEEL = Shape("mesh", (1.0, 1.0, 1.0), mesh="ab" * 32)
MODEL = Model(
    "bot",
    (Link("base", visuals=(BOX,)), Link("wheel", visuals=(WHEEL,))),
    (Joint("axle", "continuous", "base", "wheel", Origin((0.0, 0.1, 0.0))),),
    drive=DiffDrive(publish_odom_tf=True, odometry_frame="odom"),
)


class RecordingLink:
    """Keeps texts as values, and binary messages of topics as tuples."""

    def __init__(self) -> None:
        self.texts: list[dict[str, Any]] = []
        self.data: list[tuple[int, int, bytes]] = []
        self.times: list[int] = []
        self.has_backlog = False

    def is_slow(self) -> bool:
        return self.has_backlog

    def send(self, message: str | bytes) -> None:
        if isinstance(message, str):
            self.texts.append(json.loads(message))
        elif message[0] == 2:
            self.times.append(struct.unpack_from("<Q", message, 1)[0])

    def send_data(self, frames: bytes, messages: int) -> bool:
        if self.has_backlog:
            return False
        count = len(self.data)
        while frames:
            start, size = 2, frames[1]
            if size == 126:
                start, size = 4, int.from_bytes(frames[2:4], "big")
            elif size == 127:
                start, size = 10, int.from_bytes(frames[2:10], "big")
            body, frames = frames[start : start + size], frames[start + size :]
            _, subscription, time_ns = struct.unpack_from("<BIQ", body)
            self.data.append((subscription, time_ns, body[13:]))
        assert len(self.data) - count == messages
        return True

    def take(self, op: str) -> list[dict[str, Any]]:
        found = [one for one in self.texts if one["op"] == op]
        self.texts = [one for one in self.texts if one["op"] != op]
        return found

    def channels(self) -> dict[str, int]:
        return {
            one["topic"]: one["id"] for text in self.take("advertise") for one in text["channels"]
        }


def make_hub(bus: FakeBus, *, has_control: bool = False) -> LiveHub:
    control = WorldControl(bus.as_bus, WORLD, None) if has_control else None
    return LiveHub(bus.as_bus, WORLD, None, control=control, read_asset=lambda uri: uri.encode())


def run_jobs(hub: LiveHub, *jobs: Job) -> list[Any]:
    """Do the work that blocks; return what goes to the client."""
    outcomes = [job() for job in (*jobs, *hub.take_jobs())]
    return [one() if callable(one) else one for one in outcomes]


def tell(hub: LiveHub, link: RecordingLink, **message: object) -> list[Any]:
    return run_jobs(hub, *hub.receive(link, json.dumps(message)))


def join(hub: LiveHub) -> tuple[RecordingLink, dict[str, int]]:
    """Connect a client; return its link and the numbers of topics."""
    link = RecordingLink()
    hub.join(link)
    run_jobs(hub)
    hub.tick()
    return link, link.channels()


def subscribe(hub: LiveHub, link: RecordingLink, number: int, subscription: int = 5) -> None:
    tell(hub, link, op="subscribe", subscriptions=[{"id": subscription, "channelId": number}])


@pytest.fixture
def bus() -> FakeBus:
    bus = FakeBus()
    bus.models = GetModelsResponse(
        entities=(EntityModel("r1", "r1", 0, "pool"), EntityModel("wall", "", 0)), models=(MODEL,)
    )
    return bus


def make_odometry(sec: int) -> bytes:
    return encode(Odometry(Header(Time(sec), "odom")), Format.CDR)


def test_topic_that_cannot_be_subscribed_is_refused_and_the_robot_stops(
    bus: FakeBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    hub = make_hub(bus, has_control=True)
    link, channels = join(hub)
    channel = {"id": 1, "topic": "/r1/cmd_vel", "encoding": "cdr"}
    channel |= {"schemaName": "geometry_msgs/msg/Twist"}
    tell(hub, link, op="advertise", channels=[channel])

    def refuse(key: str, _depth: int = 1) -> None:
        raise ValueError(f"no key expression: {key}")

    monkeypatch.setattr(bus, "subscribe", refuse)
    subscribe(hub, link, channels["/r1/odom"])
    refused = link.take("status")
    hub.leave(link)

    assert len(refused) == 1
    assert bus.sent[-1][1] == b"closed"


def test_robot_stops_though_a_subscription_cannot_be_ended(
    bus: FakeBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    hub = make_hub(bus, has_control=True)
    link, channels = join(hub)
    channel = {"id": 1, "topic": "/r1/cmd_vel", "encoding": "cdr"}
    channel |= {"schemaName": "geometry_msgs/msg/Twist"}
    tell(hub, link, op="advertise", channels=[channel])
    subscribe(hub, link, channels["/r1/odom"])

    def fail(_: FakeSubscription) -> None:
        raise RuntimeError("the session is closed")

    monkeypatch.setattr(FakeSubscription, "close", fail)
    with pytest.raises(RuntimeError):
        hub.leave(link)

    assert bus.sent[-1][1] == b"closed"


def test_nothing_is_subscribed_without_clients_and_only_topics_that_are_wanted(
    bus: FakeBus,
) -> None:
    hub = make_hub(bus)
    before = bus.keys
    link, channels = join(hub)
    connected = bus.keys
    subscribe(hub, link, channels["/r1/odom"])
    wanted = bus.keys
    tell(hub, link, op="unsubscribe", subscriptionIds=[5])
    unwanted = bus.keys
    hub.leave(link)

    assert before == bus.keys == set()
    assert connected == unwanted == {EVENTS.key(WORLD)}
    assert wanted == {*ROOTS, "r1/odom"}


def test_each_client_gets_a_message_once_with_its_own_subscription(bus: FakeBus) -> None:
    hub = make_hub(bus)
    (one, channels), (other, _) = join(hub), join(hub)
    subscribe(hub, one, channels["/r1/odom"], 7)
    subscribe(hub, other, channels["/r1/odom"], 9)
    clock = WorldClock(Time(3))
    bus.publish(CLOCK.key(WORLD), encode(clock, Format.MSGPACK), "application/msgpack")
    bus.publish("r1/odom", make_odometry(3))
    hub.tick()
    hub.tick()

    assert one.data == [(7, 3_000_000_000, make_odometry(3))]
    assert other.data == [(9, 3_000_000_000, make_odometry(3))]
    assert one.times == other.times == [3_000_000_000]
    assert [key for key in bus.keys if key == "r1/odom"] == ["r1/odom"]


def test_message_in_another_format_becomes_cdr_and_a_malformed_one_is_left_out(
    bus: FakeBus,
) -> None:
    hub = make_hub(bus)
    link, channels = join(hub)
    subscribe(hub, link, channels["/r1/cmd_vel"])
    twist = Twist(Vector3(x=0.5))
    bus.publish("r1/cmd_vel", encode(twist, Format.JSON))
    bus.publish("r1/cmd_vel", b"{broken")
    hub.tick()

    assert [decode(Twist, payload) for _, _, payload in link.data] == [twist]


def test_robots_of_their_own_tf_are_joined_with_prefixed_frames(bus: FakeBus) -> None:
    hub = make_hub(bus)
    link, channels = join(hub)
    subscribe(hub, link, channels["/tf"], 1)
    subscribe(hub, link, channels["/tf_static"], 2)
    hub.tick()
    transform = TransformStamped(Header(Time(1), "odom"), "base")
    shared = TransformStamped(Header(Time(1), "r2/odom"), "r2/base")
    bus.publish("r1/tf", encode(TFMessage((transform,)), Format.CDR))
    bus.publish("tf", encode(TFMessage((shared,)), Format.CDR))
    hub.tick()

    found = {number: decode(TFMessage, payload).transforms for number, _, payload in link.data}
    assert {one.child_frame_id for one in found[1]} == {"r1/base", "r2/base"}
    assert [(one.header.frame_id, one.child_frame_id) for one in found[2]] == [("world", "r1/odom")]


def test_later_subscriber_gets_the_latched_message_at_once(bus: FakeBus) -> None:
    hub = make_hub(bus)
    text = encode(String("<robot/>"), Format.CDR)
    bus.publish("r1/robot_description", text)
    bus.stored = []
    (one, channels), (other, _) = join(hub), join(hub)
    subscribe(hub, one, channels["/r1/robot_description"], 1)
    bus.publish("r1/robot_description", text)
    hub.tick()
    bus.publish("r1/robot_description", text)
    hub.tick()
    subscribe(hub, other, channels["/r1/robot_description"], 2)
    hub.tick()

    assert [payload for _, _, payload in one.data] == [text]
    assert [(number, payload) for number, _, payload in other.data] == [(2, text)]


def test_scene_has_robots_in_their_frames_and_others_in_the_world(bus: FakeBus) -> None:
    hub = make_hub(bus)
    link, channels = join(hub)
    scene = make_scene_of(hub, link, channels)

    robot, wall = scene["r1/base"], scene["wall"]
    assert robot.frame_id == "r1/base"
    assert scene["r1/wheel"].models[0].url == "package://zensim/meshes/" + "ab" * 32 + ".stl"
    assert (robot.cubes[0].size, robot.cubes[0].color.r) == (Vector3(0.2, 0.2, 0.1), 1.0)
    assert wall.frame_id == "world"
    assert wall.models[0].pose.position.y == 0.1

    bus.models = GetModelsResponse(entities=bus.models.entities[1:], models=(MODEL,))
    event = encode(Event("deleted", "r1"), Format.MSGPACK)
    bus.publish(EVENTS.key(WORLD), event)
    link.data.clear()
    hub.tick()
    wait_for_models(hub)
    update = read_scene(link)
    assert {one.id for one in update.deletions} == {"r1/base", "r1/wheel"}
    assert update.entities == ()
    gone = {one["channelIds"][0] for one in link.take("unadvertise")}
    assert gone <= {channels[name] for name in channels if name.startswith("/r1/")}


def make_scene_of(hub: LiveHub, link: RecordingLink, channels: dict[str, int]) -> dict[str, Any]:
    subscribe(hub, link, channels["/zensim/scene"])
    hub.tick()
    return {one.id: one for one in read_scene(link).entities}


def read_scene(link: RecordingLink) -> SceneUpdate:
    return decode(SceneUpdate, link.data[-1][2])


def wait_for_models(hub: LiveHub) -> None:
    """Tick until the models that are due have been read."""
    while not (jobs := hub.take_jobs()):
        hub.tick()
    for job in jobs:
        if callable(outcome := job()):
            outcome()
    hub.tick()


@pytest.mark.parametrize(
    "message",
    [
        {"op": "advertise", "channels": []},
        {"op": "getParameters", "parameterNames": []},
        {"op": "setParameters", "parameters": []},
        {"op": "subscribeParameterUpdates", "parameterNames": []},
    ],
)
def test_control_is_off_by_default(bus: FakeBus, message: dict[str, Any]) -> None:
    hub = make_hub(bus)
    link, _ = join(hub)
    tell(hub, link, **message)

    assert link.take("serverInfo")[0]["capabilities"] == ["time", "assets"]
    assert link.take("status")[0]["level"] == 2
    assert bus.sent == []


def test_robot_stops_when_the_client_that_drives_it_is_gone(bus: FakeBus) -> None:
    hub = make_hub(bus, has_control=True)
    link, _ = join(hub)
    channel = {
        "id": 4,
        "topic": "/r1/cmd_vel",
        "encoding": "json",
        "schemaName": "geometry_msgs/Twist",
    }
    tell(hub, link, op="advertise", channels=[channel])
    hub.receive(link, b"\x01" + struct.pack("<I", 4) + b'{"linear":{"x":1}}')
    hub.leave(link)

    driven, stopped = (decode(Twist, payload) for _, payload in bus.sent[:2])
    assert driven.linear.x == 1.0
    assert stopped == Twist()
    assert bus.sent[2:] == [("r1/cmd_vel", b"closed")]


@pytest.mark.parametrize("size", [0, 125, 126, 65535, 65536])
def test_frame_has_the_length_of_its_message(size: int) -> None:
    frame = frame_message(b"a" * size)

    head = 2 if size < 126 else 4 if size < 65536 else 10
    assert len(frame) == head + size
    assert frame[0] == 0x82


MANY = 500
WRONG_CHANNEL = {"topic": "/map", "encoding": "cdr", "schemaName": "nav_msgs/msg/OccupancyGrid"}


@pytest.mark.parametrize(
    "message",
    [
        {"op": "unsubscribe", "subscriptionIds": [*range(MANY)]},
        {
            "op": "subscribe",
            "subscriptions": [{"id": one, "channelId": 10**6 + one} for one in range(MANY)],
        },
        {"op": "advertise", "channels": [{"id": one, **WRONG_CHANNEL} for one in range(MANY)]},
    ],
    ids=lambda one: str(one["op"]),
)
def test_all_that_is_wrong_in_a_message_has_one_reply(
    bus: FakeBus, message: dict[str, Any]
) -> None:
    hub = make_hub(bus, has_control=True)
    link, _ = join(hub)

    tell(hub, link, **message)

    assert len(link.take("status")) == 1


def test_many_wrong_messages_are_counted(bus: FakeBus) -> None:
    hub = make_hub(bus, has_control=True)
    link, _ = join(hub)

    for _ in range(MANY):
        hub.receive(link, b"\x01\0\0\0\0")
    hub.tick()
    hub.receive(link, b"\x01\0\0\0\0")
    statuses = link.take("status")

    assert len(statuses) == MAX_WARNINGS + 2
    assert str(MANY - MAX_WARNINGS) in statuses[MAX_WARNINGS]["message"]


def make_static(child: str) -> bytes:
    return encode(TFMessage((TransformStamped(Header(frame_id="r1/base"), child),)), Format.CDR)


def test_slow_client_gets_what_is_sent_once_when_it_has_caught_up(bus: FakeBus) -> None:
    hub = make_hub(bus)
    link, channels = join(hub)
    once = ("/zensim/scene", "/tf_static", "/r1/robot_description")
    for number, name in enumerate((*once, "/r1/odom"), 1):
        subscribe(hub, link, channels[name], number)
    link.has_backlog = True
    bus.publish("tf_static", make_static("r1/arm"))
    bus.publish("r1/robot_description", encode(String("<robot/>"), Format.CDR))
    bus.publish("r1/odom", make_odometry(1))
    for _ in range(3):
        hub.tick()
    left_out = [*link.data]
    link.has_backlog = False
    hub.tick()
    hub.tick()

    assert left_out == []
    found = {number: payload for number, _, payload in link.data}
    assert sorted(number for number, _, _ in link.data) == [1, 2, 3]
    assert {one.id for one in decode(SceneUpdate, found[1]).entities} >= {"r1/base", "wall"}
    children = [one.child_frame_id for one in decode(TFMessage, found[2]).transforms]
    assert "r1/arm" in children
    assert decode(String, found[3]).data == "<robot/>"


def test_topic_that_is_subscribed_again_and_again_is_queried_once(bus: FakeBus) -> None:
    hub = make_hub(bus)
    link, channels = join(hub)
    queries: list[str] = []

    def get(key: str, _timeout_s: float = 0.0) -> list[Sample]:
        queries.append(key)
        return []

    bus.get = get  # type: ignore[method-assign]
    wanted = {"id": 5, "channelId": channels["/r1/robot_description"]}

    jobs: list[Job] = []
    for _ in range(MANY):
        jobs += hub.receive(link, json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
        jobs += hub.receive(link, json.dumps({"op": "unsubscribe", "subscriptionIds": [5]}))
    jobs += hub.receive(link, json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
    run_jobs(hub, *jobs)

    assert queries == ["r1/robot_description"]


def at_x(x: float) -> EntityState:
    return EntityState(pose=Pose(Point(x=x)))


def test_robot_whose_agent_ends_stays_where_it_is(bus: FakeBus) -> None:
    hub = make_hub(bus)
    link, channels = join(hub)
    make_scene_of(hub, link, channels)
    robot = EntityModel("r1", "r1", 0)
    bus.models = GetModelsResponse(entities=(robot, bus.models.entities[1]), models=(MODEL,))
    bus.states = {"r1": at_x(7.0), "wall": at_x(3.0)}
    bus.publish(EVENTS.key(WORLD), encode(Event("released", "r1"), Format.MSGPACK))
    hub.tick()
    wait_for_models(hub)

    update = read_scene(link)
    (drawn,) = [one for one in update.entities if one.id == "r1"]
    assert drawn.frame_id == "world"
    assert drawn.cubes[0].pose.position.x == 7.0


def test_robot_that_still_moves_without_an_agent_is_followed(bus: FakeBus) -> None:
    bus.models = GetModelsResponse(entities=(EntityModel("r1", "r1", 0),), models=(MODEL,))
    bus.states = {"r1": EntityState(twist=Twist(Vector3(x=1.0)))}
    hub = make_hub(bus)
    link, channels = join(hub)
    make_scene_of(hub, link, channels)
    bus.states = {"r1": at_x(2.0)}
    wait_for_models(hub)

    assert read_scene(link).entities[0].cubes[0].pose.position.x == 2.0
