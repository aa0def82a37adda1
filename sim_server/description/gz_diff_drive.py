"""The differential drive of Gazebo Sim: as that of Gazebo Classic, with limits of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.drive_messages import DiffDrive, Limits, WheelPair
from zensim.sim_server.description.drive_tags import (
    base_of,
    check_lengths,
    grip_nm,
    joint_fault,
    read_frame,
    read_odometry_rate,
    read_topic,
)

if TYPE_CHECKING:
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

FILENAMES = ("diff-drive-system",)
ALIASES: dict[str, str] = {}
_NO_JERK = "change of acceleration is not limited here"
UNUSED = {
    "tf_topic": "tf is on <namespace>/tf",
    "min_jerk": _NO_JERK,
    "max_jerk": _NO_JERK,
    "min_linear_jerk": _NO_JERK,
    "max_linear_jerk": _NO_JERK,
    "min_angular_jerk": _NO_JERK,
    "max_angular_jerk": _NO_JERK,
}
SEPARATION_M = 1.0
RADIUS_M = 0.2


def read_gz_diff_drive(tags: PluginTags, lumped: Lumped) -> DiffDrive | None:
    """Read the plug-in; None, with the reason noted, where its joints are inconsistent.

    Raises:
        ModelError: A number is none, is negative, or a length is not positive.
    """
    left, right = tags.texts("left_joint"), tags.texts("right_joint")
    separation = tags.length("wheel_separation", SEPARATION_M)
    radius = tags.length("wheel_radius", RADIUS_M)
    check_lengths(tags, "wheel_separation", (separation,))
    check_lengths(tags, "wheel_radius", (radius,))
    fault = joint_fault((*left, *right), {joint.name: joint for joint in lumped.joints})
    if not left or len(left) != len(right):
        fault = f"{len(left)} left and {len(right)} right joints; name as many of each"
    wheels = [WheelPair(*names, separation, 2.0 * radius) for names in zip(left, right)]  # noqa: B905 - the fault says so
    drive = DiffDrive(
        pairs=tuple(wheels),
        max_torque_nm=grip_nm(
            lumped, radius_m=radius, wheels=max(len(left), 1), joints=(*left, *right)
        ),
        update_rate_hz=0.0,
        odometry_rate_hz=read_odometry_rate(tags),
        odometry_source="encoder",
        odometry_frame=read_frame(tags, "frame_id", "odom"),
        robot_base_frame=read_frame(tags, "child_frame_id", base_of(lumped)),
        publish_odom=True,
        publish_odom_tf=True,
        linear_limits=_limits(tags, "linear"),
        angular_limits=_limits(tags, "angular"),
        command_topic=read_topic(tags, "topic", "cmd_vel", is_new=False),
        odometry_topic=read_topic(tags, "odom_topic", "odom", is_new=False),
    )
    tags.report_unread(UNUSED)
    if fault:
        tags.report.suspicious(tags.subject, f"no drive: {fault}")
        return None
    return drive


def _limits(tags: PluginTags, part: str) -> Limits:
    def limit(bound: str, quantity: str) -> float | None:
        # What is said of both parts of the twist holds where nothing is said of this one.
        own, of_both = f"{bound}_{part}_{quantity}", f"{bound}_{quantity}"
        found = tags.signed(own)
        return tags.signed(of_both) if found is None else found

    return Limits(
        limit("min", "velocity"),
        limit("max", "velocity"),
        limit("min", "acceleration"),
        limit("max", "acceleration"),
    )
