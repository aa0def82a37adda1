"""The drives of Gazebo Classic itself: two or four wheels, as large as the links have them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.drive_messages import DiffDrive, WheelPair
from zensim.sim_server.description.drive_geometry import apart_m, wheels_of
from zensim.sim_server.description.drive_tags import base_of, joint_fault

if TYPE_CHECKING:
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

FILENAMES = ("DiffDrivePlugin", "SkidSteerDrivePlugin")
ALIASES: dict[str, str] = {}
UNUSED: dict[str, str] = {}
LEFT = ("left_joint", "left_front", "left_rear")
RIGHT = ("right_joint", "right_front", "right_rear")
TORQUES = ("torque", "max_force", "MaxForce")
TORQUE_NM = 5.0
LEAST_M = 1e-3


def read_classic_drive(tags: PluginTags, lumped: Lumped) -> DiffDrive | None:
    """Read the plug-in; None, with the reason noted, where its joints or wheels are none.

    Raises:
        ModelError: A torque is no number, or negative.
    """
    left = [name for tag in LEFT for name in tags.texts(tag)]
    right = [name for tag in RIGHT for name in tags.texts(tag)]
    torque = max(tags.number(tag, 0.0) for tag in TORQUES) or TORQUE_NM
    tags.report_unread(UNUSED)
    fault = joint_fault((*left, *right), {joint.name: joint for joint in lumped.joints})
    if not left or len(left) != len(right):
        fault = f"{len(left)} left and {len(right)} right joints; name as many of each"
    pairs = () if fault else tuple(_pair(*names, lumped) for names in zip(left, right, strict=True))
    if not fault and min(min(p.separation_m, p.diameter_m) for p in pairs) < LEAST_M:
        fault = "a wheel has no round collision, or two are in one place"
    if fault:
        tags.report.suspicious(tags.subject, f"no drive: {fault}")
        return None
    return DiffDrive(
        pairs=pairs,
        max_torque_nm=torque,
        robot_base_frame=base_of(lumped),
        publish_odom=True,
        publish_odom_tf=True,
    )


def _pair(left: str, right: str, lumped: Lumped) -> WheelPair:
    wheels = wheels_of((left, right), lumped)
    return WheelPair(left, right, apart_m(*wheels), 2.0 * wheels[0].radius_m)
