"""The differential drive plug-in: its tags, their defaults, and when Gazebo would refuse it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.drive_messages import DiffDrive, WheelPair
from zensim.sim_server.description import drive_tags
from zensim.sim_server.description.drive_tags import check_lengths, joint_fault, with_settings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from zensim.proto.messages.model_messages import Joint
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

FILENAMES = (
    "gazebo_ros_diff_drive",
    "gazebo_ros_skid_steer_drive",
    "gazebo_ros_kobuki",
    "gazebo_ros_create",
)
"""The last two are those of the first two TurtleBots."""
ALIASES = drive_tags.ALIASES | {
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
_NO_SUCH_SENSOR = "its sensors are not simulated"
UNUSED = drive_tags.UNUSED | {
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
        _NO_SUCH_SENSOR,
    ),
}  # fmt: skip


def read_diff_drive(tags: PluginTags, lumped: Lumped) -> DiffDrive | None:
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
    pairs = _pairs(tags, {joint.name: joint for joint in lumped.joints})
    drive = DiffDrive(
        pairs=pairs or (),
        max_torque_nm=tags.number("max_wheel_torque", 5.0),
        max_acceleration=tags.number("max_wheel_acceleration", 0.0),
        publish_odom=is_ros1,
        publish_odom_tf=is_ros1,
    )
    drive = with_settings(drive, tags)
    tags.report_unread(UNUSED)
    return drive if pairs else None


def _pairs(tags: PluginTags, joints: Mapping[str, Joint]) -> tuple[WheelPair, ...] | None:
    count = _pair_count(tags)
    left, right = tags.texts("left_joint"), tags.texts("right_joint")
    separations = tags.positive_numbers("wheel_separation")
    diameters = tags.positive_numbers("wheel_diameter")
    check_lengths(tags, "wheel_separation", separations)
    check_lengths(tags, "wheel_diameter", diameters)
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
    return joint_fault((*left, *right), joints)


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
