"""The differential drive plug-in: its tags, their defaults, and when Gazebo would refuse it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from proto.model import DiffDrive, WheelPair
from proto.names import InvalidName, check_frame

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from proto.model import Joint
    from sim_server.description.plugin_tags import PluginTags

FILENAMES = ("gazebo_ros_diff_drive", "gazebo_ros_skid_steer_drive")
ALIASES = {
    "leftJoint": "left_joint",
    "leftFrontJoint": "left_joint",
    "leftRearJoint": "left_joint",
    "rightJoint": "right_joint",
    "rightFrontJoint": "right_joint",
    "rightRearJoint": "right_joint",
    "wheelSeparation": "wheel_separation",
    "wheelDiameter": "wheel_diameter",
    "wheelTorque": "max_wheel_torque",
    "torque": "max_wheel_torque",
    "wheelAcceleration": "max_wheel_acceleration",
    "updateRate": "update_rate",
    "odometryFrame": "odometry_frame",
    "odometrySource": "odometry_source",
    "robotBaseFrame": "robot_base_frame",
    "publishWheelTF": "publish_wheel_tf",
    "publishOdomTF": "publish_odom_tf",
    "broadcastTF": "publish_odom_tf",
}
"""Spellings of the ROS 1 plug-ins."""
_BY_REMAPPING = "Gazebo does not read it; use <remapping> in <ros>"
UNUSED = {
    "command_topic": _BY_REMAPPING,
    "odometry_topic": _BY_REMAPPING,
    "commandTopic": _BY_REMAPPING,
    "odometryTopic": _BY_REMAPPING,
    "alwaysOn": "drives are always on",
    "always_on": "drives are always on",
    "legacyMode": "left is left: +y",
    "robotNamespace": "the namespace is that of the spawn request",
    "publishWheelJointState": "add the joint_state_publisher plug-in",
    "publishTf": "use <publish_odom_tf>",
    "rosDebugLevel": "of ROS 1",
}
SOURCES: dict[str, Literal["encoder", "world"]] = {
    "0": "encoder",
    "encoder": "encoder",
    "1": "world",
    "world": "world",
}
TURNING = ("continuous", "revolute")


def read_diff_drive(tags: PluginTags, joints: Mapping[str, Joint]) -> DiffDrive | None:
    """Read the plug-in; None, with the reason noted, where Gazebo's would not work.

    Args:
        tags: Of the plug-in.
        joints: Of the robot once lumped, by name.

    Raises:
        ModelError: A number is none, is negative, or a separation or diameter is not positive.
    """
    is_ros1 = tags.is_renamed("left_joint")  # ROS 1 published odometry without being asked
    if is_ros1:
        tags.report.suspicious(tags.subject, "written for ROS 1: odom and its tf are published")
    pairs = _pairs(tags, joints)
    drive = DiffDrive(
        pairs=pairs or (),
        max_torque_nm=tags.number("max_wheel_torque", 5.0),
        max_acceleration=tags.number("max_wheel_acceleration", 0.0),
        update_rate_hz=tags.number("update_rate", 100.0),
        odometry_source=_source(tags),
        odometry_frame=_frame(tags, "odometry_frame", "odom"),
        robot_base_frame=_frame(tags, "robot_base_frame", "base_footprint"),
        publish_odom=tags.flag("publish_odom", default=is_ros1),
        publish_odom_tf=tags.flag("publish_odom_tf", default=is_ros1),
        publish_wheel_tf=tags.flag("publish_wheel_tf", default=False),
        covariance_x=tags.number("covariance_x", 1e-5),
        covariance_y=tags.number("covariance_y", 1e-5),
        covariance_yaw=tags.number("covariance_yaw", 1e-3),
        ros=tags.ros(),
    )
    tags.report_unread(UNUSED)
    return drive if pairs else None


def _pairs(tags: PluginTags, joints: Mapping[str, Joint]) -> tuple[WheelPair, ...] | None:
    count = _pair_count(tags)
    left, right = tags.texts("left_joint"), tags.texts("right_joint")
    separations = tags.positive_numbers("wheel_separation")
    diameters = tags.positive_numbers("wheel_diameter")
    fault = _fault(left, right, count=count, joints=joints)
    if fault:
        tags.report.suspicious(tags.subject, f"no drive: {fault}")
        return None
    return tuple(
        WheelPair(*values)
        for values in zip(
            left,
            right,
            _per_pair(tags, "wheel_separation", separations, count=count, default=0.34),
            _per_pair(tags, "wheel_diameter", diameters, count=count, default=0.15),
            strict=True,
        )
    )


def _pair_count(tags: PluginTags) -> int:
    default = 2.0 if "skid_steer" in tags.filename else 1.0
    count = int(tags.number("num_wheel_pairs", default))
    if count < 1:
        tags.report.suspicious(f"{tags.subject}: <num_wheel_pairs>", f"{count}; taken as 1")
    return max(count, 1)


def _fault(
    left: Sequence[str], right: Sequence[str], *, count: int, joints: Mapping[str, Joint]
) -> str:
    if not len(left) == len(right) == count:
        return f"{len(left)} left and {len(right)} right joints for {count} wheel pair(s)"
    for name in (*left, *right):
        if name not in joints:
            known = ", ".join(list(joints)[:10]) or "none"
            return f"joint {name[:80]!r} does not exist or is fixed; moving joints: {known}"
        if joints[name].kind not in TURNING:
            return f"joint {name!r} is {joints[name].kind}; a wheel's is continuous"
    return "a joint is named twice" if len({*left, *right}) < 2 * count else ""


def _per_pair(
    tags: PluginTags, tag: str, lengths: list[float], *, count: int, default: float
) -> list[float]:
    if len(lengths) > count:
        tags.report.suspicious(
            f"{tags.subject}: <{tag}>", f"{len(lengths)} given for {count} pair(s); rest not read"
        )
    if len(lengths) == 1 and tags.is_renamed(tag):
        return lengths * count  # ROS 1 has one for all pairs
    if len(lengths) < count:
        tags.report.suspicious(
            f"{tags.subject}: <{tag}>", f"not given for every pair; Gazebo's {default} m is used"
        )
    return [*lengths, *[default] * count][:count]


def _source(tags: PluginTags) -> Literal["encoder", "world"]:
    text = tags.text("odometry_source", "1")
    if text.lower() not in SOURCES:
        tags.report.suspicious(
            f"{tags.subject}: <odometry_source>", f"{text[:40]!r} is neither 0 nor 1; taken as 1"
        )
    return SOURCES.get(text.lower(), "world")


def _frame(tags: PluginTags, tag: str, default: str) -> str:
    text = tags.text(tag, default)
    try:
        return check_frame(text.lstrip("/"))
    except InvalidName as error:
        tags.report.suspicious(f"{tags.subject}: <{tag}>", f"{error}; {default!r} is used")
        return default
