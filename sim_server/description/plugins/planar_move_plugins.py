"""Plug-ins that apply the twist to the body: planar move, mecanum, velocity control."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.drive_messages import PlanarMove
from zensim.sim_server.description.plugins.drive_plugin import (
    GZ_ODOMETRY_RATE_HZ,
    GZ_PARAMETERS,
    NUMBER,
    ROS_ALIASES,
    ROS_PARAMETERS,
    ROS_UNUSED,
    DriveParameter,
    DrivePlugin,
)
from zensim.sim_server.description.plugins.wheel_measures import find_base_link

if TYPE_CHECKING:
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

DEFAULT_ODOMETRY_RATE_HZ = 20.0
_GAINS = ("torque_yaw_velocity_p_gain", "force_x_velocity_p_gain", "force_y_velocity_p_gain")
_WHEEL_TAGS = (
    "front_left_joint", "front_right_joint", "back_left_joint", "back_right_joint",
    "wheel_separation", "wheelbase", "wheel_radius",
)  # fmt: skip
_LIMIT_TAGS = (
    "min_velocity", "max_velocity", "min_acceleration", "max_acceleration", "min_jerk", "max_jerk",
)  # fmt: skip


def _summarize(_: PlanarMove) -> str:
    return "the twist is applied to the body, sideways too"


def _make_gz(_: PluginTags, lumped: LumpedModel) -> PlanarMove:
    return PlanarMove(
        update_rate_hz=0.0,
        odometry_rate_hz=GZ_ODOMETRY_RATE_HZ,
        robot_base_frame=find_base_link(lumped),
    )


PLUGINS = (
    DrivePlugin(
        # The second applies forces until the body has the twist; here the twist is set at once.
        filenames=("gazebo_ros_planar_move", "gazebo_ros_force_based_move"),
        drive_type=PlanarMove,
        summarize=_summarize,
        make=lambda *_: PlanarMove(odometry_rate_hz=DEFAULT_ODOMETRY_RATE_HZ),
        parameters=(*ROS_PARAMETERS, DriveParameter("publish_rate", NUMBER, "odometry_rate_hz")),
        aliases=ROS_ALIASES
        | {"odometryRate": "publish_rate", "publishOdometryTf": "publish_odom_tf"},
        unused=ROS_UNUSED
        | {"cmdTimeout": "the agent has its own timeout"}
        | dict.fromkeys(_GAINS, "the twist is applied at once"),
    ),
    DrivePlugin(
        filenames=("mecanum-drive-system", "velocity-control-system"),
        drive_type=PlanarMove,
        summarize=_summarize,
        make=_make_gz,
        parameters=GZ_PARAMETERS,
        unused={
            **dict.fromkeys(_WHEEL_TAGS, "the twist is applied to the body; wheels do not turn"),
            **dict.fromkeys(_LIMIT_TAGS, "the twist is not limited"),
            "tf_topic": "tf is on <namespace>/tf",
        },
    ),
)
