"""A drive state can order twists; both kinds of robot sets answer alike."""

import math
import struct
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import a_claim, a_state
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import DriveCommand, DriveState
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.robot_agent.robots import IndividualRobots

TIMEOUT_NS = 50_000_000
NONE = (math.nan, math.nan, math.nan)
RobotSet = IndividualRobots | PooledRobots
MakeRobots = Callable[[MemoryBus, int], RobotSet]


@pytest.fixture(params=[IndividualRobots, PooledRobots])
def robots(request: pytest.FixtureRequest) -> RobotSet:
    """Two robots."""
    made: RobotSet = request.param(MemoryBus(), TIMEOUT_NS)
    made.add_claims([a_claim(1, "r1"), a_claim(2, "r2")])
    return made


def ordering(state: DriveState, *rows: tuple[float, float, float], order: int = 1) -> DriveState:
    twists = np.array(rows, dtype="<f8").tobytes()
    return msgspec.structs.replace(state, twists=twists, order=order)


def targets_of(command: DriveCommand) -> list[tuple[float, ...]]:
    numbers = struct.unpack(f"<{len(command.targets) // 8}d", command.targets)
    return [numbers[:2], numbers[2:]]


def test_ordered_twist_drives_its_robot_only(robots: RobotSet) -> None:
    command = robots.advance(ordering(a_state(1, (1, 2)), (0.2, 0.0, 0.0), NONE))

    first, second = targets_of(command)
    assert first == pytest.approx((2.0, 2.0))
    assert second == (0.0, 0.0)
    assert command.order == 1


def test_robot_stops_when_orders_end(robots: RobotSet) -> None:
    robots.advance(ordering(a_state(1, (1, 2)), (0.2, 0.0, 0.0), NONE))

    held = robots.advance(a_state(3, (1, 2)))
    stopped = robots.advance(a_state(30, (1, 2)))

    assert targets_of(held)[0] == pytest.approx((2.0, 2.0))
    assert targets_of(stopped)[0] == (0.0, 0.0)


def test_state_of_the_same_step_with_another_order_replaces_the_answer(robots: RobotSet) -> None:
    robots.advance(ordering(a_state(1, (1, 2)), (0.2, 0.0, 0.0), NONE))
    again = ordering(a_state(1, (1, 2)), (0.0, 0.0, 1.0), (0.1, 0.0, 0.0), order=2)

    is_repeated = robots.repeats(again)
    command = robots.repeat(again)

    assert is_repeated
    assert command.order == 2
    assert targets_of(command) == [pytest.approx((-2.0, 2.0)), pytest.approx((1.0, 1.0))]


def test_order_drives_a_robot_at_the_step_at_which_another_one_is_claimed(robots: RobotSet) -> None:
    robots.release_all_except(a_state(1, (1,)).claims)
    robots.advance(a_state(1, (1,)))
    robots.add_claims([a_claim(3, "r3")])

    command = robots.advance(ordering(a_state(1, (1, 3)), (0.2, 0.0, 0.0), (0.2, 0.0, 0.0)))

    assert targets_of(command) == [pytest.approx((2.0, 2.0))] * 2


def test_state_of_another_step_is_no_repetition(robots: RobotSet) -> None:
    robots.advance(a_state(1, (1, 2)))

    assert not robots.repeats(ordering(a_state(2, (1, 2)), NONE, NONE))
    assert not robots.repeats(a_state(1, (1, 2)))


def test_twists_that_do_not_fit_the_claims_are_refused(robots: RobotSet) -> None:
    with pytest.raises(MalformedPayload):
        robots.advance(ordering(a_state(1, (1, 2)), (0.2, 0.0, 0.0)))
