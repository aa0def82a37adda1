"""One claimed robot."""

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import AT_REST, DRIVE, a_claim, two_wheeler
from zensim.proto.messages.model_messages import Model, RosBlock
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.robots import Robot

MS = 1_000_000
TIMEOUT_NS = 500 * MS
FORWARD = Twist(Vector3(0.5))


def reading(time_ms: int) -> RobotState:
    return RobotState(time_ms * MS, AT_REST, (0.0, 0.0), (0.0, 0.0))


def a_robot(bus: MemoryBus, model: Model | None = None) -> Robot:
    return Robot(TopicFactory(bus), a_claim(model=model), TIMEOUT_NS)


def test_robot_drives_by_what_it_hears() -> None:
    bus = MemoryBus()
    robot = a_robot(bus)
    bus.put_message("r1/cmd_vel", FORWARD)

    assert robot.advance(reading(0)) == pytest.approx((5.0, 5.0))


def test_robot_stands_when_it_hears_nothing_for_too_long() -> None:
    bus = MemoryBus()
    robot = a_robot(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    robot.advance(reading(0))

    assert robot.advance(reading(500)) == pytest.approx((5.0, 5.0))
    assert robot.advance(reading(510)) == (0.0, 0.0)


def test_robot_hears_where_its_description_remaps_to() -> None:
    bus = MemoryBus()
    drive = msgspec.structs.replace(DRIVE, ros=RosBlock("", ("cmd_vel:=go",)))
    robot = a_robot(bus, two_wheeler(drive))
    bus.put_message("r1/go", FORWARD)

    assert robot.advance(reading(0)) == pytest.approx((5.0, 5.0))


def test_robot_stands_after_a_reset() -> None:
    bus = MemoryBus()
    robot = a_robot(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    robot.advance(reading(100))

    robot.reset()

    assert robot.advance(reading(0)) == (0.0, 0.0)


def test_robot_tells_nothing_before_its_first_reading() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/*", 8)

    a_robot(bus).publish()

    assert listener.take() == []


def test_robot_tells_motion_when_its_drive_is_due_and_joints_when_they_are() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/*", 8)
    robot = a_robot(bus, two_wheeler(msgspec.structs.replace(DRIVE, update_rate_hz=10.0)))

    robot.advance(reading(0))
    robot.publish()
    assert {s.key for s in listener.take()} == {"r1/odom", "r1/tf", "r1/joint_states"}

    robot.advance(reading(40))
    robot.publish()
    assert {s.key for s in listener.take()} == {"r1/joint_states"}


def test_robot_without_a_drive_tells_its_joints_and_hears_nothing() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/*", 8)
    robot = a_robot(bus, two_wheeler(None))

    assert robot.cmd_vel is None
    assert robot.advance(reading(0)) == ()
    robot.publish()

    assert {s.key for s in listener.take()} == {"r1/tf", "r1/joint_states"}


def test_robot_without_a_drive_tells_again_at_once_after_a_reset() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/tf", 8)
    robot = a_robot(bus, two_wheeler(None))
    for time_ms in (5000, 0):
        robot.advance(reading(time_ms))
        robot.publish()
        robot.reset()

    assert len(listener.take()) == 2


def test_robot_answers_all_its_last_values() -> None:
    bus = MemoryBus()
    robot = a_robot(bus)
    bus.pumps.append(robot.answer)
    robot.advance(reading(0))
    robot.publish()

    assert {sample.key for sample in bus.get("r1/*")} == {
        "r1/odom",
        "r1/tf",
        "r1/tf_static",
        "r1/joint_states",
        "r1/robot_description",
    }


def test_robot_announces_what_never_changes() -> None:
    bus = MemoryBus()
    listener = bus.subscribe("r1/*", 8)

    a_robot(bus).announce()

    assert {s.key for s in listener.take()} == {"r1/tf_static", "r1/robot_description"}


@pytest.mark.parametrize("model", [two_wheeler(), two_wheeler(None)])
def test_robot_leaves_nothing_when_it_is_closed(model: Model) -> None:
    bus = MemoryBus()

    a_robot(bus, model).close()

    assert not bus.is_served("r1/*")
    assert not bus.is_heard("r1/*")
