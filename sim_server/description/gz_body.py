"""Gazebo Sim's drives that move a body sideways too: by its wheels there, as a whole here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.drive_messages import PlanarMove
from zensim.sim_server.description.drive_tags import (
    base_of,
    read_frame,
    read_odometry_rate,
    read_topic,
)

if TYPE_CHECKING:
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

FILENAMES = ("mecanum-drive-system", "velocity-control-system")
ALIASES: dict[str, str] = {}
_WHEELS = "the body takes the twist; its wheels are not turned"
_LIMITS = "the twist is not limited here"
UNUSED = {
    **dict.fromkeys(
        (
            "front_left_joint", "front_right_joint", "back_left_joint", "back_right_joint",
            "wheel_separation", "wheelbase", "wheel_radius",
        ),
        _WHEELS,
    ),
    **dict.fromkeys(
        (
            "min_velocity", "max_velocity", "min_acceleration", "max_acceleration", "min_jerk",
            "max_jerk",
        ),
        _LIMITS,
    ),
    "tf_topic": "tf is on <namespace>/tf",
}  # fmt: skip


def read_gz_body(tags: PluginTags, lumped: Lumped) -> PlanarMove:
    """Read the plug-in.

    Raises:
        ModelError: A number is none, or is negative.
    """
    drive = PlanarMove(
        update_rate_hz=0.0,
        odometry_rate_hz=read_odometry_rate(tags),
        odometry_frame=read_frame(tags, "frame_id", "odom"),
        robot_base_frame=read_frame(tags, "child_frame_id", base_of(lumped)),
        command_topic=read_topic(tags, "topic", "cmd_vel", is_new=False),
        odometry_topic=read_topic(tags, "odom_topic", "odom", is_new=False),
    )
    tags.report_unread(UNUSED)
    return drive
