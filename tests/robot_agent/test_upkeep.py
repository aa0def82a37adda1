"""What an agent does now and then."""

import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import a_claim, a_state, two_wheeler
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.fleet import Fleet
from zensim.robot_agent.robot import Robot
from zensim.robot_agent.upkeep import Upkeep


def a_fleet(bus: MemoryBus) -> Fleet:
    fleet = Fleet(bus, 0)
    fleet.hold(1, Robot(TopicFactory(bus), a_claim(1, "r1"), 0))
    fleet.hold(2, Robot(TopicFactory(bus), a_claim(2, "r2", two_wheeler(None)), 0))
    return fleet


def test_upkeep_answers_questions() -> None:
    bus = MemoryBus()
    upkeep = Upkeep(a_fleet(bus))
    times = iter(range(1000))
    bus.pumps.append(lambda: upkeep.poll(next(times) / 100))

    assert {sample.key for sample in bus.get("*/robot_description")} == {
        "r1/robot_description",
        "r2/robot_description",
    }


def test_upkeep_greets_new_listeners() -> None:
    bus = MemoryBus()
    upkeep = Upkeep(a_fleet(bus))
    upkeep.poll(0.0)
    listener = bus.subscribe("r1/tf_static", 8)

    upkeep.poll(0.1)
    assert listener.take() == []

    upkeep.poll(0.25)
    assert len(listener.take()) == 1


def test_upkeep_complains_once_a_second_at_most(caplog: pytest.LogCaptureFixture) -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus)
    upkeep = Upkeep(fleet)
    for i in range(200):
        bus.put("r1/cmd_vel", b"garbage")
        fleet.advance(a_state(i, (1,)))
        upkeep.poll(10.0 + i / 100)

    assert [line.split(" reason")[0] for line in caplog.messages] == [
        "cmd_vel entity=r1 malformed=1",
        "cmd_vel entity=r1 malformed=101",
    ]
