"""The plug-in of a body that takes the twist itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import PlanarMove
from zensim.sim_server.description import drive_tags
from zensim.sim_server.description.drive_tags import with_settings

if TYPE_CHECKING:
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

FILENAMES = ("gazebo_ros_planar_move", "gazebo_ros_force_based_move")
"""The second pushes the body until it has the twist; here it has it at once."""
ALIASES = drive_tags.ALIASES | {
    "odometryRate": "publish_rate",
    "publishOdometryTf": "publish_odom_tf",
}
_GAINS = ("torque_yaw_velocity_p_gain", "force_x_velocity_p_gain", "force_y_velocity_p_gain")
UNUSED = (
    drive_tags.UNUSED
    | {"cmdTimeout": "the agent has a timeout of its own"}
    | dict.fromkeys(_GAINS, "the body takes the twist at once")
)
RATE_HZ = 20.0


def read_planar_move(tags: PluginTags, lumped: Lumped) -> PlanarMove:  # noqa: ARG001 - as for all
    """Read the plug-in.

    Raises:
        ModelError: A number is none, or is negative.
    """
    drive = with_settings(PlanarMove(), tags)
    rate = tags.number("publish_rate", RATE_HZ)
    tags.report_unread(UNUSED)
    return msgspec.structs.replace(drive, odometry_rate_hz=rate)
