"""Robots by claim, and the states that speak of them."""

import struct

import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import a_claim, a_state, two_wheeler
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.fleet import Fleet
from zensim.robot_agent.robot import Robot


def a_fleet(bus: MemoryBus, *claims: int) -> Fleet:
    fleet = Fleet(bus, 0)
    for claim in claims:
        fleet.hold(claim, Robot(TopicFactory(bus), a_claim(claim, f"r{claim}"), 0))
    return fleet


def targets_of(command: DriveCommand) -> tuple[float, ...]:
    return struct.unpack(f"<{len(command.targets) // 8}d", command.targets)


def test_fleet_answers_a_state_claim_by_claim() -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus, 1, 2)
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))
    bus.put_message("r2/cmd_vel", Twist(Vector3(0.2)))

    command = fleet.advance(a_state(7, (2, 1), epoch=3))

    assert (command.epoch, command.step) == (3, 7)
    assert command.claims == struct.pack("<2I", 2, 1)
    assert targets_of(command) == pytest.approx((2.0, 2.0, 1.0, 1.0))


def test_fleet_knows_the_newest_claim_that_it_holds() -> None:
    fleet = a_fleet(MemoryBus(), 5, 9, 7)
    held = fleet.newest_claim

    fleet.lose_all_but(struct.pack("<2I", 5, 7))
    left = fleet.newest_claim
    fleet.lose_all_but(b"")

    assert (held, left, fleet.newest_claim) == (9, 7, 0)


def test_fleet_answers_for_the_robots_that_are_left() -> None:
    fleet = a_fleet(MemoryBus(), 1, 2)
    fleet.advance(a_state(1, (1, 2)))

    lost = fleet.lose_all_but(a_state(2, (2,)).claims)

    assert lost == ("r1",)
    assert [robot.entity for robot in fleet.robots] == ["r2"]
    assert targets_of(fleet.advance(a_state(2, (2,)))) == (0.0, 0.0)


def test_fleet_answers_for_a_robot_that_joined() -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus, 1)
    fleet.advance(a_state(1, (1,)))

    fleet.hold(2, Robot(TopicFactory(bus), a_claim(2, "r2"), 0))

    assert fleet.lose_all_but(a_state(2, (1, 2)).claims) == ()
    assert len(targets_of(fleet.advance(a_state(2, (1, 2))))) == 4


def test_fleet_answers_nothing_for_a_robot_without_a_drive() -> None:
    bus = MemoryBus()
    fleet = Fleet(bus, 0)
    fleet.hold(1, Robot(TopicFactory(bus), a_claim(model=two_wheeler(None)), 0))

    assert fleet.advance(a_state(1)).targets == b""


def test_fleet_loses_nothing_while_states_speak_of_all() -> None:
    fleet = a_fleet(MemoryBus(), 1, 2)
    state = a_state(1, (1, 2))
    fleet.advance(state)

    assert fleet.lose_all_but(state.claims) == ()


def test_fleet_closes_what_it_loses() -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus, 1, 2)

    assert fleet.lose_all_but(b"") == ("r1", "r2")
    assert not bus.is_served("*/*")


def test_fleet_holds_what_it_was_given_only() -> None:
    fleet = a_fleet(MemoryBus(), 1, 2)

    assert fleet.holds(a_state(1, (2,)).claims)
    assert fleet.holds(b"")
    assert not fleet.holds(a_state(1, (1, 3)).claims)


def test_fleet_refuses_claims_that_are_cut_off() -> None:
    with pytest.raises(MalformedPayload):
        a_fleet(MemoryBus(), 1).holds(b"\x01\x00\x00")


def test_fleet_resets_every_robot() -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus, 1)
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))
    fleet.advance(a_state(10))

    fleet.reset()

    assert targets_of(fleet.advance(a_state(0, epoch=1))) == (0.0, 0.0)


def test_fleet_tells_for_every_robot() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("*/odom", 8)
    fleet = a_fleet(bus, 1, 2)

    fleet.advance(a_state(1, (1, 2)))
    fleet.tell()

    assert {sample.key for sample in listener.take()} == {"r1/odom", "r2/odom"}


def test_fleet_revises_the_answer_of_the_robot_that_heard_a_command() -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus, 1, 2)
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))
    fleet.advance(a_state(7, (2, 1), epoch=3))
    bus.put_message("r2/cmd_vel", Twist(Vector3(0.2)))

    command = fleet.revise()

    assert command is not None
    assert (command.epoch, command.step) == (3, 7)
    assert targets_of(command) == pytest.approx((2.0, 2.0, 1.0, 1.0))
    assert fleet.revise() is None


def test_fleet_revises_nothing_when_it_holds_others_than_it_answered_for() -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus, 1)
    assert fleet.revise() is None
    fleet.advance(a_state(1, (1,)))
    fleet.hold(2, Robot(TopicFactory(bus), a_claim(2, "r2"), 0))
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))

    assert fleet.revise() is None
