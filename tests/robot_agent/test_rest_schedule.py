"""How long an agent needs no state."""

import math
import struct
from itertools import pairwise

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.fake_server import AGENT, WORLD, FakeServer
from tests.robot_agent.models import DRIVE, PAIR, a_claim, a_state, two_wheeler
from tests.robot_agent.test_claim_client import FakeShareServer
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, decode
from zensim.proto.messages.agent_messages import DriveCommand, DriveState
from zensim.proto.messages.drive_messages import Limits
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.topic_catalog import DRIVE_COMMAND, DRIVE_STATE
from zensim.robot_agent.agent import Agent
from zensim.robot_agent.agent_config import AgentConfig
from zensim.robot_agent.rest_schedule import LONGEST_REST_NS, QUIET_NS, RestSchedule

MS = 1_000_000
ACCELERATION = 1.0
"""[m/s^2], forward."""
QUIET_STEPS = QUIET_NS // (10 * MS) + 1
"""Number of the first state of `a_state` after which an agent rests."""


def rest_after(schedule: RestSchedule, *states: DriveState, targets: bytes = b"1") -> list[int]:
    return [schedule.find_rest_ns(one, targets, lambda: True) for one in states]


def list_speeds(command: DriveCommand) -> list[float]:
    return list(struct.unpack("<2d", command.targets))


def quiet_states(first: int = 1) -> list[DriveState]:
    return [a_state(step) for step in range(first, first + QUIET_STEPS)]


def test_agent_rests_when_its_answer_has_not_changed_for_long() -> None:
    schedule = RestSchedule()

    *before, rest_ns = rest_after(schedule, *quiet_states())

    assert not any(before)
    assert rest_ns == 20 * MS
    assert schedule.longest_update_s == pytest.approx(0.01)


def test_rest_grows_with_the_time_between_states() -> None:
    schedule = RestSchedule()
    rest_after(schedule, *quiet_states())

    steps = (QUIET_STEPS + 2, QUIET_STEPS + 6, QUIET_STEPS + 14)
    rests = rest_after(schedule, *map(a_state, steps))

    assert rests == [40 * MS, 80 * MS, LONGEST_REST_NS]
    assert schedule.longest_update_s == pytest.approx(0.01)


@pytest.mark.parametrize(
    "changed",
    [{"epoch": 1}, {"order": 1}, {"is_awaited": True}],
    ids=["reset", "ordered twist", "lockstep"],
)
def test_rest_ends_when_a_state_differs(changed: dict[str, int]) -> None:
    schedule = RestSchedule()
    rest_after(schedule, *quiet_states())

    state = msgspec.structs.replace(a_state(QUIET_STEPS + 1), **changed)

    assert rest_after(schedule, state) == [0]
    assert not schedule.is_resting
    assert schedule.longest_update_s == math.inf


def test_rest_ends_when_targets_change_or_a_command_comes() -> None:
    schedule = RestSchedule()
    rest_after(schedule, *quiet_states())
    assert rest_after(schedule, a_state(QUIET_STEPS + 1), targets=b"2") == [0]

    rest_after(schedule, *quiet_states(QUIET_STEPS + 2))
    schedule.wake()

    assert rest_after(schedule, a_state(3 * QUIET_STEPS)) == [0]


def test_agent_does_not_rest_with_anything_to_do() -> None:
    schedule = RestSchedule()

    rests = [schedule.find_rest_ns(one, b"1", lambda: False) for one in quiet_states()]

    assert not any(rests)
    assert not schedule.is_resting


class Quiet:
    """An agent of one robot, by name or as a pool, that has had nothing to do for long."""

    def __init__(self, *, is_pool: bool) -> None:
        self.bus, self.now_s = MemoryBus(), 100.0
        limits = Limits(max_acceleration=ACCELERATION)
        drive = msgspec.structs.replace(DRIVE, linear_limits=limits, odometry_source="world")
        model = two_wheeler(drive)
        if is_pool:
            self.bus.token(keys.alive_server(WORLD))
            FakeShareServer(self.bus).grants = [(a_claim(1, "r1", model),)]
            self.agent = Agent(self.bus, AgentConfig(agent=AGENT, pool_limit=0))
            self.states = self.bus.opened_sessions[0]
        else:
            server = FakeServer(self.bus, "r1")
            server.entities["r1"] = model
            server.come_up()
            self.agent = Agent(self.bus, AgentConfig(agent=AGENT, entities=("r1",)))
            self.states = self.bus
        self.sent = self.bus.subscribe(DRIVE_COMMAND.key(WORLD, AGENT), 8)
        self.poll()
        for step in range(1, QUIET_STEPS + 2):
            (self.last,) = self.answer(step)

    def poll(self) -> list[DriveCommand]:
        self.now_s += 0.01
        self.agent.poll(self.now_s)
        taken = self.sent.take()
        return [decode(DriveCommand, one.payload, one.encoding) for one in taken]

    def answer(self, step: int) -> list[DriveCommand]:
        key = DRIVE_STATE.key(WORLD, AGENT)
        self.states.put_message(key, a_state(step), Format.MSGPACK)
        return self.poll()

    def command(self, twist: Twist) -> None:
        for session in {id(self.bus): self.bus, id(self.states): self.states}.values():
            session.put_message("r1/cmd_vel", twist)


@pytest.fixture(params=[False, True], ids=["named", "pool"])
def quiet(request: pytest.FixtureRequest) -> Quiet:
    return Quiet(is_pool=request.param)


def test_agent_without_subscribers_asks_for_fewer_states(quiet: Quiet) -> None:
    assert quiet.last.rest_ns > 0


def test_resting_agent_answers_a_command_at_once(quiet: Quiet) -> None:
    quiet.command(Twist(Vector3(0.5)))

    (woken,) = quiet.poll()
    (after,) = quiet.answer(QUIET_STEPS + 8)

    assert (woken.step, woken.rest_ns, after.rest_ns) == (quiet.last.step, 0, 0)
    assert woken.targets != quiet.last.targets


def test_command_that_ends_a_rest_is_as_slow_as_others(quiet: Quiet) -> None:
    quiet.answer(QUIET_STEPS + 9)
    quiet.command(Twist(Vector3(0.5)))

    (woken,) = quiet.poll()
    (after,) = quiet.answer(QUIET_STEPS + 15)

    step = ACCELERATION * 0.01 / (PAIR.diameter_m / 2)
    assert list_speeds(woken) == pytest.approx([step] * 2)
    assert list_speeds(after) == pytest.approx([2 * step] * 2)


def test_command_that_ends_a_rest_is_valid_for_its_whole_time(quiet: Quiet) -> None:
    quiet.answer(QUIET_STEPS + 9)
    quiet.command(Twist(Vector3(0.5)))
    quiet.poll()

    first = QUIET_STEPS + 17
    *moving, last = (quiet.answer(step)[0] for step in range(first, first + 52))

    assert list_speeds(moving[-1])[0] > list_speeds(last)[0]
    assert all(list_speeds(one)[0] < list_speeds(two)[0] for one, two in pairwise(moving[:49]))


def test_agent_with_a_subscriber_gets_all_states(quiet: Quiet) -> None:
    quiet.bus.subscribe("r1/odom", 8)

    (command,) = quiet.answer(QUIET_STEPS + 4)

    assert command.rest_ns == 0
