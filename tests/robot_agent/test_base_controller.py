"""A base under its drive."""

import msgspec
import pytest

from tests.robot_agent.models import AT_REST, DRIVE, WHEELS, two_wheeler
from zensim.proto.messages.drive_messages import (
    Compat,
    Limits,
    PlanarMove,
)
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.robot_agent.base_controller import BaseController
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.odometry import BaseMotion

MS = 1_000_000
FORWARD = Twist(Vector3(0.5))
ENCODER = msgspec.structs.replace(DRIVE, odometry_source="encoder")
LIMITED = msgspec.structs.replace(DRIVE, max_acceleration=1.0)


def reading(
    time_ms: int,
    positions: tuple[float, ...] = (0.0, 0.0),
    velocities: tuple[float, ...] = (0.0, 0.0),
) -> RobotState:
    return RobotState(time_ms * MS, AT_REST, positions, velocities)


def test_base_finds_wheel_speeds_and_true_motion() -> None:
    base = BaseController(two_wheeler())

    assert base.update(reading(0), FORWARD)

    assert base.targets == pytest.approx((5.0, 5.0))
    assert base.motion.position == pytest.approx((0.0, 0.0, 0.0))


def test_base_stands_before_its_first_reading() -> None:
    base = BaseController(two_wheeler())

    assert base.targets == (0.0, 0.0)


def test_base_keeps_targets_and_motion_until_the_drive_is_due() -> None:
    slow = msgspec.structs.replace(DRIVE, update_rate_hz=10.0)
    base = BaseController(two_wheeler(slow))
    base.update(reading(0), FORWARD)

    assert not base.update(reading(50), Twist())
    assert base.targets == pytest.approx((5.0, 5.0))
    assert base.update(reading(100), Twist())
    assert base.targets == (0.0, 0.0)


def test_base_gives_the_drive_the_time_between_its_updates() -> None:
    base = BaseController(two_wheeler(LIMITED))
    base.update(reading(0), FORWARD)

    base.update(reading(20), FORWARD)

    assert base.targets == pytest.approx((0.2, 0.2))


def test_base_finds_its_wheels_among_other_joints() -> None:
    turned = BaseController(two_wheeler(LIMITED, joints=WHEELS[::-1]))

    turned.update(reading(0, velocities=(0.0, 5.0)), FORWARD)
    turned.update(reading(20, velocities=(0.0, 5.0)), FORWARD)

    assert turned.targets == pytest.approx((0.0, 0.2))


def test_base_counts_wheel_turns_of_readings_between_updates_too() -> None:
    slow = msgspec.structs.replace(ENCODER, update_rate_hz=10.0)
    base = BaseController(two_wheeler(slow))
    base.update(reading(0), FORWARD)
    base.update(reading(50, positions=(1.0, 1.0)), FORWARD)

    base.update(reading(100, positions=(3.0, 3.0)), FORWARD)

    assert base.motion.position == pytest.approx((0.3, 0.0, 0.0))
    assert base.motion.linear_x == pytest.approx(4.0)


def test_base_starts_again_when_it_is_reset() -> None:
    base = BaseController(two_wheeler(ENCODER))
    base.update(reading(1000), FORWARD)
    base.update(reading(1010, positions=(1.0, 1.0)), FORWARD)

    base.reset()

    assert base.targets == (0.0, 0.0)
    assert base.motion == BaseMotion()
    assert base.update(reading(0), Twist())
    assert base.motion == BaseMotion()


def test_base_without_a_drive_is_only_watched() -> None:
    base = BaseController(two_wheeler(None))

    assert base.update(reading(0), FORWARD)
    assert base.targets == ()
    base.reset()
    assert base.motion == BaseMotion()


def test_base_tells_motion_at_the_rate_of_its_odometry_when_that_has_one() -> None:
    drive = msgspec.structs.replace(DRIVE, odometry_rate_hz=10.0)
    base = BaseController(two_wheeler(drive))

    assert base.update(reading(0), FORWARD)
    assert not base.update(reading(50), Twist())
    assert base.targets == (0.0, 0.0)
    assert base.update(reading(100), Twist())
    base.reset()
    assert base.update(reading(0), Twist())


def test_base_that_is_moved_itself_has_three_targets() -> None:
    base = BaseController(two_wheeler(PlanarMove()))
    assert base.targets == (0.0, 0.0, 0.0)

    base.update(reading(0), Twist(Vector3(0.5, 0.2)))

    assert base.targets == (0.5, 0.2, 0.0)


@pytest.mark.parametrize(("compat", "speed"), [("fixed", -10.0), ("gazebo11", 10.0)])
def test_speed_by_encoders_in_reverse_is_negative_unless_it_is_gazebos(
    compat: Compat, speed: float
) -> None:
    drive = msgspec.structs.replace(ENCODER, compat=compat)
    base = BaseController(two_wheeler(drive))
    base.update(reading(0), Twist())

    base.update(reading(10, positions=(-1.0, -1.0)), Twist())

    assert base.motion.position == pytest.approx((-0.1, 0.0, 0.0))
    assert base.motion.linear_x == pytest.approx(speed)


@pytest.mark.parametrize("first", [Twist(), FORWARD, Twist(Vector3(-0.3))])
def test_base_whose_update_is_revised_goes_on_as_if_the_twist_had_come_before(first: Twist) -> None:
    limits = Limits(min_acceleration=-2.0, max_acceleration=2.0)
    drive = msgspec.structs.replace(LIMITED, linear_limits=limits)
    revised, told = BaseController(two_wheeler(drive)), BaseController(two_wheeler(drive))
    for base in (revised, told):
        base.update(reading(0), Twist(Vector3(0.2)))
    revised.update(reading(20, velocities=(1.0, 1.0)), first)
    told.update(reading(20, velocities=(1.0, 1.0)), FORWARD)

    assert revised.revise(FORWARD)
    assert revised.targets == told.targets

    for base in (revised, told):
        base.update(reading(40, velocities=(1.2, 1.2)), FORWARD)
    assert revised.targets == told.targets


def test_base_keeps_its_targets_when_the_drive_was_not_due() -> None:
    base = BaseController(two_wheeler(msgspec.structs.replace(DRIVE, update_rate_hz=10.0)))
    base.update(reading(0), FORWARD)
    base.update(reading(50), FORWARD)

    assert not base.revise(Twist())
    assert base.targets == pytest.approx((5.0, 5.0))


def test_base_has_nothing_to_revise_after_a_reset() -> None:
    base = BaseController(two_wheeler())
    base.update(reading(0), Twist())
    base.reset()

    assert not base.revise(FORWARD)
