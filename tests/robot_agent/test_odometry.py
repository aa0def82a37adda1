"""Odometry of both sources, against numbers worked out by hand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.drive_messages import DiffDrive, WheelPair
from zensim.proto.messages.model_messages import IDENTITY, Origin
from zensim.proto.messages.standard_messages import Header, Time
from zensim.proto.rigid_transforms import find_yaw, from_axis_angle
from zensim.robot_agent.odometry import (
    BaseMotion,
    EncoderOdometry,
    OdometryHeader,
    find_world_motion,
    make_covariances,
)

PAIR = WheelPair("left", "right", separation_m=0.4, diameter_m=0.2)
SECOND = 1_000_000_000
UP = (0.0, 0.0, 1.0)


def state(
    *,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    linear: tuple[float, float, float] = (0.0, 0.0, 0.0),
    angular: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[float, ...]:
    return (*position, *from_axis_angle(UP, yaw), *linear, *angular)


def an_encoder(*, is_speed_unsigned: bool = False) -> EncoderOdometry:
    encoder = EncoderOdometry(PAIR, is_speed_unsigned=is_speed_unsigned)
    encoder.update(left_rad=3.0, right_rad=-7.0, time_ns=5 * SECOND)
    return encoder


def world_motion(state: tuple[float, ...], base_in_root: Origin) -> BaseMotion:
    return BaseMotion(*find_world_motion(state, base_in_root, FLOAT_MATH))


def test_world_motion_starts_at_the_spawn_pose() -> None:
    motion = world_motion(state(position=(3.0, 4.0, 0.1), yaw=1.0), Origin())

    assert motion.position == pytest.approx((3.0, 4.0, 0.1))
    assert find_yaw(motion.orientation, FLOAT_MATH) == pytest.approx(1.0)


def test_world_motion_rotates_the_velocity_into_the_body() -> None:
    facing_left = state(yaw=math.pi / 2, linear=(-0.3, 0.5, 0.7), angular=(0.1, 0.2, 0.9))

    motion = world_motion(facing_left, Origin())

    assert (motion.linear_x, motion.linear_y) == pytest.approx((0.5, 0.3))
    assert motion.angular_z == pytest.approx(0.9)


def test_world_motion_is_that_of_the_base_when_it_is_off_the_root_link() -> None:
    below = Origin((0.0, 0.0, -0.06))

    motion = world_motion(state(position=(1.0, 2.0, 0.06)), below)

    assert motion.position == pytest.approx((1.0, 2.0, 0.0))


def test_world_motion_adds_the_rotation_for_a_base_off_the_root_link() -> None:
    ahead = Origin((0.5, 0.0, 0.0))

    motion = world_motion(state(linear=(1.0, 0.0, 0.0), angular=(0.0, 0.0, 2.0)), ahead)

    assert (motion.linear_x, motion.linear_y) == pytest.approx((1.0, 1.0))


def test_world_motion_follows_a_base_rotated_on_the_root_link() -> None:
    backwards = Origin((0.0, 0.0, 0.0), from_axis_angle(UP, math.pi))

    motion = world_motion(state(linear=(1.0, 0.2, 0.0)), backwards)

    assert (motion.linear_x, motion.linear_y) == pytest.approx((-1.0, -0.2))


def test_encoder_starts_at_zero_for_any_wheel_positions() -> None:
    assert an_encoder().motion == BaseMotion()


def test_encoder_moves_straight_when_both_wheels_turn_equally() -> None:
    encoder = an_encoder()

    encoder.update(left_rad=5.0, right_rad=-5.0, time_ns=7 * SECOND)

    assert encoder.motion.position == pytest.approx((0.2, 0.0, 0.0))
    assert encoder.motion.orientation == pytest.approx(IDENTITY)
    assert encoder.motion.linear_x == pytest.approx(0.1)
    assert encoder.motion.angular_z == pytest.approx(0.0)


def test_encoder_turns_on_the_spot_when_wheels_turn_against_each_other() -> None:
    encoder = an_encoder()

    encoder.update(left_rad=2.0, right_rad=-6.0, time_ns=6 * SECOND)

    assert encoder.motion.position == pytest.approx((0.0, 0.0, 0.0))
    assert find_yaw(encoder.motion.orientation, FLOAT_MATH) == pytest.approx(0.5)
    assert encoder.motion.angular_z == pytest.approx(0.5)


def test_encoder_moves_along_the_middle_heading_of_an_arc() -> None:
    encoder = an_encoder()

    encoder.update(left_rad=3.0, right_rad=-3.0, time_ns=6 * SECOND)

    assert encoder.motion.position == pytest.approx((0.2 * math.cos(0.5), 0.2 * math.sin(0.5), 0))
    assert find_yaw(encoder.motion.orientation, FLOAT_MATH) == pytest.approx(1.0)
    assert encoder.motion.linear_x == pytest.approx(0.2)


@pytest.mark.parametrize(("is_speed_unsigned", "expected"), [(False, -0.2), (True, 0.2)])
def test_encoder_speed_in_reverse_is_negative_unless_unsigned(
    *, is_speed_unsigned: bool, expected: float
) -> None:
    encoder = an_encoder(is_speed_unsigned=is_speed_unsigned)

    encoder.update(left_rad=1.0, right_rad=-9.0, time_ns=6 * SECOND)

    assert encoder.motion.linear_x == pytest.approx(expected)
    assert encoder.motion.position[0] == pytest.approx(-0.2)


def test_encoder_keeps_its_motion_when_no_time_has_passed() -> None:
    encoder = an_encoder()
    encoder.update(left_rad=5.0, right_rad=-5.0, time_ns=7 * SECOND)
    before = encoder.motion

    encoder.update(left_rad=5.0, right_rad=-5.0, time_ns=7 * SECOND)

    assert encoder.motion == before


def test_encoder_starts_at_zero_after_a_reset() -> None:
    encoder = an_encoder()
    encoder.update(left_rad=5.0, right_rad=-5.0, time_ns=7 * SECOND)

    encoder.reset()
    encoder.update(left_rad=0.0, right_rad=0.0, time_ns=0)

    assert encoder.motion == BaseMotion()


@given(speed=st.floats(-1.0, 1.0), turn_rate=st.floats(-2.0, 2.0), states=st.integers(20, 200))
def test_encoder_follows_the_arc_that_wheels_turn(
    speed: float, turn_rate: float, states: int
) -> None:
    encoder, elapsed_s = EncoderOdometry(PAIR, is_speed_unsigned=False), 0.0125
    for i in range(states + 1):
        angle = i * elapsed_s / (PAIR.diameter_m / 2.0)
        half = turn_rate * PAIR.separation_m / 2.0
        encoder.update(
            left_rad=(speed - half) * angle,
            right_rad=(speed + half) * angle,
            time_ns=round(i * elapsed_s * SECOND),
        )

    yaw = turn_rate * states * elapsed_s
    x, y = speed * states * elapsed_s, 0.0
    if abs(turn_rate) > 1e-6:
        x = speed / turn_rate * math.sin(yaw)
        y = speed / turn_rate * (1.0 - math.cos(yaw))
    assert encoder.motion.position == pytest.approx((x, y, 0.0), abs=1e-3)
    assert encoder.motion.linear_x == pytest.approx(speed, abs=1e-6)
    assert encoder.motion.angular_z == pytest.approx(turn_rate, abs=1e-6)


def test_covariance_has_the_drives_variances_and_the_rest_unknown() -> None:
    matrix, _ = make_covariances(DiffDrive(covariance_x=1.0, covariance_y=2.0, covariance_yaw=3.0))

    found = {index: variance for index, variance in enumerate(matrix) if variance}
    assert found == {0: 1.0, 7: 2.0, 14: 1e12, 21: 1e12, 28: 1e12, 35: 3.0}
    assert len(matrix) == 36


def test_message_holds_pose_and_twist_with_both_covariances() -> None:
    covariance, _ = make_covariances(DiffDrive())
    frames = OdometryHeader("odom", "base_footprint", covariance, covariance)
    motion = BaseMotion((1.0, 2.0, 3.0), from_axis_angle(UP, 1.0), 0.1, 0.2, 0.3)

    message = frames.message(motion, Time(4, 5))

    assert message.header == Header(Time(4, 5), "odom")
    assert message.child_frame_id == "base_footprint"
    assert message.pose.pose.position.z == 3.0
    assert message.pose.pose.orientation.w == from_axis_angle(UP, 1.0)[3]
    assert (message.twist.twist.linear.x, message.twist.twist.linear.y) == (0.1, 0.2)
    assert message.twist.twist.angular.z == 0.3
    assert message.pose.covariance == message.twist.covariance == covariance
