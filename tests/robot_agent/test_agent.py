"""An agent with a server and users, in memory."""

import gc
import os
import signal
import struct
from collections.abc import Iterator
from contextlib import suppress

import pytest
from msgspec.structs import replace

from tests.fakes import ManualClock, MemoryBus
from tests.robot_agent.fake_server import AGENT, WORLD, FakeServer
from tests.robot_agent.models import DRIVE, a_claim, a_state, two_wheeler
from tests.robot_agent.test_bumpers import a_touchy_robot
from tests.robot_agent.test_claim_client import FakeShareServer
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, decode
from zensim.proto.messages.agent_messages import FleetOdometry
from zensim.proto.messages.drive_messages import DiffDrive
from zensim.proto.messages.process_messages import AgentStats
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.standard_messages import Odometry, Twist, Vector3
from zensim.proto.poll_schedule import MIN_PERIOD_S
from zensim.proto.stop_signal import STOP_SIGNALS, StopFlag
from zensim.proto.topic_catalog import AGENT_STATS, CONTACTS, DRIVE_STATE, FLEET_ODOMETRY
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.agent import HOUSEKEEPING_PERIOD_S, Agent, Housekeeping, run_agent
from zensim.robot_agent.agent_config import AgentConfig
from zensim.robot_agent.collected_objects import FREEZE_AFTER_S
from zensim.robot_agent.robots import DrivenRobot, IndividualRobots


def make_robots(bus: MemoryBus) -> IndividualRobots:
    robots = IndividualRobots(bus, 0)
    robots.hold(1, DrivenRobot(TopicFactory(bus), a_claim(1, "r1"), 0))
    robots.hold(2, DrivenRobot(TopicFactory(bus), a_claim(2, "r2", two_wheeler(None)), 0))
    return robots


def test_housekeeping_answers_questions() -> None:
    bus = MemoryBus()
    housekeeping = Housekeeping(make_robots(bus))
    times = iter(range(1000))
    bus.pumps.append(lambda: housekeeping.poll(next(times) / 100))

    assert {sample.key for sample in bus.get("*/robot_description")} == {
        "r1/robot_description",
        "r2/robot_description",
    }


def test_housekeeping_announces_to_new_subscribers() -> None:
    bus = MemoryBus()
    housekeeping = Housekeeping(make_robots(bus))
    housekeeping.poll(0.0)
    listener = bus.subscribe("r1/tf_static", 8)

    housekeeping.poll(0.1)
    assert listener.take() == []

    housekeeping.poll(0.25)
    assert len(listener.take()) == 1


def test_housekeeping_logs_at_most_once_a_second(caplog: pytest.LogCaptureFixture) -> None:
    bus = MemoryBus()
    robots = make_robots(bus)
    housekeeping = Housekeeping(robots)
    for i in range(200):
        bus.put("r1/cmd_vel", b"garbage")
        robots.advance(a_state(i, (1,)))
        housekeeping.poll(10.0 + i / 100)

    assert [record.split(" reason")[0] for record in caplog.messages] == [
        "cmd_vel entity=r1 malformed=1",
        "cmd_vel entity=r1 malformed=101",
    ]


FORWARD = Twist(Vector3(0.5))
BACK = Twist(Vector3(-0.5))


class Scene:
    """A server with entities, and an agent that wants some of them."""

    def __init__(self, *entities: str, drive: DiffDrive | None = DRIVE) -> None:
        self.bus = MemoryBus()
        self.server = FakeServer(self.bus, *entities)
        self.server.entities = {name: two_wheeler(drive) for name in entities}
        self.server.come_up()
        self.now_s = 100.0
        self.agent = Agent(self.bus, AgentConfig(agent=AGENT, entities=entities))

    def poll(self) -> bool:
        self.now_s += 0.02
        return self.agent.poll(self.now_s)

    def drive_to(self, step: int, *claims: int, epoch: int = 0) -> list[tuple[float, ...]]:
        """Send a state, and return the targets of the commands."""
        self.server.commands()
        self.server.send(a_state(step, claims or (1,), epoch=epoch))
        assert self.poll()
        return [
            struct.unpack(f"<{len(command.targets) // 8}d", command.targets)
            for command in self.server.commands()
        ]


@pytest.mark.usefixtures("unfrozen")
@pytest.mark.parametrize(
    ("kept", "is_frozen"), [((1, 2), False), ((1, 2, 3, 4), True)], ids=["most gone", "one gone"]
)
def test_pool_unfreezes_when_as_many_robots_go_at_once_as_are_left(
    kept: tuple[int, ...], *, is_frozen: bool
) -> None:
    bus = MemoryBus()
    bus.token(keys.alive_server(WORLD))
    FakeShareServer(bus).grants = [tuple(a_claim(one, f"r{one}") for one in range(1, 6))]
    agent = Agent(bus, AgentConfig(agent=AGENT, pool_limit=0))
    states = bus.opened_sessions[0]

    def drive(step: int, claims: tuple[int, ...], now_s: float) -> bool:
        key = DRIVE_STATE.key(WORLD, AGENT)
        states.put_message(key, a_state(step, claims), Format.MSGPACK)
        assert agent.poll(now_s)
        return gc.get_freeze_count() > 0

    assert gc.get_freeze_count() == 0
    assert drive(1, (1, 2, 3, 4, 5), 100.0)
    assert drive(2, (1, 2, 3, 4, 5), 100.0 + FREEZE_AFTER_S)

    assert drive(3, kept, 100.1 + FREEZE_AFTER_S) == is_frozen
    agent.close()


@pytest.fixture
def unfrozen() -> Iterator[None]:
    """Begin and end without objects that collections pass over."""
    gc.unfreeze()
    yield
    gc.unfreeze()


def test_agent_has_its_token_up_before_it_claims() -> None:
    scene = Scene("r1")

    assert scene.bus.list_tokens(keys.alive_agents(WORLD)) == [keys.alive_agent(WORLD, AGENT)]
    assert scene.server.requests == []


def test_agent_claims_its_entities_at_its_first_poll() -> None:
    scene = Scene("r1", "r2")

    scene.poll()

    assert scene.server.drivers == {"r1": AGENT, "r2": AGENT}
    assert scene.bus.has_subscriber("r1/cmd_vel")
    assert scene.bus.is_served("r2/odom")


def test_agent_answers_a_state_with_targets_of_the_newest_twist() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.bus.put_message("r1/cmd_vel", FORWARD)

    assert scene.drive_to(1) == [pytest.approx((5.0, 5.0))]

    scene.bus.put_message("r1/cmd_vel", BACK, Format.MSGPACK)
    assert scene.drive_to(2) == [pytest.approx((-5.0, -5.0))]


def test_agent_says_which_state_it_answers() -> None:
    scene = Scene("r1")
    scene.poll()
    state = a_state(7, (1,), epoch=2)
    scene.server.send(state)

    scene.poll()

    (command,) = scene.server.commands()
    assert (command.epoch, command.step, command.claims) == (2, 7, state.claims)


def test_agent_publishes_odometry_of_a_state() -> None:
    scene = Scene("r1")
    scene.poll()
    listener = scene.bus.subscribe("r1/odom")

    scene.drive_to(3)

    (sample,) = listener.take()
    assert decode(Odometry, sample.payload, sample.encoding).header.stamp.nanosec == 30_000_000


def test_agent_answers_a_get_with_the_last_odometry() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.drive_to(3)
    scene.bus.pumps.append(scene.poll)

    assert [sample.key for sample in scene.bus.get("r1/odom")] == ["r1/odom"]


def test_agent_says_that_it_is_idle_when_no_state_has_come() -> None:
    scene = Scene("r1")

    assert not scene.poll()


def test_agent_stops_the_robot_when_commands_time_out() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.bus.put_message("r1/cmd_vel", FORWARD)
    scene.drive_to(1)

    assert scene.drive_to(51) == [pytest.approx((5.0, 5.0))]
    assert scene.drive_to(52) == [(0.0, 0.0)]


def test_agent_ignores_a_state_that_is_late() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.drive_to(10)

    assert scene.drive_to(9) == []


def test_agent_resets_its_robots_with_the_world() -> None:
    scene = Scene("r1", drive=replace(DRIVE, max_acceleration=1.0))
    scene.poll()
    for step in range(10):
        scene.bus.put_message("r1/cmd_vel", FORWARD)
        scene.drive_to(step)

    assert scene.drive_to(0, epoch=1) == [(0.0, 0.0)]
    scene.bus.put_message("r1/cmd_vel", FORWARD)
    assert scene.drive_to(1, epoch=1) == [pytest.approx((0.1, 0.1))]


def test_agent_claims_again_when_an_entity_comes_back(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    scene = Scene("r1")
    scene.poll()
    scene.drive_to(1)
    kept = scene.server.entities.pop("r1")
    scene.server.drivers.clear()

    scene.server.send(a_state(2, (), base=(), positions=(), velocities=()))
    scene.poll()
    assert not scene.bus.is_served("r1/odom")
    scene.poll()

    scene.server.entities["r1"] = kept
    scene.server.publish_event("spawned", "r1")
    scene.poll()
    assert scene.drive_to(3, 2) == [(0.0, 0.0)]
    assert [record.split(" ")[0] for record in caplog.messages] == [
        "claimed",
        "lost",
        "waiting",
        "claimed",
    ]


def test_agent_drives_the_others_when_one_entity_is_gone() -> None:
    scene = Scene("r1", "r2")
    scene.poll()
    scene.drive_to(1, 1, 2)
    del scene.server.entities["r1"]
    scene.bus.put_message("r2/cmd_vel", FORWARD)

    assert scene.drive_to(2, 2) == [pytest.approx((5.0, 5.0))]
    assert not scene.bus.is_served("r1/odom")


def test_agent_ignores_states_of_claims_that_it_does_not_hold() -> None:
    scene = Scene("r1")
    scene.poll()

    assert scene.drive_to(1, 7) == []
    assert scene.bus.is_served("r1/odom")


def test_agent_ignores_a_state_from_before_its_claim() -> None:
    scene = Scene("r1")
    state = a_state(5, (), base=(), positions=(), velocities=())
    scene.server.send(replace(state, newest_claim=0))

    scene.poll()

    assert scene.bus.is_served("r1/odom")


def test_agent_answers_a_state_that_follows_its_claim() -> None:
    scene = Scene("r1")
    scene.server.commands()
    scene.server.send(replace(a_state(5, (1,)), newest_claim=1))

    scene.poll()

    assert [command.step for command in scene.server.commands()] == [5]


@pytest.mark.parametrize("is_awaited", [True, False])
def test_agent_answers_a_state_that_came_before_its_claim(
    is_awaited: bool,  # noqa: FBT001  a parameter of the test
) -> None:
    scene = Scene("r1")
    kept = scene.server.entities.pop("r1")
    scene.server.send(replace(a_state(5, (1,)), newest_claim=1, is_awaited=is_awaited))
    scene.poll()
    early = scene.server.commands()

    scene.server.entities["r1"] = kept
    scene.server.publish_event("spawned", "r1")
    scene.poll()
    scene.poll()

    assert early == []
    assert [command.step for command in scene.server.commands()] == [5]


def test_agent_gives_the_same_answer_to_a_state_that_is_published_again() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.server.send(a_state(3))
    scene.poll()
    (first,) = scene.server.commands()
    scene.bus.put_message("r1/cmd_vel", FORWARD)

    scene.server.send(replace(a_state(3), is_awaited=True))
    scene.poll()

    assert scene.server.commands() == [first]


@pytest.mark.parametrize(("is_awaited", "order"), [(True, "oc"), (False, "co")])
def test_agent_publishes_before_its_command_when_that_is_awaited(
    is_awaited: bool,  # noqa: FBT001  a parameter of the test
    order: str,
) -> None:
    scene = Scene("r1")
    scene.poll()
    listener = scene.bus.subscribe("**", 64)
    scene.server.send(replace(a_state(3), is_awaited=is_awaited))

    scene.poll()

    chunks = [sample.key.rsplit("/", 1)[-1] for sample in listener.take()]
    assert "".join(c[0] for c in chunks if c in ("odom", "command")) == order


def test_agent_polls_fast_only_after_an_awaited_state() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.server.send(a_state(3))
    scene.poll()
    usual_s = scene.agent.pause_s(scene.now_s)
    scene.server.send(replace(a_state(6), is_awaited=True))
    scene.poll()

    assert scene.agent.pause_s(scene.now_s) < usual_s
    assert scene.agent.pause_s(scene.now_s + 1.0) >= usual_s


def test_agent_claims_again_when_the_server_was_restarted() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.drive_to(100)

    scene.server.go_down()
    scene.server.entities.clear()
    scene.poll()
    assert not scene.bus.is_served("r1/odom")

    scene.server.entities["r1"] = two_wheeler()
    scene.server.come_up()
    scene.poll()
    assert scene.drive_to(0, 2) == [(0.0, 0.0)]


def test_agent_counts_malformed_contacts_and_drives_on() -> None:
    scene = Scene("r1")
    scene.server.entities["r1"] = a_touchy_robot()
    bumper = scene.bus.subscribe("r1/hull/bumper_states")
    for _ in range(100):
        scene.poll()
    before = scene.drive_to(0)

    scene.bus.put(CONTACTS.key(WORLD), b"garbage")

    assert scene.drive_to(1) == before == [(0.0, 0.0)]
    assert scene.agent.malformed == 1
    bumper.close()


def test_agent_ignores_a_malformed_state(caplog: pytest.LogCaptureFixture) -> None:
    scene = Scene("r1")
    scene.poll()

    for _ in range(3):
        scene.bus.put(DRIVE_STATE.key(WORLD, AGENT), b"garbage")
        assert scene.poll()

    assert scene.agent.malformed == 3
    assert len(caplog.messages) == 1
    assert scene.drive_to(1) == [(0.0, 0.0)]


def test_run_agent_drives_until_an_error_is_raised() -> None:
    bus, clock = MemoryBus(), ManualClock()
    FakeServer(bus)
    config = AgentConfig(agent=AGENT, entities=("r1",), wait_s=2.0)

    with pytest.raises(ServiceError) as refusal:
        run_agent(bus, config, lambda: False, clock=clock, sleep=clock.sleep)

    assert refusal.value.code == ResultCode.NOT_FOUND

    assert clock.now_s == pytest.approx(2.5, abs=1.0)


class ManualArrivals:
    """Arrivals of a network that signals them; a pause lasts as long as it may."""

    def __init__(self, clock: ManualClock) -> None:
        self.has_requests = False
        self.pauses_s: list[float] = []
        self._clock = clock

    def take_requests(self) -> bool:
        found, self.has_requests = self.has_requests, False
        return found

    def wait(self, timeout_s: float) -> None:
        self.pauses_s.append(timeout_s)
        self._clock.sleep(timeout_s)


def test_agent_pauses_until_something_arrives_where_that_is_signalled() -> None:
    clock = ManualClock()
    bus, arrivals = MemoryBus(), ManualArrivals(clock)
    bus.arrivals = arrivals
    FakeServer(bus, "r1")
    turns = iter(range(100))
    config = AgentConfig(agent=AGENT, entities=("r1",))

    run_agent(bus, config, lambda: next(turns) == 99, clock=clock, sleep=clock.sleep)

    assert len(arrivals.pauses_s) == 99
    assert arrivals.pauses_s == pytest.approx([HOUSEKEEPING_PERIOD_S] * 99)


def test_agent_that_was_woken_soon_after_a_state_waits_before_it_looks() -> None:
    clock, bus = ManualClock(), MemoryBus()
    server = FakeServer(bus, "r1")
    pauses_s: list[float] = []
    turns = iter(range(20))

    class FrequentStates(ManualArrivals):
        """States come four times as often as they may be answered."""

        def wait(self, timeout_s: float) -> None:
            super().wait(min(timeout_s, MIN_PERIOD_S / 4))
            server.send(a_state(len(pauses_s)))

    bus.arrivals = FrequentStates(clock)

    def sleep(seconds: float) -> None:
        pauses_s.append(seconds)
        clock.sleep(seconds)

    config = AgentConfig(agent=AGENT, entities=("r1",))
    run_agent(bus, config, lambda: next(turns) == 19, clock=clock, sleep=sleep)

    assert pauses_s[-5:] == pytest.approx([MIN_PERIOD_S * 3 / 4] * 5)


def test_agent_replies_to_a_signalled_request_at_once() -> None:
    bus, arrivals = MemoryBus(), ManualArrivals(ManualClock())
    bus.arrivals = arrivals
    server = FakeServer(bus, "r1")
    agent = Agent(bus, AgentConfig(agent=AGENT, entities=("r1",)))
    agent.poll(0.0)
    server.send(a_state(0))
    agent.poll(0.05)
    agent.poll(0.1)
    replies: list[int] = []

    def get_when(now_s: float, *, is_signalled: bool) -> None:
        def poll() -> None:
            arrivals.has_requests = is_signalled
            agent.poll(now_s)

        bus.pumps.append(poll)
        replies.append(len(bus.get("r1/odom")))
        bus.pumps.remove(poll)

    get_when(0.101, is_signalled=False)
    get_when(0.102, is_signalled=True)

    assert replies == [0, 1]


@pytest.fixture
def _handlers() -> Iterator[None]:
    kept = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("_handlers")
def test_agent_process_ends_on_a_signal_whose_interrupt_was_lost() -> None:
    bus, clock = MemoryBus(), ManualClock()
    FakeServer(bus, "r1")
    stop = StopFlag(is_armed=False)

    def sleep(seconds: float) -> None:
        clock.sleep(seconds)
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)

    run_agent(bus, AgentConfig(agent=AGENT, entities=("r1",)), stop, clock=clock, sleep=sleep)

    assert stop()


def revised(scene: Scene) -> list[tuple[float, ...]]:
    """Poll between two states; return the targets of the commands."""
    scene.server.commands()
    scene.now_s += 0.004
    assert not scene.agent.poll(scene.now_s)
    return [
        struct.unpack(f"<{len(command.targets) // 8}d", command.targets)
        for command in scene.server.commands()
    ]


def test_agent_revises_its_answer_when_a_command_comes_between_two_states() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.drive_to(3)
    scene.drive_to(6)
    scene.bus.put_message("r1/cmd_vel", FORWARD)

    assert revised(scene) == [pytest.approx((5.0, 5.0))]
    assert scene.drive_to(9) == [pytest.approx((5.0, 5.0))]


def test_agent_revises_an_answer_only_once() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.drive_to(3)
    scene.drive_to(6)
    scene.bus.put_message("r1/cmd_vel", FORWARD)
    revised(scene)
    scene.bus.put_message("r1/cmd_vel", BACK)

    assert revised(scene) == []
    assert scene.drive_to(9) == [pytest.approx((-5.0, -5.0))]


def test_agent_revises_nothing_when_a_command_is_repeated() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.bus.put_message("r1/cmd_vel", FORWARD)
    scene.drive_to(3)
    scene.drive_to(6)
    scene.bus.put_message("r1/cmd_vel", FORWARD)

    assert revised(scene) == []


def test_agent_applies_a_command_at_the_next_state_when_answers_are_awaited() -> None:
    scene = Scene("r1")
    scene.poll()
    for step in (3, 6):
        scene.server.send(replace(a_state(step), is_awaited=True))
        scene.poll()
    scene.bus.put_message("r1/cmd_vel", FORWARD)

    assert revised(scene) == []
    assert scene.drive_to(9) == [pytest.approx((5.0, 5.0))]


def test_agent_reports_its_robots_and_what_it_uses() -> None:
    scene = Scene("r1", "r2")
    scene.poll()
    scene.drive_to(1, 1, 2)
    reports = scene.bus.subscribe(AGENT_STATS.key(WORLD, AGENT), 8)

    for _ in range(60):
        scene.poll()
    (sample,) = reports.take()[:1]
    stats = decode(AgentStats, sample.payload, sample.encoding)

    assert (stats.agent, stats.robots, stats.states) == (AGENT, 2, 1)
    assert stats.usage.process_id == os.getpid()
    assert stats.usage.cpu_s > 0.0


def test_agent_publishes_the_odometry_of_all_its_robots_to_subscribers_only() -> None:
    scene = Scene("r1", "r2")
    scene.poll()
    scene.drive_to(1, 1, 2)
    subscription = scene.bus.subscribe(FLEET_ODOMETRY.key(WORLD, "*"), 8)

    scene.drive_to(20, 1, 2)
    (sample,) = subscription.take()
    message = decode(FleetOdometry, sample.payload, sample.encoding)

    assert sample.key == FLEET_ODOMETRY.key(WORLD, AGENT)
    assert (message.entities, message.step) == (("r1", "r2"), 20)
    assert len(message.motions) == 2 * 13 * 8


def test_agent_has_no_robots_when_the_server_is_gone() -> None:
    scene = Scene("r1")
    scene.poll()
    scene.drive_to(1)

    scene.server.go_down()
    scene.poll()

    assert scene.agent.make_stats().robots == 0
