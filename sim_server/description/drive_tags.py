"""What the plug-ins of all drives have in common: frames, topics, rates, joints, motors."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import msgspec

from zensim.proto.messages.drive_messages import DriveSettings, OdometrySource
from zensim.proto.names import InvalidName, check_frame, check_namespace
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from zensim.proto.messages.model_messages import Joint
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

DriveKind = TypeVar("DriveKind", bound=DriveSettings)

ALIASES = {
    "commandTopic": "command_topic",
    "topicName": "command_topic",
    "odometryTopic": "odometry_topic",
    "updateRate": "update_rate",
    "odometryFrame": "odometry_frame",
    "odometrySource": "odometry_source",
    "robotBaseFrame": "robot_base_frame",
    "publishWheelTF": "publish_wheel_tf",
    "publishOdomTF": "publish_odom_tf",
    "broadcastTF": "publish_odom_tf",
}
"""Spellings of the ROS 1 plug-ins."""
UNUSED = {
    "alwaysOn": "drives are always on",
    "always_on": "drives are always on",
    "robotNamespace": "the namespace is that of the spawn request",
    "publishWheelJointState": "add the joint_state_publisher plug-in",
    "publish_wheel_joint_state": "add the joint_state_publisher plug-in",
    "publishTf": "use <publish_odom_tf>",
    "rosDebugLevel": "of ROS 1",
}
SOURCES: dict[str, OdometrySource] = {
    "0": "encoder",
    "encoder": "encoder",
    "1": "world",
    "world": "world",
}
LEAST_M, MOST_M = 1e-6, 1e6
MODEL_FRAME = "__model__"
"""Root of an SDF model whose first link is elsewhere than the model."""
TURNING = ("continuous", "revolute")
GRAVITY = 9.81
GZ_ODOMETRY_RATE_HZ = 50.0


def with_settings(drive: DriveKind, tags: PluginTags) -> DriveKind:
    """Read what every drive has; what is not given stays as the drive has it.

    Raises:
        ModelError: A number is none, or is negative.
    """
    return msgspec.structs.replace(
        drive,
        update_rate_hz=tags.number("update_rate", drive.update_rate_hz),
        odometry_source=_source(tags, drive.odometry_source),
        odometry_frame=read_frame(tags, "odometry_frame", drive.odometry_frame),
        robot_base_frame=read_frame(tags, "robot_base_frame", drive.robot_base_frame),
        publish_odom=tags.flag("publish_odom", default=drive.publish_odom),
        publish_odom_tf=tags.flag("publish_odom_tf", default=drive.publish_odom_tf),
        publish_wheel_tf=tags.flag("publish_wheel_tf", default=drive.publish_wheel_tf),
        covariance_x=tags.number("covariance_x", drive.covariance_x),
        covariance_y=tags.number("covariance_y", drive.covariance_y),
        covariance_yaw=tags.number("covariance_yaw", drive.covariance_yaw),
        command_topic=read_topic(tags, "command_topic", "cmd_vel"),
        odometry_topic=read_topic(tags, "odometry_topic", "odom"),
        ros=tags.ros(),
    )


def read_topic(tags: PluginTags, tag: str, usual: str, *, is_new: bool = True) -> str:
    """Read a topic; empty where it is the usual one, or no name.

    Args:
        tags: Of the plug-in.
        tag: Its tag.
        usual: Where the topic is when nothing is said.
        is_new: Gazebo Classic does not read the tag.
    """
    text = tags.text(tag, "").strip("/")
    if text in ("", usual):
        return ""
    subject = f"{tags.subject}: <{tag}>"
    try:
        topic = check_namespace(text)
    except InvalidName as error:
        tags.report.suspicious(subject, f"{error}; {usual!r} is used")
        return ""
    reason = f"{usual} is on <namespace>/{topic}"
    caveat = "; Gazebo does not read it, nor is it read with compat gazebo11"
    tags.report.applied(subject, reason + caveat if is_new else reason)
    return topic


def read_frame(tags: PluginTags, tag: str, default: str) -> str:
    """Read a frame; the default where it is no name."""
    text = tags.text(tag, default)
    try:
        return check_frame(text.lstrip("/"))
    except InvalidName as error:
        tags.report.suspicious(f"{tags.subject}: <{tag}>", f"{error}; {default!r} is used")
        return default


def read_odometry_rate(tags: PluginTags) -> float:
    """Read how often [Hz] Gazebo Sim's drives publish odometry; both spellings are about.

    Raises:
        ModelError: It is no number, or negative.
    """
    rate = tags.number("odom_publisher_frequency", GZ_ODOMETRY_RATE_HZ)
    return tags.number("odom_publish_frequency", rate)


def base_of(lumped: Lumped) -> str:
    """Name the link that a robot's base is: its root, or what hangs fixed from a model's frame."""
    root = lumped.links[0].name
    held = (frame.name for frame in lumped.frames if frame.parent == root)
    return next(held, root) if root == MODEL_FRAME else root


def check_lengths(tags: PluginTags, tag: str, lengths: Iterable[float]) -> None:
    """Check lengths [m] that wheels can have: others give speeds that no number holds.

    Raises:
        ModelError: One is below a micrometre or above a thousand kilometres.
    """
    for length in lengths:
        if not LEAST_M <= length <= MOST_M:
            raise ModelError(
                f"{tags.subject}, {tag}: {length:g} is no length of a robot; "
                f"write {LEAST_M:g} to {MOST_M:g} metres",
                slug=f"drive.{tag}",
            )


def joint_fault(names: Iterable[str], joints: Mapping[str, Joint]) -> str:
    """Say why these cannot be turning joints of a drive; empty when they can."""
    seen: set[str] = set()
    for name in names:
        if name not in joints:
            known = ", ".join(list(joints)[:10]) or "none"
            return f"joint {name[:80]!r} does not exist or is fixed; moving joints: {known}"
        if joints[name].kind not in TURNING:
            return f"joint {name!r} is {joints[name].kind}; a wheel's is continuous"
        if name in seen:
            return "a joint is named twice"
        seen.add(name)
    return ""


def grip_nm(lumped: Lumped, *, radius_m: float, wheels: int, joints: Iterable[str]) -> float:
    """Find what a wheel's motor is to give where the plug-in sets no torque.

    It is what the ground can hold of the robot's weight, or less where a joint's limit is lower.
    """
    weight = GRAVITY * sum(link.inertial.mass_kg for link in lumped.links)
    limits = {joint.name: joint.effort for joint in lumped.joints if joint.effort > 0.0}
    return min(weight * radius_m / wheels, *(limits.get(name, weight) for name in joints))


def _source(tags: PluginTags, default: OdometrySource) -> OdometrySource:
    text = tags.text("odometry_source", default)
    if text.lower() not in SOURCES:
        tags.report.suspicious(
            f"{tags.subject}: <odometry_source>", f"{text[:40]!r} is neither 0 nor 1; taken as 1"
        )
    return SOURCES.get(text.lower(), "world")
