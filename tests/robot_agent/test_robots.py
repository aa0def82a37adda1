"""Robots by claim, and the states that speak of them."""

import struct

import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import a_claim, a_state, two_wheeler
from zensim.proto.codec.message_codec import Format, MalformedPayload
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.standard_messages import Twist, TwistStamped, Vector3
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.robots import CMD_VEL_DEPTH, CmdVelSubscriber, IndividualRobots, Robot

TIMEOUT_NS = 500
FORWARD = Twist(Vector3(1.0))
BACK = Twist(Vector3(-1.0))
STILL = Twist()


def commanded(bus: MemoryBus, timeout_ns: int = TIMEOUT_NS) -> CmdVelSubscriber:
    return CmdVelSubscriber(bus.subscribe("r1/cmd_vel", CMD_VEL_DEPTH), timeout_ns)


def test_twist_is_none_when_nothing_has_come() -> None:
    assert commanded(MemoryBus()).at(1000) == STILL


def test_twist_is_the_newest() -> None:
    bus = MemoryBus()
    channel = commanded(bus)

    bus.put_message("r1/cmd_vel", FORWARD)
    bus.put_message("r1/cmd_vel", BACK, Format.JSON)

    assert channel.at(1000) == BACK


def test_twist_may_be_stamped() -> None:
    bus = MemoryBus()
    channel = commanded(bus)

    bus.put_message("r1/cmd_vel", TwistStamped(twist=FORWARD))

    assert channel.at(1000) == FORWARD


def test_twist_ends_when_it_is_older_than_the_timeout() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)

    assert channel.at(1000) == FORWARD
    assert channel.at(1500) == FORWARD
    assert channel.at(1501) == STILL
    assert channel.at(1502) == STILL


def test_twist_holds_longer_when_it_is_repeated() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    channel.at(1000)
    bus.put_message("r1/cmd_vel", FORWARD)
    channel.at(1400)

    assert channel.at(1900) == FORWARD


def test_twist_holds_for_ever_when_the_timeout_is_zero() -> None:
    bus = MemoryBus()
    channel = commanded(bus, timeout_ns=0)
    bus.put_message("r1/cmd_vel", FORWARD)
    channel.at(0)

    assert channel.at(10**15) == FORWARD


def test_twist_is_forgotten_at_a_reset() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    channel.at(1000)

    channel.reset()

    assert channel.at(0) == STILL


def test_twist_that_came_before_the_first_state_after_a_reset_counts() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)

    channel.reset()

    assert channel.at(0) == FORWARD


def test_malformed_twist_does_not_hide_the_good_one_before_it() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    bus.put("r1/cmd_vel", b"garbage")

    assert channel.at(1000) == FORWARD
    assert channel.malformed == 1


def test_twist_that_is_not_finite_is_malformed() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", Twist(Vector3(float("nan"))))

    assert channel.at(1000) == STILL
    assert channel.malformed == 1


def test_complaint_is_made_once_for_all_that_was_malformed() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    for _ in range(3):
        bus.put("r1/cmd_vel", b"garbage")
    channel.at(1000)

    assert channel.take_malformed_report().startswith("malformed=3 reason=")
    assert channel.take_malformed_report() == ""


def test_channel_is_closed_with_its_user() -> None:
    bus = MemoryBus()

    commanded(bus).close()

    assert not bus.is_heard("r1/cmd_vel")


def a_fleet(bus: MemoryBus, *claims: int) -> IndividualRobots:
    fleet = IndividualRobots(bus, 0)
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

    fleet.release_all_except(struct.pack("<2I", 5, 7))
    left = fleet.newest_claim
    fleet.release_all_except(b"")

    assert (held, left, fleet.newest_claim) == (9, 7, 0)


def test_fleet_answers_for_the_robots_that_are_left() -> None:
    fleet = a_fleet(MemoryBus(), 1, 2)
    fleet.advance(a_state(1, (1, 2)))

    lost = fleet.release_all_except(a_state(2, (2,)).claims)

    assert lost == ("r1",)
    assert [robot.entity for robot in fleet.robots] == ["r2"]
    assert targets_of(fleet.advance(a_state(2, (2,)))) == (0.0, 0.0)


def test_fleet_answers_for_a_robot_that_joined() -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus, 1)
    fleet.advance(a_state(1, (1,)))

    fleet.hold(2, Robot(TopicFactory(bus), a_claim(2, "r2"), 0))

    assert fleet.release_all_except(a_state(2, (1, 2)).claims) == ()
    assert len(targets_of(fleet.advance(a_state(2, (1, 2))))) == 4


def test_fleet_answers_nothing_for_a_robot_without_a_drive() -> None:
    bus = MemoryBus()
    fleet = IndividualRobots(bus, 0)
    fleet.hold(1, Robot(TopicFactory(bus), a_claim(model=two_wheeler(None)), 0))

    assert fleet.advance(a_state(1)).targets == b""


def test_fleet_loses_nothing_while_states_speak_of_all() -> None:
    fleet = a_fleet(MemoryBus(), 1, 2)
    state = a_state(1, (1, 2))
    fleet.advance(state)

    assert fleet.release_all_except(state.claims) == ()


def test_fleet_closes_what_it_loses() -> None:
    bus = MemoryBus()
    fleet = a_fleet(bus, 1, 2)

    assert fleet.release_all_except(b"") == ("r1", "r2")
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
    fleet.publish()

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
