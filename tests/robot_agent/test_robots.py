"""Robots by claim."""

import struct

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import AT_REST, DRIVE, a_claim, a_state, two_wheeler
from zensim.proto.codec.message_codec import Format, MalformedPayload
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Twist, TwistStamped, Vector3
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.robots import CMD_VEL_DEPTH, CmdVelSubscriber, DrivenRobot, IndividualRobots

TIMEOUT_NS = 500
FORWARD = Twist(Vector3(1.0))
BACK = Twist(Vector3(-1.0))
ZERO_TWIST = Twist()


def subscribe_cmd_vel(bus: MemoryBus, timeout_ns: int = TIMEOUT_NS) -> CmdVelSubscriber:
    return CmdVelSubscriber(bus.subscribe("r1/cmd_vel", CMD_VEL_DEPTH), timeout_ns)


def test_twist_is_zero_before_the_first_command() -> None:
    assert subscribe_cmd_vel(MemoryBus()).at(1000) == ZERO_TWIST


def test_twist_is_the_newest() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)

    bus.put_message("r1/cmd_vel", FORWARD)
    bus.put_message("r1/cmd_vel", BACK, Format.JSON)

    assert cmd_vel.at(1000) == BACK


def test_twist_may_be_stamped() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)

    bus.put_message("r1/cmd_vel", TwistStamped(twist=FORWARD))

    assert cmd_vel.at(1000) == FORWARD


def test_twist_ends_when_it_is_older_than_the_timeout() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)
    bus.put_message("r1/cmd_vel", FORWARD)

    assert cmd_vel.at(1000) == FORWARD
    assert cmd_vel.at(1500) == FORWARD
    assert cmd_vel.at(1501) == ZERO_TWIST
    assert cmd_vel.at(1502) == ZERO_TWIST


def test_twist_holds_longer_when_it_is_repeated() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    cmd_vel.at(1000)
    bus.put_message("r1/cmd_vel", FORWARD)
    cmd_vel.at(1400)

    assert cmd_vel.at(1900) == FORWARD


def test_twist_holds_for_ever_when_the_timeout_is_zero() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus, timeout_ns=0)
    bus.put_message("r1/cmd_vel", FORWARD)
    cmd_vel.at(0)

    assert cmd_vel.at(10**15) == FORWARD


def test_twist_is_forgotten_at_a_reset() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    cmd_vel.at(1000)

    cmd_vel.reset()

    assert cmd_vel.at(0) == ZERO_TWIST


def test_twist_that_came_before_the_first_state_after_a_reset_counts() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)
    bus.put_message("r1/cmd_vel", FORWARD)

    cmd_vel.reset()

    assert cmd_vel.at(0) == FORWARD


def test_malformed_twist_does_not_hide_the_good_one_before_it() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    bus.put("r1/cmd_vel", b"garbage")

    assert cmd_vel.at(1000) == FORWARD
    assert cmd_vel.malformed == 1


def test_twist_that_is_not_finite_is_malformed() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)
    bus.put_message("r1/cmd_vel", Twist(Vector3(float("nan"))))

    assert cmd_vel.at(1000) == ZERO_TWIST
    assert cmd_vel.malformed == 1


def test_malformed_commands_are_reported_once() -> None:
    bus = MemoryBus()
    cmd_vel = subscribe_cmd_vel(bus)
    for _ in range(3):
        bus.put("r1/cmd_vel", b"garbage")
    cmd_vel.at(1000)

    assert cmd_vel.take_malformed_report().startswith("malformed=3 reason=")
    assert cmd_vel.take_malformed_report() == ""


def test_subscription_is_closed_with_its_owner() -> None:
    bus = MemoryBus()

    subscribe_cmd_vel(bus).close()

    assert not bus.has_subscriber("r1/cmd_vel")


def make_robots(bus: MemoryBus, *claims: int) -> IndividualRobots:
    robots = IndividualRobots(bus, 0)
    for claim in claims:
        robots.hold(claim, DrivenRobot(TopicFactory(bus), a_claim(claim, f"r{claim}"), 0))
    return robots


def targets_of(command: DriveCommand) -> tuple[float, ...]:
    return struct.unpack(f"<{len(command.targets) // 8}d", command.targets)


def test_robots_answer_a_state_claim_by_claim() -> None:
    bus = MemoryBus()
    robots = make_robots(bus, 1, 2)
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))
    bus.put_message("r2/cmd_vel", Twist(Vector3(0.2)))

    command = robots.advance(a_state(7, (2, 1), epoch=3))

    assert (command.epoch, command.step) == (3, 7)
    assert command.claims == struct.pack("<2I", 2, 1)
    assert targets_of(command) == pytest.approx((2.0, 2.0, 1.0, 1.0))


def test_robots_have_a_newest_claim() -> None:
    robots = make_robots(MemoryBus(), 5, 9, 7)
    held = robots.newest_claim

    robots.release_all_except(struct.pack("<2I", 5, 7))
    left = robots.newest_claim
    robots.release_all_except(b"")

    assert (held, left, robots.newest_claim) == (9, 7, 0)


def test_robots_answer_for_those_that_are_left() -> None:
    robots = make_robots(MemoryBus(), 1, 2)
    robots.advance(a_state(1, (1, 2)))

    lost = robots.release_all_except(a_state(2, (2,)).claims)

    assert lost == ("r1",)
    assert [robot.entity for robot in robots.robots] == ["r2"]
    assert targets_of(robots.advance(a_state(2, (2,)))) == (0.0, 0.0)


def test_robots_answer_for_one_that_joined() -> None:
    bus = MemoryBus()
    robots = make_robots(bus, 1)
    robots.advance(a_state(1, (1,)))

    robots.hold(2, DrivenRobot(TopicFactory(bus), a_claim(2, "r2"), 0))

    assert robots.release_all_except(a_state(2, (1, 2)).claims) == ()
    assert len(targets_of(robots.advance(a_state(2, (1, 2))))) == 4


def test_robots_answer_nothing_for_one_without_a_drive() -> None:
    bus = MemoryBus()
    robots = IndividualRobots(bus, 0)
    robots.hold(1, DrivenRobot(TopicFactory(bus), a_claim(model=two_wheeler(None)), 0))

    assert robots.advance(a_state(1)).targets == b""


def test_robots_are_kept_while_states_have_all_claims() -> None:
    robots = make_robots(MemoryBus(), 1, 2)
    state = a_state(1, (1, 2))
    robots.advance(state)

    assert robots.release_all_except(state.claims) == ()


def test_robots_are_closed_when_lost() -> None:
    bus = MemoryBus()
    robots = make_robots(bus, 1, 2)

    assert robots.release_all_except(b"") == ("r1", "r2")
    assert not bus.is_served("*/*")


def test_robots_hold_their_claims_only() -> None:
    robots = make_robots(MemoryBus(), 1, 2)

    assert robots.holds(a_state(1, (2,)).claims)
    assert robots.holds(b"")
    assert not robots.holds(a_state(1, (1, 3)).claims)


def test_robots_reject_truncated_claims() -> None:
    with pytest.raises(MalformedPayload):
        make_robots(MemoryBus(), 1).holds(b"\x01\x00\x00")


def test_robots_are_all_reset() -> None:
    bus = MemoryBus()
    robots = make_robots(bus, 1)
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))
    robots.advance(a_state(10))

    robots.reset()

    assert targets_of(robots.advance(a_state(0, epoch=1))) == (0.0, 0.0)


def test_robots_all_publish() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("*/odom", 8)
    robots = make_robots(bus, 1, 2)

    robots.advance(a_state(1, (1, 2)))
    robots.publish()

    assert {sample.key for sample in listener.take()} == {"r1/odom", "r2/odom"}


def test_robots_revise_the_answer_of_one_with_a_new_command() -> None:
    bus = MemoryBus()
    robots = make_robots(bus, 1, 2)
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))
    robots.advance(a_state(7, (2, 1), epoch=3))
    bus.put_message("r2/cmd_vel", Twist(Vector3(0.2)))

    command = robots.revise()

    assert command is not None
    assert (command.epoch, command.step) == (3, 7)
    assert targets_of(command) == pytest.approx((2.0, 2.0, 1.0, 1.0))
    assert robots.revise() is None


def test_robots_revise_nothing_when_claims_changed_since_the_answer() -> None:
    bus = MemoryBus()
    robots = make_robots(bus, 1)
    assert robots.revise() is None
    robots.advance(a_state(1, (1,)))
    robots.hold(2, DrivenRobot(TopicFactory(bus), a_claim(2, "r2"), 0))
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))

    assert robots.revise() is None


MS = 1_000_000
ROBOT_TIMEOUT_NS = 500 * MS
SLOW_FORWARD = Twist(Vector3(0.5))


def state(time_ms: int) -> RobotState:
    return RobotState(time_ms * MS, AT_REST, (0.0, 0.0), (0.0, 0.0))


def a_robot(bus: MemoryBus, model: Model | None = None) -> DrivenRobot:
    return DrivenRobot(TopicFactory(bus), a_claim(model=model), ROBOT_TIMEOUT_NS)


def test_robot_follows_its_commands() -> None:
    bus = MemoryBus()
    robot = a_robot(bus)
    bus.put_message("r1/cmd_vel", SLOW_FORWARD)

    assert robot.advance(state(0)) == pytest.approx((5.0, 5.0))


def test_robot_stops_when_commands_time_out() -> None:
    bus = MemoryBus()
    robot = a_robot(bus)
    bus.put_message("r1/cmd_vel", SLOW_FORWARD)
    robot.advance(state(0))

    assert robot.advance(state(500)) == pytest.approx((5.0, 5.0))
    assert robot.advance(state(510)) == (0.0, 0.0)


def test_robot_subscribes_to_its_remapped_key() -> None:
    bus = MemoryBus()
    drive = msgspec.structs.replace(DRIVE, ros=RosBlock("", ("cmd_vel:=go",)))
    robot = a_robot(bus, two_wheeler(drive))
    bus.put_message("r1/go", SLOW_FORWARD)

    assert robot.advance(state(0)) == pytest.approx((5.0, 5.0))


def test_robot_stops_after_a_reset() -> None:
    bus = MemoryBus()
    robot = a_robot(bus)
    bus.put_message("r1/cmd_vel", SLOW_FORWARD)
    robot.advance(state(100))

    robot.reset()

    assert robot.advance(state(0)) == (0.0, 0.0)


def test_robot_publishes_nothing_before_its_first_state() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/*", 8)

    a_robot(bus).publish()

    assert listener.take() == []


def test_robot_publishes_motion_with_its_drive_and_joints_at_their_rate() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/*", 8)
    robot = a_robot(bus, two_wheeler(msgspec.structs.replace(DRIVE, update_rate_hz=10.0)))

    robot.advance(state(0))
    robot.publish()
    assert {s.key for s in listener.take()} == {"r1/odom", "r1/tf", "r1/joint_states"}

    robot.advance(state(40))
    robot.publish()
    assert {s.key for s in listener.take()} == {"r1/joint_states"}


def test_robot_without_a_drive_publishes_joints_and_subscribes_to_nothing() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/*", 8)
    robot = a_robot(bus, two_wheeler(None))

    assert robot.cmd_vel is None
    assert robot.advance(state(0)) == ()
    robot.publish()

    assert {s.key for s in listener.take()} == {"r1/tf", "r1/joint_states"}


def test_robot_without_a_drive_publishes_at_once_after_a_reset() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/tf", 8)
    robot = a_robot(bus, two_wheeler(None))
    for time_ms in (5000, 0):
        robot.advance(state(time_ms))
        robot.publish()
        robot.reset()

    assert len(listener.take()) == 2


def test_robot_replies_with_all_its_last_values() -> None:
    bus = MemoryBus()
    robot = a_robot(bus)
    bus.pumps.append(robot.reply_to_queries)
    robot.advance(state(0))
    robot.publish()

    assert {sample.key for sample in bus.get("r1/*")} == {
        "r1/odom",
        "r1/tf",
        "r1/tf_static",
        "r1/joint_states",
        "r1/robot_description",
    }


def test_robot_announces_static_topics() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/*", 8)

    a_robot(bus).announce()

    assert {s.key for s in listener.take()} == {"r1/tf_static", "r1/robot_description"}


@pytest.mark.parametrize("model", [two_wheeler(), two_wheeler(None)])
def test_robot_undeclares_everything_when_closed(model: Model) -> None:
    bus = MemoryBus()

    a_robot(bus, model).close()

    assert not bus.is_served("r1/*")
    assert not bus.has_subscriber("r1/*")


def test_robots_read_commands_at_states_only_while_malformed_ones_come() -> None:
    bus = MemoryBus()
    robots = make_robots(bus, 1)
    bus.put("r1/cmd_vel", b"garbage")
    robots.advance(a_state(1))
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.1)))

    assert robots.revise() is None
    assert targets_of(robots.advance(a_state(2))) == pytest.approx((1.0, 1.0))
    bus.put_message("r1/cmd_vel", Twist(Vector3(0.2)))
    assert robots.revise() is not None
