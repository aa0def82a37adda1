"""Contact sensors of robots: messages of Gazebo's bumper."""

import struct
from collections.abc import Sequence

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import DRIVE, two_wheeler
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.memory_bus import MemorySubscription
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.gazebo_messages import ContactsState
from zensim.proto.messages.model_messages import Model, Sensor
from zensim.proto.messages.sensing_messages import Contacts, Environment
from zensim.proto.messages.sensor_messages import ContactSensor, SensorTopic
from zensim.proto.messages.standard_messages import Header, Time, Vector3, time_from_ns
from zensim.robot_agent.bumpers import make_bumpers, read_contact_report
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.robot_agent.robots import IndividualRobots

STEP_NS = 10_000_000
ENVIRONMENT = Environment(step_ns=STEP_NS, control_steps=1)
WALL = "wall::link::collision"
LINKS = tuple(link.name for link in two_wheeler(DRIVE).links)
Row = tuple[int, int, int, int]
POINT = (1.0, 2.0, 0.5, -1.0, 0.0, 0.0, 0.001, -3.0, 0.5, 0.0)


def a_touchy_robot(rate_hz: float = 0.0, *, has_drive: bool = True) -> Model:
    def bumper(name: str, link: int, rate_hz: float) -> Sensor:
        return Sensor(
            *(name, "contact", "base_link", "base_link"),
            update_rate_hz=rate_hz,
            settings=ContactSensor(
                ((link, 0), (link, 1)), (f"{LINKS[link]}::{name}_0", f"{LINKS[link]}::{name}_1")
            ),
            topics=(SensorTopic("bumper_states", f"{name}/bumper_states"),),
            frame_id="world",
        )

    sensors = (bumper("hull", 0, rate_hz), bumper("wheel", 1, 0.0))
    return msgspec.structs.replace(two_wheeler(DRIVE if has_drive else None), sensors=sensors)


def contacts(
    step: int,
    bodies: Sequence[Row] = (),
    points: Sequence[tuple[float, ...]] = (),
    entities: tuple[str, ...] = ("r1", "r2"),
) -> Contacts:
    return Contacts(
        *(0, step, step * STEP_NS, entities, (WALL, "box::link::collision")),
        b"".join(struct.pack("<4I", *row) for row in bodies),
        b"".join(struct.pack("<10d", *row) for row in points),
    )


class Robots:
    """Robots r1 and r2 with bumpers, in a pool or one by one."""

    def __init__(self, kind: str, rate_hz: float = 0.0) -> None:
        self.bus = MemoryBus()
        self.robots = PooledRobots(self.bus, 0) if kind == "pool" else IndividualRobots(self.bus, 0)
        model = a_touchy_robot(rate_hz)
        self.robots.add_claims(
            [
                Claim(number, f"r{number}", f"ns{number}", model, environment=ENVIRONMENT)
                for number in (1, 2)
            ]
        )

    def listen(self, key: str) -> MemorySubscription:
        subscription = self.bus.subscribe(key, 1000)
        for _ in range(5):
            self.robots.reply_to_queries()
        return subscription

    def tell(self, *told: Contacts) -> None:
        for one in told:
            self.robots.publish_contacts(read_contact_report(one))


@pytest.fixture(params=["alone", "pool"])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def received(subscription: MemorySubscription) -> list[ContactsState]:
    return [decode(ContactsState, one.payload, one.encoding) for one in subscription.take()]


def test_bumper_tells_each_pair_of_collisions_with_its_points(kind: str) -> None:
    robots = Robots(kind)
    listener = robots.listen("ns1/hull/bumper_states")
    other = (4.0, 5.0, 6.0, 0.0, 0.0, 1.0, 0.002, 0.0, 0.0, 9.0)

    robots.tell(contacts(7, [(0, 0, 1, 0), (0, 0, 1, 0), (0, 0, 0, 1)], [POINT, other, other]))

    (message,) = received(listener)
    wall, box = message.states
    assert (message.header.frame_id, message.header.stamp) == ("world", Time(0, 70_000_000))
    assert (wall.collision1_name, wall.collision2_name) == ("r1::base_link::hull_1", WALL)
    assert (box.collision1_name, box.collision2_name) == (
        "r1::base_link::hull_0",
        "box::link::collision",
    )
    assert [wrench.force for wrench in wall.wrenches] == [
        Vector3(-3.0, 0.5, 0.0),
        Vector3(0.0, 0.0, 9.0),
    ]
    assert wall.total_wrench.force == Vector3(-3.0, 0.5, 9.0)
    assert wall.contact_positions[0] == Vector3(1.0, 2.0, 0.5)
    assert wall.contact_normals[0] == Vector3(-1.0, 0.0, 0.0)
    assert wall.depths == (0.001, 0.002)


def test_bumper_tells_nothing_of_other_links_and_robots(kind: str) -> None:
    robots = Robots(kind)
    listener = robots.listen("ns1/hull/bumper_states")
    wheel = robots.listen("ns2/wheel/bumper_states")

    robots.tell(contacts(7, [(0, 1, 0, 0), (1, 1, 0, 0), (1, 0, 0, 0)], [POINT] * 3))

    assert [message.states for message in received(listener)] == [()]
    (message,) = received(wheel)
    assert [state.collision1_name for state in message.states] == ["r2::left_wheel::wheel_0"]


def test_bumper_is_empty_before_and_after_a_touch(kind: str) -> None:
    robots = Robots(kind)
    listener = robots.listen("ns1/hull/bumper_states")

    robots.tell(contacts(1), contacts(2, [(0, 0, 0, 0)], [POINT]), contacts(3))

    assert [len(message.states) for message in received(listener)] == [0, 1, 0]


def test_bumper_publishes_at_its_rate(kind: str) -> None:
    robots = Robots(kind, rate_hz=10.0)
    listener = robots.listen("ns1/hull/bumper_states")

    robots.tell(*(contacts(step) for step in range(1, 101)))

    stamps = [message.header.stamp for message in received(listener)]
    assert len(stamps) == 10
    assert stamps[:2] == [Time(0, 100_000_000), Time(0, 200_000_000)]


def test_bumper_starts_again_when_time_goes_back(kind: str) -> None:
    robots = Robots(kind, rate_hz=10.0)
    listener = robots.listen("ns1/hull/bumper_states")
    robots.tell(contacts(500))

    robots.robots.reset()
    robots.tell(contacts(0), contacts(1), contacts(10))

    assert [message.header.stamp.nanosec for message in received(listener)] == [0, 0, 100_000_000]


def test_contacts_are_wanted_only_while_a_bumper_has_a_subscriber(kind: str) -> None:
    robots = Robots(kind)
    wanted = [robots.robots.wants_contacts]

    listener = robots.listen("ns2/wheel/bumper_states")
    wanted.append(robots.robots.wants_contacts)
    listener.close()
    wanted.append(robots.robots.wants_contacts)

    assert wanted == [False, True, False]


def test_contacts_of_released_robots_are_ignored(kind: str) -> None:
    robots = Robots(kind)
    listener = robots.listen("ns1/hull/bumper_states")

    robots.robots.release_all_except(struct.pack("<I", 2))
    robots.tell(contacts(1))

    assert received(listener) == []


@pytest.mark.parametrize(
    "told",
    [
        contacts(1, [(0, 0, 0, 0)], []),
        contacts(1, [(9, 0, 0, 0)], [POINT]),
        contacts(1, [(0, 0, 0, 9)], [POINT]),
        Contacts(0, 1, 1, (), (), b"abc", b""),
    ],
)
def test_contacts_that_do_not_fit_together_are_malformed(told: Contacts) -> None:
    with pytest.raises(MalformedPayload):
        read_contact_report(told)


@pytest.mark.parametrize("step", [1, 123_456_789])
def test_bumper_that_touches_nothing_has_the_bytes_of_an_empty_message(step: int) -> None:
    claim = Claim(1, "r1", "r1", a_touchy_robot(), "<robot/>", environment=ENVIRONMENT)
    bumper = make_bumpers(claim)[0]
    time = time_from_ns(step * STEP_NS)

    assert bumper.take(read_contact_report(contacts(step))) == encode(
        ContactsState(Header(time, "world")), Format.CDR
    )
