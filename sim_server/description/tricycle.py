"""The plug-in of a tricycle: one wheel drives and steers, two follow and count."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import TricycleDrive
from zensim.sim_server.description import drive_tags
from zensim.sim_server.description.drive_tags import grip_nm, joint_fault, with_settings

if TYPE_CHECKING:
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

FILENAMES = ("gazebo_ros_tricycle_drive",)
ALIASES = drive_tags.ALIASES | {
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
UNUSED = drive_tags.UNUSED | {"steeringTorque": "steering has the torque of the wheel"}


def read_tricycle(tags: PluginTags, lumped: Lumped) -> TricycleDrive | None:
    """Read the plug-in; None, with the reason noted, where Gazebo's would not work.

    Raises:
        ModelError: A number is none, is negative, or a diameter is not positive.
    """
    drive = _with_motors(_with_wheels(with_settings(TricycleDrive(), tags), tags), tags)
    # Gazebo sends the transform of its odometry whenever it sends the odometry.
    has_tf = tags.flag("publish_odom_tf", default=drive.publish_odom)
    tags.report_unread(UNUSED)
    fault = joint_fault(drive.joints, {joint.name: joint for joint in lumped.joints})
    if fault:
        tags.report.suspicious(tags.subject, f"no drive: {fault}")
        return None
    radius = drive.actuated_wheel_diameter_m / 2.0
    effort = grip_nm(lumped, radius_m=radius, wheels=1, joints=(drive.steering_joint,))
    return msgspec.structs.replace(drive, publish_odom_tf=has_tf, steering_effort_nm=effort)


def _with_wheels(drive: TricycleDrive, tags: PluginTags) -> TricycleDrive:
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


def _with_motors(drive: TricycleDrive, tags: PluginTags) -> TricycleDrive:
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
