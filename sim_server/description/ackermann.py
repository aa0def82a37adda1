"""The plug-in of a car; its lengths are those of the links, as Gazebo takes them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import AckermannDrive
from zensim.sim_server.description import drive_tags
from zensim.sim_server.description.drive_geometry import wheels_of
from zensim.sim_server.description.drive_tags import grip_nm, joint_fault, with_settings

if TYPE_CHECKING:
    from collections.abc import Iterable

    from zensim.proto.messages.model_messages import Vec3
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

FILENAMES = ("gazebo_ros_ackermann_drive",)
ALIASES = drive_tags.ALIASES
_MOTORS = "motors here hold speed and angle by themselves"
UNUSED = drive_tags.UNUSED | {
    "left_steering_pid_gain": _MOTORS,
    "left_steering_i_range": _MOTORS,
    "right_steering_pid_gain": _MOTORS,
    "right_steering_i_range": _MOTORS,
    "linear_velocity_pid_gain": _MOTORS,
    "linear_velocity_i_range": _MOTORS,
    "publish_distance": "distance is not published here",
    "publish_steerangle": "steerangle is not published here",
}
LEAST_M = 1e-3


def read_ackermann(tags: PluginTags, lumped: Lumped) -> AckermannDrive | None:
    """Read the plug-in; None, with the reason noted, where Gazebo's would not work.

    Raises:
        ModelError: A number is none, or is negative.
    """
    named = _named_joints(tags)
    drive = msgspec.structs.replace(
        with_settings(named, tags),
        max_speed=tags.number("max_speed", named.max_speed),
        max_steer=tags.number("max_steer", named.max_steer),
        max_steering_angle=tags.number("max_steering_angle", named.max_steering_angle),
    )
    tags.report_unread(UNUSED)
    fault = joint_fault(drive.joints, {joint.name: joint for joint in lumped.joints})
    found = None if fault else _measured(drive, lumped)
    if found is None:
        reason = fault or "rear wheels have no round collision, or an axle has no width or place"
        tags.report.suspicious(tags.subject, f"no drive: {reason}")
    return found


def _named_joints(tags: PluginTags) -> AckermannDrive:
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


def _measured(drive: AckermannDrive, lumped: Lumped) -> AckermannDrive | None:
    rear_left, rear_right, front_left, front_right = wheels_of(drive.wheel_joints, lumped)
    track = math.dist(front_left.centre, front_right.centre)
    front = _middle((front_left.centre, front_right.centre))
    wheelbase = math.dist(front, _middle((rear_left.centre, rear_right.centre)))
    radius = rear_right.radius_m
    if min(track, wheelbase, radius) < LEAST_M:
        return None
    return msgspec.structs.replace(
        drive,
        wheel_radius_m=radius,
        wheelbase_m=wheelbase,
        track_m=track,
        wheel_effort_nm=grip_nm(lumped, radius_m=radius, wheels=2, joints=drive.wheel_joints[:2]),
        steering_effort_nm=grip_nm(
            lumped,
            radius_m=radius,
            wheels=1,
            joints=(drive.left_steering_joint, drive.right_steering_joint),
        ),
    )


def _middle(points: Iterable[Vec3]) -> list[float]:
    return [sum(numbers) / 2.0 for numbers in zip(*points, strict=True)]
