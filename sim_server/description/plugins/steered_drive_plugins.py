"""Plug-ins of steered drives: Ackermann and tricycle."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import AckermannDrive, TricycleDrive
from zensim.sim_server.description.plugins import drive_plugin
from zensim.sim_server.description.plugins.drive_plugin import (
    find_grip_torque,
    find_joint_fault,
    measure_wheels,
    read_drive_settings,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from zensim.proto.messages.model_messages import Vec3
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

ACKERMANN_FILENAMES = ("gazebo_ros_ackermann_drive",)
ACKERMANN_ALIASES = drive_plugin.DRIVE_ALIASES
_BUILTIN_CONTROLLERS = "motors here hold speed and angle by themselves"
UNUSED_ACKERMANN_TAGS = drive_plugin.UNUSED_DRIVE_TAGS | {
    "left_steering_pid_gain": _BUILTIN_CONTROLLERS,
    "left_steering_i_range": _BUILTIN_CONTROLLERS,
    "right_steering_pid_gain": _BUILTIN_CONTROLLERS,
    "right_steering_i_range": _BUILTIN_CONTROLLERS,
    "linear_velocity_pid_gain": _BUILTIN_CONTROLLERS,
    "linear_velocity_i_range": _BUILTIN_CONTROLLERS,
    "publish_distance": "distance is not published here",
    "publish_steerangle": "steerangle is not published here",
}
MIN_AXLE_LENGTH_M = 1e-3


def read_ackermann(tags: PluginTags, lumped: LumpedModel) -> AckermannDrive | None:
    """Read the plug-in; None, with the reason noted, where Gazebo's would not work.

    Raises:
        ModelError: A number is none, or is negative.
    """
    named = _read_joints(tags)
    drive = msgspec.structs.replace(
        read_drive_settings(named, tags),
        max_speed=tags.number("max_speed", named.max_speed),
        max_steer=tags.number("max_steer", named.max_steer),
        max_steering_angle=tags.number("max_steering_angle", named.max_steering_angle),
    )
    tags.report_unread(UNUSED_ACKERMANN_TAGS)
    fault = find_joint_fault(drive.joints, {joint.name: joint for joint in lumped.joints})
    found = None if fault else _measure(drive, lumped)
    if found is None:
        reason = fault or "rear wheels have no round collision, or an axle has no width or place"
        tags.report.suspicious(tags.subject, f"no drive: {reason}")
    return found


def _read_joints(tags: PluginTags) -> AckermannDrive:
    drive = AckermannDrive()
    return AckermannDrive(
        rear_left_joint=tags.text("rear_left_joint", drive.rear_left_joint),
        rear_right_joint=tags.text("rear_right_joint", drive.rear_right_joint),
        front_left_joint=tags.text("front_left_joint", drive.front_left_joint),
        front_right_joint=tags.text("front_right_joint", drive.front_right_joint),
        left_steering_joint=tags.text("left_steering_joint", drive.left_steering_joint),
        right_steering_joint=tags.text("right_steering_joint", drive.right_steering_joint),
        steering_wheel_joint=tags.text("steering_wheel_joint", ""),
    )


def _measure(drive: AckermannDrive, lumped: LumpedModel) -> AckermannDrive | None:
    rear_left, rear_right, front_left, front_right = measure_wheels(drive.wheel_joints, lumped)
    track = math.dist(front_left.centre, front_right.centre)
    front = _midpoint((front_left.centre, front_right.centre))
    wheelbase = math.dist(front, _midpoint((rear_left.centre, rear_right.centre)))
    radius = rear_right.radius_m
    if min(track, wheelbase, radius) < MIN_AXLE_LENGTH_M:
        return None
    return msgspec.structs.replace(
        drive,
        wheel_radius_m=radius,
        wheelbase_m=wheelbase,
        track_m=track,
        wheel_effort_nm=find_grip_torque(
            lumped, radius_m=radius, wheels=2, joints=drive.wheel_joints[:2]
        ),
        steering_effort_nm=find_grip_torque(
            lumped,
            radius_m=radius,
            wheels=1,
            joints=(drive.left_steering_joint, drive.right_steering_joint),
        ),
    )


def _midpoint(points: Iterable[Vec3]) -> list[float]:
    return [sum(numbers) / 2.0 for numbers in zip(*points, strict=True)]


TRICYCLE_FILENAMES = ("gazebo_ros_tricycle_drive",)
TRICYCLE_ALIASES = drive_plugin.DRIVE_ALIASES | {
    "steeringJoint": "steering_joint",
    "actuatedWheelJoint": "actuated_wheel_joint",
    "encoderWheelLeftJoint": "encoder_wheel_left_joint",
    "encoderWheelRightJoint": "encoder_wheel_right_joint",
    "actuatedWheelDiameter": "actuated_wheel_diameter",
    "encoderWheelDiameter": "encoder_wheel_diameter",
    "encoderWheelSeparation": "wheel_separation",
    "wheelTorque": "max_wheel_torque",
    "wheelAcceleration": "max_wheel_acceleration",
    "wheelDeceleration": "max_wheel_deceleration",
    "wheelSpeedTolerance": "max_wheel_speed_tolerance",
    "steeringSpeed": "max_steering_speed",
    "steeringAngleTolerance": "max_steering_angle_tolerance",
}
UNUSED_TRICYCLE_TAGS = drive_plugin.UNUSED_DRIVE_TAGS | {
    "steeringTorque": "steering has the torque of the wheel"
}


def read_tricycle(tags: PluginTags, lumped: LumpedModel) -> TricycleDrive | None:
    """Read the plug-in; None, with the reason noted, where Gazebo's would not work.

    Raises:
        ModelError: A number is none, is negative, or a diameter is not positive.
    """
    drive = _read_motors(_read_wheels(read_drive_settings(TricycleDrive(), tags), tags), tags)
    # Gazebo sends the transform of its odometry whenever it sends the odometry.
    has_tf = tags.flag("publish_odom_tf", default=drive.publish_odom)
    tags.report_unread(UNUSED_TRICYCLE_TAGS)
    fault = find_joint_fault(drive.joints, {joint.name: joint for joint in lumped.joints})
    if fault:
        tags.report.suspicious(tags.subject, f"no drive: {fault}")
        return None
    radius = drive.actuated_wheel_diameter_m / 2.0
    effort = find_grip_torque(lumped, radius_m=radius, wheels=1, joints=(drive.steering_joint,))
    return msgspec.structs.replace(drive, publish_odom_tf=has_tf, steering_effort_nm=effort)


def _read_wheels(drive: TricycleDrive, tags: PluginTags) -> TricycleDrive:
    return msgspec.structs.replace(
        drive,
        steering_joint=tags.text("steering_joint", drive.steering_joint),
        actuated_wheel_joint=tags.text("actuated_wheel_joint", drive.actuated_wheel_joint),
        encoder_wheel_left_joint=tags.text(
            "encoder_wheel_left_joint", drive.encoder_wheel_left_joint
        ),
        encoder_wheel_right_joint=tags.text(
            "encoder_wheel_right_joint", drive.encoder_wheel_right_joint
        ),
        actuated_wheel_diameter_m=tags.length(
            "actuated_wheel_diameter", drive.actuated_wheel_diameter_m
        ),
        encoder_wheel_diameter_m=tags.length(
            "encoder_wheel_diameter", drive.encoder_wheel_diameter_m
        ),
        wheel_separation_m=tags.length("wheel_separation", drive.wheel_separation_m),
    )


def _read_motors(drive: TricycleDrive, tags: PluginTags) -> TricycleDrive:
    acceleration = tags.number("max_wheel_acceleration", drive.max_acceleration)
    return msgspec.structs.replace(
        drive,
        max_torque_nm=tags.number("max_wheel_torque", drive.max_torque_nm),
        max_acceleration=acceleration,
        max_deceleration=tags.number("max_wheel_deceleration", acceleration),
        speed_tolerance=tags.number("max_wheel_speed_tolerance", drive.speed_tolerance),
        max_steering_speed=tags.number("max_steering_speed", drive.max_steering_speed),
        angle_tolerance=tags.number("max_steering_angle_tolerance", drive.angle_tolerance),
    )
