"""Differential and skid-steer drive plug-ins of ROS, Gazebo Classic and Gazebo Sim."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import DiffDrive, Limits, WheelPair
from zensim.sim_server.description.plugins.drive_plugin import (
    GZ_ODOMETRY_RATE_HZ,
    GZ_PARAMETERS,
    NUMBER,
    ROS_ALIASES,
    ROS_PARAMETERS,
    ROS_UNUSED,
    DriveParameter,
    DrivePlugin,
    UnusableDrive,
)
from zensim.sim_server.description.plugins.wheel_measures import (
    MeasuredWheel,
    check_lengths,
    check_sides,
    check_wheel_joints,
    find_base_link,
    find_diameter_faults,
    find_distance_faults,
    find_grip_torque,
    measure_separation,
    measure_wheels,
    rolls_backward,
)

if TYPE_CHECKING:
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

LEFT_JOINT_TAGS = ("left_joint", "left_front", "left_rear")
RIGHT_JOINT_TAGS = ("right_joint", "right_front", "right_rear")
TORQUE_TAGS = ("torque", "max_force", "MaxForce")
MIN_WHEEL_LENGTH_M = 1e-3
DEFAULT_SEPARATION_M, DEFAULT_DIAMETER_M = 0.34, 0.15
"""Defaults of the ROS plug-in."""
GZ_SEPARATION_M, GZ_RADIUS_M = 1.0, 0.2
_SENSOR_TAGS = (
    "base_geom", "bumper_name", "cliff_detection_threshold", "cliff_sensor_center_name",
    "cliff_sensor_left_name", "cliff_sensor_right_name", "imu_name",
)  # fmt: skip
_JERK_TAGS = (
    "min_jerk", "max_jerk", "min_linear_jerk", "max_linear_jerk", "min_angular_jerk",
    "max_angular_jerk",
)  # fmt: skip


def summarize_pairs(drive: DiffDrive) -> str:
    """Describe the wheel pairs in one line."""
    return "; ".join(
        f"{pair.left_joint} and {pair.right_joint}, separation {pair.separation_m:g} m, "
        f"diameter {pair.diameter_m:g} m"
        for pair in drive.pairs
    )


def find_pair_faults(drive: DiffDrive, lumped: LumpedModel) -> list[str]:
    """Find where the wheel pairs and the links disagree."""
    return [
        fault
        for pair in drive.pairs
        for fault in _find_faults(
            pair, *measure_wheels((pair.left_joint, pair.right_joint), lumped)
        )
    ]


def _find_faults(pair: WheelPair, left: MeasuredWheel, right: MeasuredWheel) -> list[str]:
    faults = []
    for wheel in (left, right):
        faults += find_diameter_faults("wheel_diameter", pair.diameter_m, (wheel,))
        if rolls_backward(wheel):
            faults.append(f"the axis of {wheel.joint!r} points to -y: it rolls backward")
    faults += find_distance_faults("wheel_separation", pair.separation_m, left, right)
    if left.centre[1] < right.centre[1]:
        faults.append(f"left_joint {left.joint!r} is on the right side: turns are reversed")
    elif "right" in left.joint.lower() and "left" in right.joint.lower():
        faults.append(f"left_joint is {left.joint!r}, right_joint {right.joint!r}: names swapped?")
    return faults


def _make_ros(tags: PluginTags, _: LumpedModel) -> DiffDrive:
    is_ros1 = tags.is_renamed("left_joint")
    if is_ros1:  # there, odometry is published by default
        tags.report.suspicious(tags.subject, "written for ROS 1: odom and its tf are published")
    return DiffDrive(publish_odom=is_ros1, publish_odom_tf=is_ros1)


def _read_ros_pairs(drive: DiffDrive, tags: PluginTags, lumped: LumpedModel) -> DiffDrive:
    count = _read_pair_count(tags)
    left, right = tags.texts("left_joint"), tags.texts("right_joint")
    separations = tags.positive_numbers("wheel_separation")
    diameters = tags.positive_numbers("wheel_diameter")
    check_lengths(tags, "wheel_separation", separations)
    check_lengths(tags, "wheel_diameter", diameters)
    if not len(left) == len(right) == count:
        raise UnusableDrive(
            f"{len(left)} left and {len(right)} right joints for {count} wheel pair(s)"
        )
    check_wheel_joints((*left, *right), lumped)
    separations = _repeat_for_pairs(
        tags, "wheel_separation", separations, count=count, default=DEFAULT_SEPARATION_M
    )
    diameters = _repeat_for_pairs(
        tags, "wheel_diameter", diameters, count=count, default=DEFAULT_DIAMETER_M
    )
    pairs = map(WheelPair, left, right, separations, diameters)
    return msgspec.structs.replace(drive, pairs=tuple(pairs))


def _read_pair_count(tags: PluginTags) -> int:
    default = 2.0 if "skid_steer" in tags.filename else 1.0
    count = int(tags.number("num_wheel_pairs", default))
    if count < 1:
        tags.report.suspicious(tags.label("num_wheel_pairs"), f"{count}; 1 is used")
    return max(count, 1)


def _repeat_for_pairs(
    tags: PluginTags, tag: str, lengths: list[float], *, count: int, default: float
) -> list[float]:
    if len(lengths) > count:
        tags.report.suspicious(
            tags.label(tag), f"{len(lengths)} values for {count} pair(s); rest not read"
        )
    if len(lengths) == 1 and tags.is_renamed(tag):
        return lengths * count  # ROS 1 has one for all pairs
    if len(lengths) < count:
        tags.report.suspicious(
            tags.label(tag), f"missing for a pair; Gazebo's default {default} m is used"
        )
    return [*lengths, *[default] * count][:count]


def _make_classic(tags: PluginTags, lumped: LumpedModel) -> DiffDrive:
    torque = max(tags.number(tag, 0.0) for tag in TORQUE_TAGS) or DiffDrive().max_torque_nm
    return DiffDrive(
        max_torque_nm=torque,
        robot_base_frame=find_base_link(lumped),
        publish_odom=True,
        publish_odom_tf=True,
    )


def _measure_classic_pairs(drive: DiffDrive, tags: PluginTags, lumped: LumpedModel) -> DiffDrive:
    left = [name for tag in LEFT_JOINT_TAGS for name in tags.texts(tag)]
    right = [name for tag in RIGHT_JOINT_TAGS for name in tags.texts(tag)]
    check_sides(left, right)
    check_wheel_joints((*left, *right), lumped)
    pairs = []
    for names in zip(left, right, strict=True):
        wheels = measure_wheels(names, lumped)
        separation, diameter = measure_separation(*wheels), 2.0 * wheels[0].radius_m
        if min(separation, diameter) < MIN_WHEEL_LENGTH_M:
            raise UnusableDrive("a wheel has no round collision, or two wheels are in one place")
        pairs.append(WheelPair(*names, separation, diameter))
    return msgspec.structs.replace(drive, pairs=tuple(pairs))


def _make_gz(_: PluginTags, lumped: LumpedModel) -> DiffDrive:
    return DiffDrive(
        update_rate_hz=0.0,
        odometry_rate_hz=GZ_ODOMETRY_RATE_HZ,
        odometry_source="encoder",
        robot_base_frame=find_base_link(lumped),
        publish_odom=True,
        publish_odom_tf=True,
    )


def _read_gz_pairs(drive: DiffDrive, tags: PluginTags, lumped: LumpedModel) -> DiffDrive:
    left, right = tags.texts("left_joint"), tags.texts("right_joint")
    separation = tags.length("wheel_separation", GZ_SEPARATION_M)
    radius = tags.length("wheel_radius", GZ_RADIUS_M)
    check_lengths(tags, "wheel_separation", (separation,))
    check_lengths(tags, "wheel_radius", (radius,))
    drive = msgspec.structs.replace(
        drive,
        linear_limits=_read_limits(tags, "linear"),
        angular_limits=_read_limits(tags, "angular"),
    )
    check_sides(left, right)
    check_wheel_joints((*left, *right), lumped)
    torque = find_grip_torque(lumped, radius_m=radius, wheels=len(left), joints=(*left, *right))
    pairs = (WheelPair(*names, separation, 2.0 * radius) for names in zip(left, right, strict=True))
    return msgspec.structs.replace(drive, pairs=tuple(pairs), max_torque_nm=torque)


def _read_limits(tags: PluginTags, part: str) -> Limits:
    def limit(bound: str, quantity: str) -> float | None:
        own = tags.signed(f"{bound}_{part}_{quantity}")
        return tags.signed(f"{bound}_{quantity}") if own is None else own

    return Limits(
        limit("min", "velocity"),
        limit("max", "velocity"),
        limit("min", "acceleration"),
        limit("max", "acceleration"),
    )


PLUGINS = (
    DrivePlugin(
        filenames=(
            "gazebo_ros_diff_drive",
            "gazebo_ros_skid_steer_drive",
            "gazebo_ros_kobuki",  # the last two are those of TurtleBot 2 and TurtleBot 1
            "gazebo_ros_create",
        ),
        drive_type=DiffDrive,
        summarize=summarize_pairs,
        make=_make_ros,
        parameters=(
            *ROS_PARAMETERS,
            DriveParameter("max_wheel_torque", NUMBER, "max_torque_nm"),
            DriveParameter("max_wheel_acceleration", NUMBER, "max_acceleration"),
        ),
        complete=_read_ros_pairs,
        find_faults=find_pair_faults,
        aliases=ROS_ALIASES
        | {
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
        },
        unused=ROS_UNUSED
        | {
            "node_namespace": "the namespace is set by the spawn request",
            "velocity_command_timeout": "the agent has its own timeout",
        }
        | dict.fromkeys(("legacyMode", "legacy_mode"), "left is +y")
        | dict.fromkeys(("front_castor_joint", "rear_castor_joint"), "castors roll passively")
        | dict.fromkeys(_SENSOR_TAGS, "its sensors are not simulated"),
    ),
    DrivePlugin(
        filenames=("DiffDrivePlugin", "SkidSteerDrivePlugin"),
        drive_type=DiffDrive,
        summarize=summarize_pairs,
        make=_make_classic,
        complete=_measure_classic_pairs,
        find_faults=find_pair_faults,
    ),
    DrivePlugin(
        filenames=("diff-drive-system",),
        drive_type=DiffDrive,
        summarize=summarize_pairs,
        make=_make_gz,
        parameters=GZ_PARAMETERS,
        complete=_read_gz_pairs,
        find_faults=find_pair_faults,
        unused={
            "tf_topic": "tf is on <namespace>/tf",
            **dict.fromkeys(_JERK_TAGS, "jerk is not limited"),
        },
    ),
)
