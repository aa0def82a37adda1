"""Overrides of described rates."""

import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import AT_REST, a_claim, two_wheeler
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.agent_config import override_rates
from zensim.robot_agent.base_controller import find_motion_rates
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.robots import DrivenRobot

PERIOD_NS = 10_000_000


def paced(claim: Claim, rates: RateOverrides) -> Claim:
    (found,) = override_rates([claim], rates)
    return found


@pytest.mark.parametrize(
    ("rates", "odom", "tf"),
    [
        (RateOverrides(), 100, 100),
        (RateOverrides(10.0), 10, 10),
        (RateOverrides(50.0, 10.0), 50, 10),
        (RateOverrides(10.0, 50.0), 10, 50),
        (RateOverrides(None, 20.0), 100, 20),
        (RateOverrides(0.0, 10.0), 100, 10),
    ],
)
def test_robot_publishes_odometry_and_tf_at_the_overridden_rates(
    rates: RateOverrides, odom: int, tf: int
) -> None:
    bus = MemoryBus()
    received = {topic: bus.subscribe(f"r1/{topic}", 1000) for topic in ("odom", "tf")}
    robot = DrivenRobot(TopicFactory(bus), paced(a_claim(), rates), 0)

    for step in range(100):
        robot.advance(RobotState(step * PERIOD_NS, AT_REST, (0.0, 0.0), (0.0, 0.0)))
        robot.publish()

    assert [len(received[topic].take()) for topic in ("odom", "tf")] == [odom, tf]


def test_claims_that_share_a_model_still_share_it() -> None:
    model = two_wheeler()

    one, other = override_rates(
        [a_claim(1, "r1", model), a_claim(2, "r2", model)], RateOverrides(5.0)
    )

    assert one.model is other.model
    assert one.model.drive is not None
    assert find_motion_rates(one.model.drive) == (5.0, None, None)


def test_entities_with_rates_of_their_own_share_a_model_among_equal_ones() -> None:
    model = two_wheeler()
    claims = [a_claim(number, f"r{number}", model) for number in range(4)]
    own = {"r1": RateOverrides(5.0), "r3": RateOverrides(5.0)}

    found = override_rates(claims, RateOverrides(), own)

    assert found[0].model is found[2].model is model
    assert found[1].model is found[3].model
    assert found[1].model.drive is not None
    assert find_motion_rates(found[1].model.drive) == (5.0, None, None)


def test_robot_without_a_drive_is_left_as_it_is() -> None:
    claim = a_claim(model=two_wheeler(None))

    assert paced(claim, RateOverrides(5.0)) == claim
