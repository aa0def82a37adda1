"""Drive and odometry of one robot."""

import msgspec
import pytest

from tests.robot_agent.models import AT_REST, DRIVE, WHEELS, two_wheeler
from zensim.proto.messages.drive_messages import Compat, Limits, PlanarMove
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.robot_agent.base_controller import BaseController
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.odometry import BaseMotion

MS = 1_000_000
FORWARD = Twist(Vector3(0.5))
ENCODER = msgspec.structs.replace(DRIVE, odometry_source="encoder")
LIMITED = msgspec.structs.replace(DRIVE, max_acceleration=1.0)


def state(
    time_ms: int,
    positions: tuple[float, ...] = (0.0, 0.0),
    velocities: tuple[float, ...] = (0.0, 0.0),
) -> RobotState:
    return RobotState(time_ms * MS, AT_REST, positions, velocities)


def test_base_finds_wheel_speeds_and_true_motion() -> None:
    base = BaseController(two_wheeler())

    assert base.update(state(0), FORWARD)

    assert base.targets == pytest.approx((5.0, 5.0))
    assert base.motion.position == pytest.approx((0.0, 0.0, 0.0))


def test_base_has_zero_targets_before_its_first_state() -> None:
    base = BaseController(two_wheeler())

    assert base.targets == (0.0, 0.0)


def test_base_keeps_targets_and_motion_until_the_drive_is_due() -> None:
    slow = msgspec.structs.replace(DRIVE, update_rate_hz=10.0)
    base = BaseController(two_wheeler(slow))
    base.update(state(0), FORWARD)

    assert not base.update(state(50), Twist())
    assert base.targets == pytest.approx((5.0, 5.0))
    assert base.update(state(100), Twist())
    assert base.targets == (0.0, 0.0)


def test_base_passes_the_time_between_updates_to_the_drive() -> None:
    base = BaseController(two_wheeler(LIMITED))
    base.update(state(0), FORWARD)

    base.update(state(20), FORWARD)

    assert base.targets == pytest.approx((0.2, 0.2))


def test_base_finds_its_wheels_among_other_joints() -> None:
    turned = BaseController(two_wheeler(LIMITED, joints=WHEELS[::-1]))

    turned.update(state(0, velocities=(0.0, 5.0)), FORWARD)
    turned.update(state(20, velocities=(0.0, 5.0)), FORWARD)

    assert turned.targets == pytest.approx((0.0, 0.2))


def test_base_counts_wheel_rotation_of_states_between_updates() -> None:
    slow = msgspec.structs.replace(ENCODER, update_rate_hz=10.0)
    base = BaseController(two_wheeler(slow))
    base.update(state(0), FORWARD)
    base.update(state(50, positions=(1.0, 1.0)), FORWARD)

    base.update(state(100, positions=(3.0, 3.0)), FORWARD)

    assert base.motion.position == pytest.approx((0.3, 0.0, 0.0))
    assert base.motion.linear_x == pytest.approx(4.0)


def test_base_forgets_everything_at_a_reset() -> None:
    base = BaseController(two_wheeler(ENCODER))
    base.update(state(1000), FORWARD)
    base.update(state(1010, positions=(1.0, 1.0)), FORWARD)

    base.reset()

    assert base.targets == (0.0, 0.0)
    assert base.motion == BaseMotion()
    assert base.update(state(0), Twist())
    assert base.motion == BaseMotion()


def test_base_without_a_drive_has_no_targets() -> None:
    base = BaseController(two_wheeler(None))

    assert base.update(state(0), FORWARD)
    assert base.targets == ()
    base.reset()
    assert base.motion == BaseMotion()


def test_base_has_new_motion_at_the_rate_of_its_odometry() -> None:
    drive = msgspec.structs.replace(DRIVE, odometry_rate_hz=10.0)
    base = BaseController(two_wheeler(drive))

    assert base.update(state(0), FORWARD)
    assert not base.update(state(50), Twist())
    assert base.targets == (0.0, 0.0)
    assert base.update(state(100), Twist())
    base.reset()
    assert base.update(state(0), Twist())


def test_planar_base_has_three_targets() -> None:
    base = BaseController(two_wheeler(PlanarMove()))
    assert base.targets == (0.0, 0.0, 0.0)

    base.update(state(0), Twist(Vector3(0.5, 0.2)))

    assert base.targets == (0.5, 0.2, 0.0)


@pytest.mark.parametrize(("compat", "speed"), [("fixed", -10.0), ("gazebo11", 10.0)])
def test_encoder_speed_in_reverse_is_negative_unless_compat_is_gazebo11(
    compat: Compat, speed: float
) -> None:
    drive = msgspec.structs.replace(ENCODER, compat=compat)
    base = BaseController(two_wheeler(drive))
    base.update(state(0), Twist())

    base.update(state(10, positions=(-1.0, -1.0)), Twist())

    assert base.motion.position == pytest.approx((-0.1, 0.0, 0.0))
    assert base.motion.linear_x == pytest.approx(speed)


@pytest.mark.parametrize("first", [Twist(), FORWARD, Twist(Vector3(-0.3))])
def test_revised_base_continues_as_if_the_twist_had_come_before(first: Twist) -> None:
    limits = Limits(min_acceleration=-2.0, max_acceleration=2.0)
    drive = msgspec.structs.replace(LIMITED, linear_limits=limits)
    revised, expected = BaseController(two_wheeler(drive)), BaseController(two_wheeler(drive))
    for base in (revised, expected):
        base.update(state(0), Twist(Vector3(0.2)))
    revised.update(state(20, velocities=(1.0, 1.0)), first)
    expected.update(state(20, velocities=(1.0, 1.0)), FORWARD)

    assert revised.revise(FORWARD)
    assert revised.targets == expected.targets

    for base in (revised, expected):
        base.update(state(40, velocities=(1.2, 1.2)), FORWARD)
    assert revised.targets == expected.targets


def test_base_keeps_its_targets_when_the_drive_was_not_due() -> None:
    base = BaseController(two_wheeler(msgspec.structs.replace(DRIVE, update_rate_hz=10.0)))
    base.update(state(0), FORWARD)
    base.update(state(50), FORWARD)

    assert not base.revise(Twist())
    assert base.targets == pytest.approx((5.0, 5.0))


def test_base_revises_nothing_after_a_reset() -> None:
    base = BaseController(two_wheeler())
    base.update(state(0), Twist())
    base.reset()

    assert not base.revise(FORWARD)
