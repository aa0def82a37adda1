"""Plug-ins of Gazebo Classic for mecanum wheels, which several packages have under one name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import OmniDrive
from zensim.sim_server.description.plugins.drive_controllers import (
    MECANUM_WHEELS,
    make_mecanum_wheels,
    measure_reach,
    resolve_joint,
    summarize_omni,
    with_wheels,
)
from zensim.sim_server.description.plugins.drive_plugin import (
    NUMBER,
    ROS_ALIASES,
    ROS_PARAMETERS,
    ROS_UNUSED,
    DriveParameter,
    DrivePlugin,
    UnusableDrive,
)
from zensim.sim_server.description.plugins.wheel_measures import (
    check_lengths,
    check_wheel_joints,
    measure_wheels,
)

if TYPE_CHECKING:
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

JOINT_TAGS = ("front_left_joint", "front_right_joint", "back_left_joint", "back_right_joint")
"""Tags in the order of `MECANUM_WHEELS`."""
DEFAULT_ODOMETRY_RATE_HZ = 20.0
MAX_TORQUE_TAG = "max_wheel_torque"


def _read_wheels(drive: OmniDrive, tags: PluginTags, lumped: LumpedModel) -> OmniDrive:
    names = [tags.text(tag, "") for tag in JOINT_TAGS]
    joints = [resolve_joint(tags, name, lumped) for name in names if name]
    if len(joints) != len(MECANUM_WHEELS):
        raise UnusableDrive(f"{len(joints)} wheels; name front and back, left and right")
    check_wheel_joints(joints, lumped)
    wheels = measure_wheels(joints, lumped)
    length, width = measure_reach(wheels)
    length = _read_length(tags, "wheel_separation_length", length)
    width = _read_length(tags, "wheel_separation", width)
    diameter = _read_length(tags, "wheel_diameter", 2.0 * wheels[0].radius_m)
    rollers = make_mecanum_wheels(joints, radius_m=diameter / 2.0, reach_m=(length + width) / 2.0)
    return _limit_torque(with_wheels(drive, rollers, lumped), tags)


def _read_length(tags: PluginTags, tag: str, measured: float) -> float:
    length = tags.length(tag, measured)
    if length == 0.0:
        raise UnusableDrive(f"{tag} is missing, and cannot be measured; write it")
    check_lengths(tags, tag, (length,))
    return length


def _limit_torque(drive: OmniDrive, tags: PluginTags) -> OmniDrive:
    torque = tags.number(MAX_TORQUE_TAG, drive.max_torque_nm)
    return msgspec.structs.replace(drive, max_torque_nm=torque) if torque else drive


PLUGINS = (
    DrivePlugin(
        filenames=("gazebo_ros_mecanum_drive",),
        drive_type=OmniDrive,
        summarize=summarize_omni,
        make=lambda *_: OmniDrive(
            odometry_rate_hz=DEFAULT_ODOMETRY_RATE_HZ, publish_odom=True, publish_odom_tf=True
        ),
        parameters=(*ROS_PARAMETERS, DriveParameter("publish_rate", NUMBER, "odometry_rate_hz")),
        complete=_read_wheels,
        aliases=ROS_ALIASES
        | {
            "LeftFront": "front_left_joint",
            "RightFront": "front_right_joint",
            "LeftRear": "back_left_joint",
            "RightRear": "back_right_joint",
            "WheelSeparationL": "wheel_separation_length",
            "WheelSeparationW": "wheel_separation",
            "wheelDiameter": "wheel_diameter",
            "WheelTorque": MAX_TORQUE_TAG,
            "wheelAccel": "max_wheel_acceleration",
            "odometryRate": "publish_rate",
            "publishOdom": "publish_odom",
        },
        unused=ROS_UNUSED
        | {
            "max_wheel_acceleration": "the twist is applied to the body",
            "num_wheel": "there are four wheels",
            "isRollerModel": "rollers turn as the description has them",
        },
    ),
)
