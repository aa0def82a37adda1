"""Differential and skid-steer drive plug-ins of ROS, Gazebo Classic and Gazebo Sim."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.drive_messages import DiffDrive, Limits, WheelPair
from zensim.sim_server.description.plugins import drive_plugin
from zensim.sim_server.description.plugins.drive_plugin import (
    check_lengths,
    find_base_link,
    find_grip_torque,
    find_joint_fault,
    measure_separation,
    measure_wheels,
    read_drive_settings,
    read_frame,
    read_odometry_rate,
    read_topic,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from zensim.proto.messages.model_messages import Joint
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

CLASSIC_DRIVE_FILENAMES = ("DiffDrivePlugin", "SkidSteerDrivePlugin")
CLASSIC_DRIVE_ALIASES: dict[str, str] = {}
UNUSED_CLASSIC_DRIVE_TAGS: dict[str, str] = {}
LEFT_JOINT_TAGS = ("left_joint", "left_front", "left_rear")
RIGHT_JOINT_TAGS = ("right_joint", "right_front", "right_rear")
TORQUE_TAGS = ("torque", "max_force", "MaxForce")
DEFAULT_TORQUE_NM = 5.0
MIN_WHEEL_LENGTH_M = 1e-3


def read_classic_drive(tags: PluginTags, lumped: LumpedModel) -> DiffDrive | None:
    """Read the plug-in; None, with the reason noted, where its joints or wheels are none.

    Raises:
        ModelError: A torque is no number, or negative.
    """
    left = [name for tag in LEFT_JOINT_TAGS for name in tags.texts(tag)]
    right = [name for tag in RIGHT_JOINT_TAGS for name in tags.texts(tag)]
    torque = max(tags.number(tag, 0.0) for tag in TORQUE_TAGS) or DEFAULT_TORQUE_NM
    tags.report_unread(UNUSED_CLASSIC_DRIVE_TAGS)
    fault = find_joint_fault((*left, *right), {joint.name: joint for joint in lumped.joints})
    if not left or len(left) != len(right):
        fault = f"{len(left)} left and {len(right)} right joints; name as many of each"
    pairs = (
        ()
        if fault
        else tuple(_measure_pair(*names, lumped) for names in zip(left, right, strict=True))
    )
    if not fault and min(min(p.separation_m, p.diameter_m) for p in pairs) < MIN_WHEEL_LENGTH_M:
        fault = "a wheel has no round collision, or two are in one place"
    if fault:
        tags.report.suspicious(tags.subject, f"no drive: {fault}")
        return None
    return DiffDrive(
        pairs=pairs,
        max_torque_nm=torque,
        robot_base_frame=find_base_link(lumped),
        publish_odom=True,
        publish_odom_tf=True,
    )


def _measure_pair(left: str, right: str, lumped: LumpedModel) -> WheelPair:
    wheels = measure_wheels((left, right), lumped)
    return WheelPair(left, right, measure_separation(*wheels), 2.0 * wheels[0].radius_m)


DIFF_DRIVE_FILENAMES = (
    "gazebo_ros_diff_drive",
    "gazebo_ros_skid_steer_drive",
    "gazebo_ros_kobuki",
    "gazebo_ros_create",
)
"""The last two are those of the first two TurtleBots."""
DIFF_DRIVE_ALIASES = drive_plugin.DRIVE_ALIASES | {
    "leftJoint": "left_joint",
    "left_wheel_joint": "left_joint",
    "left_wheel_joint_name": "left_joint",
    "leftFrontJoint": "left_joint",
    "leftRearJoint": "left_joint",
    "rightJoint": "right_joint",
    "right_wheel_joint": "right_joint",
    "right_wheel_joint_name": "right_joint",
    "rightFrontJoint": "right_joint",
    "rightRearJoint": "right_joint",
    "wheelSeparation": "wheel_separation",
    "wheelDiameter": "wheel_diameter",
    "wheelTorque": "max_wheel_torque",
    "torque": "max_wheel_torque",
    "wheelAcceleration": "max_wheel_acceleration",
    "publish_tf": "publish_odom_tf",
}
"""Spellings of the ROS 1 plug-ins."""
_SENSORS_NOT_SIMULATED = "its sensors are not simulated"
UNUSED_DIFF_DRIVE_TAGS = drive_plugin.UNUSED_DRIVE_TAGS | {
    "legacyMode": "left is left: +y",
    "legacy_mode": "left is left: +y",
    "node_namespace": "the namespace is that of the spawn request",
    "velocity_command_timeout": "the agent has a timeout of its own",
    "front_castor_joint": "its castors roll by themselves",
    "rear_castor_joint": "its castors roll by themselves",
    **dict.fromkeys(
        (
            "base_geom", "bumper_name", "cliff_detection_threshold", "cliff_sensor_center_name",
            "cliff_sensor_left_name", "cliff_sensor_right_name", "imu_name",
        ),
        _SENSORS_NOT_SIMULATED,
    ),
}  # fmt: skip


def read_diff_drive(tags: PluginTags, lumped: LumpedModel) -> DiffDrive | None:
    """Read the plug-in; None, with the reason noted, where Gazebo's would not work.

    Args:
        tags: Of the plug-in.
        lumped: The robot.

    Raises:
        ModelError: A number is none, is negative, or a separation or diameter is not positive.
    """
    is_ros1 = tags.is_renamed("left_joint")  # ROS 1 published odometry without being asked
    if is_ros1:
        tags.report.suspicious(tags.subject, "written for ROS 1: odom and its tf are published")
    pairs = _read_pairs(tags, {joint.name: joint for joint in lumped.joints})
    drive = DiffDrive(
        pairs=pairs or (),
        max_torque_nm=tags.number("max_wheel_torque", 5.0),
        max_acceleration=tags.number("max_wheel_acceleration", 0.0),
        publish_odom=is_ros1,
        publish_odom_tf=is_ros1,
    )
    drive = read_drive_settings(drive, tags)
    tags.report_unread(UNUSED_DIFF_DRIVE_TAGS)
    return drive if pairs else None


def _read_pairs(tags: PluginTags, joints: Mapping[str, Joint]) -> tuple[WheelPair, ...] | None:
    count = _read_pair_count(tags)
    left, right = tags.texts("left_joint"), tags.texts("right_joint")
    separations = tags.positive_numbers("wheel_separation")
    diameters = tags.positive_numbers("wheel_diameter")
    check_lengths(tags, "wheel_separation", separations)
    check_lengths(tags, "wheel_diameter", diameters)
    fault = _find_pair_fault(left, right, count=count, joints=joints)
    if fault:
        tags.report.suspicious(tags.subject, f"no drive: {fault}")
        return None
    return tuple(
        WheelPair(*values)
        for values in zip(
            left,
            right,
            _expand_to_pairs(tags, "wheel_separation", separations, count=count, default=0.34),
            _expand_to_pairs(tags, "wheel_diameter", diameters, count=count, default=0.15),
            strict=True,
        )
    )


def _read_pair_count(tags: PluginTags) -> int:
    default = 2.0 if "skid_steer" in tags.filename else 1.0
    count = int(tags.number("num_wheel_pairs", default))
    if count < 1:
        tags.report.suspicious(f"{tags.subject}: <num_wheel_pairs>", f"{count}; taken as 1")
    return max(count, 1)


def _find_pair_fault(
    left: Sequence[str], right: Sequence[str], *, count: int, joints: Mapping[str, Joint]
) -> str:
    if not len(left) == len(right) == count:
        return f"{len(left)} left and {len(right)} right joints for {count} wheel pair(s)"
    return find_joint_fault((*left, *right), joints)


def _expand_to_pairs(
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


GZ_DIFF_DRIVE_FILENAMES = ("diff-drive-system",)
GZ_DIFF_DRIVE_ALIASES: dict[str, str] = {}
_JERK_NOT_LIMITED = "change of acceleration is not limited here"
UNUSED_GZ_DIFF_DRIVE_TAGS = {
    "tf_topic": "tf is on <namespace>/tf",
    "min_jerk": _JERK_NOT_LIMITED,
    "max_jerk": _JERK_NOT_LIMITED,
    "min_linear_jerk": _JERK_NOT_LIMITED,
    "max_linear_jerk": _JERK_NOT_LIMITED,
    "min_angular_jerk": _JERK_NOT_LIMITED,
    "max_angular_jerk": _JERK_NOT_LIMITED,
}
DEFAULT_SEPARATION_M = 1.0
DEFAULT_RADIUS_M = 0.2


def read_gz_diff_drive(tags: PluginTags, lumped: LumpedModel) -> DiffDrive | None:
    """Read the plug-in; None, with the reason noted, where its joints are inconsistent.

    Raises:
        ModelError: A number is none, is negative, or a length is not positive.
    """
    left, right = tags.texts("left_joint"), tags.texts("right_joint")
    separation = tags.length("wheel_separation", DEFAULT_SEPARATION_M)
    radius = tags.length("wheel_radius", DEFAULT_RADIUS_M)
    check_lengths(tags, "wheel_separation", (separation,))
    check_lengths(tags, "wheel_radius", (radius,))
    fault = find_joint_fault((*left, *right), {joint.name: joint for joint in lumped.joints})
    if not left or len(left) != len(right):
        fault = f"{len(left)} left and {len(right)} right joints; name as many of each"
    wheels = [WheelPair(*names, separation, 2.0 * radius) for names in zip(left, right)]  # noqa: B905 - the fault says so
    drive = DiffDrive(
        pairs=tuple(wheels),
        max_torque_nm=find_grip_torque(
            lumped, radius_m=radius, wheels=max(len(left), 1), joints=(*left, *right)
        ),
        update_rate_hz=0.0,
        odometry_rate_hz=read_odometry_rate(tags),
        odometry_source="encoder",
        odometry_frame=read_frame(tags, "frame_id", "odom"),
        robot_base_frame=read_frame(tags, "child_frame_id", find_base_link(lumped)),
        publish_odom=True,
        publish_odom_tf=True,
        linear_limits=_read_limits(tags, "linear"),
        angular_limits=_read_limits(tags, "angular"),
        command_topic=read_topic(tags, "topic", "cmd_vel", is_new=False),
        odometry_topic=read_topic(tags, "odom_topic", "odom", is_new=False),
    )
    tags.report_unread(UNUSED_GZ_DIFF_DRIVE_TAGS)
    if fault:
        tags.report.suspicious(tags.subject, f"no drive: {fault}")
        return None
    return drive


def _read_limits(tags: PluginTags, part: str) -> Limits:
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
