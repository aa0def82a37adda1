"""Plug-ins that apply the twist to the body: planar move, mecanum, velocity control."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import PlanarMove
from zensim.sim_server.description.plugins import drive_plugin
from zensim.sim_server.description.plugins.drive_plugin import (
    find_base_link,
    read_drive_settings,
    read_frame,
    read_odometry_rate,
    read_topic,
)

if TYPE_CHECKING:
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

GZ_BODY_FILENAMES = ("mecanum-drive-system", "velocity-control-system")
GZ_BODY_ALIASES: dict[str, str] = {}
_WHEELS_NOT_TURNED = "the body takes the twist; its wheels are not turned"
_TWIST_NOT_LIMITED = "the twist is not limited here"
UNUSED_GZ_BODY_TAGS = {
    **dict.fromkeys(
        (
            "front_left_joint", "front_right_joint", "back_left_joint", "back_right_joint",
            "wheel_separation", "wheelbase", "wheel_radius",
        ),
        _WHEELS_NOT_TURNED,
    ),
    **dict.fromkeys(
        (
            "min_velocity", "max_velocity", "min_acceleration", "max_acceleration", "min_jerk",
            "max_jerk",
        ),
        _TWIST_NOT_LIMITED,
    ),
    "tf_topic": "tf is on <namespace>/tf",
}  # fmt: skip


def read_gz_body_drive(tags: PluginTags, lumped: LumpedModel) -> PlanarMove:
    """Read the plug-in.

    Raises:
        ModelError: A number is none, or is negative.
    """
    drive = PlanarMove(
        update_rate_hz=0.0,
        odometry_rate_hz=read_odometry_rate(tags),
        odometry_frame=read_frame(tags, "frame_id", "odom"),
        robot_base_frame=read_frame(tags, "child_frame_id", find_base_link(lumped)),
        command_topic=read_topic(tags, "topic", "cmd_vel", is_new=False),
        odometry_topic=read_topic(tags, "odom_topic", "odom", is_new=False),
    )
    tags.report_unread(UNUSED_GZ_BODY_TAGS)
    return drive


PLANAR_MOVE_FILENAMES = ("gazebo_ros_planar_move", "gazebo_ros_force_based_move")
"""The second pushes the body until it has the twist; here it has it at once."""
PLANAR_MOVE_ALIASES = drive_plugin.DRIVE_ALIASES | {
    "odometryRate": "publish_rate",
    "publishOdometryTf": "publish_odom_tf",
}
_GAINS = ("torque_yaw_velocity_p_gain", "force_x_velocity_p_gain", "force_y_velocity_p_gain")
UNUSED_PLANAR_MOVE_TAGS = (
    drive_plugin.UNUSED_DRIVE_TAGS
    | {"cmdTimeout": "the agent has a timeout of its own"}
    | dict.fromkeys(_GAINS, "the body takes the twist at once")
)
DEFAULT_ODOMETRY_RATE_HZ = 20.0


def read_planar_move(tags: PluginTags, lumped: LumpedModel) -> PlanarMove:  # noqa: ARG001 - as for all
    """Read the plug-in.

    Raises:
        ModelError: A number is none, or is negative.
    """
    drive = read_drive_settings(PlanarMove(), tags)
    rate = tags.number("publish_rate", DEFAULT_ODOMETRY_RATE_HZ)
    tags.report_unread(UNUSED_PLANAR_MOVE_TAGS)
    return msgspec.structs.replace(drive, odometry_rate_hz=rate)
