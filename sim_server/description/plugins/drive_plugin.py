"""What drive plug-ins share: frames, topics, rates, joints, wheels measured from links."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import msgspec

from zensim.proto.messages.drive_messages import (
    DiffDrive,
    Drive,
    DriveSettings,
    OdometrySource,
    WheelPair,
)
from zensim.proto.messages.model_messages import Joint, Link, Origin, Shape, Vec3
from zensim.proto.names import InvalidName, check_frame, check_namespace
from zensim.proto.rigid_transforms import rotate, transform_point
from zensim.sim_server.description.model_geometry import (
    find_link_poses,
)
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags
    from zensim.sim_server.description.report import ParseReport

LENGTH_TOLERANCE = 0.05
"""Share by which a written length may differ from the measured one."""
MAX_BACKWARD_AXIS_Y = -0.5
"""y of an axis that points to the right rather than the left."""
ROUND_KINDS = ("sphere", "cylinder", "capsule")


class MeasuredWheel(msgspec.Struct, frozen=True):
    """A wheel as the links have it, in the root link, all joints at zero."""

    joint: str
    centre: Vec3
    axis: Vec3
    radius_m: float
    """0 where no collision is round."""


def check_drive(drive: Drive, lumped: LumpedModel, *, subject: str, report: ParseReport) -> None:
    """Note diameters, separations, sides, axes and frames that the robot's links contradict."""
    if isinstance(drive, DiffDrive):
        for pair in drive.pairs:
            left, right = measure_wheels((pair.left_joint, pair.right_joint), lumped)
            for fault in _find_pair_faults(pair, left, right):
                report.suspicious(subject, fault)
    _check_base_frame(drive.robot_base_frame, lumped, subject, report)


def measure_wheels(names: Iterable[str], lumped: LumpedModel) -> list[MeasuredWheel]:
    """Find the wheels that joints move."""
    joints = {joint.name: joint for joint in lumped.joints}
    links = {link.name: link for link in lumped.links}
    poses = find_link_poses(lumped.links[0].name, lumped.joints)
    return [_measure_wheel(joints[name], links, poses) for name in names]


def measure_separation(left: MeasuredWheel, right: MeasuredWheel) -> float:
    """Measure how far two wheels are apart along the axis of the first."""
    across = [a - b for a, b in zip(left.centre, right.centre, strict=True)]
    return abs(sum(part * axis for part, axis in zip(across, left.axis, strict=True)))


def _measure_wheel(
    joint: Joint, links: Mapping[str, Link], poses: Mapping[str, Origin]
) -> MeasuredWheel:
    pose = poses[joint.child]
    tyre = _find_wheel_shape(links[joint.child])
    return MeasuredWheel(
        joint=joint.name,
        centre=transform_point(pose, tyre.origin.position),
        axis=rotate(pose.orientation, joint.axis),
        radius_m=tyre.size[0],
    )


def _find_wheel_shape(link: Link) -> Shape:
    rounds = [shape for shape in link.collisions if shape.kind in ROUND_KINDS]
    return max(rounds, key=lambda shape: shape.size[0], default=Shape("sphere"))


def _find_pair_faults(pair: WheelPair, left: MeasuredWheel, right: MeasuredWheel) -> list[str]:
    faults = []
    for wheel in (left, right):
        measured = 2.0 * wheel.radius_m
        if measured and _lengths_differ(pair.diameter_m, measured):
            faults.append(
                f"wheel_diameter {pair.diameter_m:g} m, but the wheel of {wheel.joint!r} has "
                f"{measured:g} m; used as written"
            )
        if wheel.axis[1] < MAX_BACKWARD_AXIS_Y:
            faults.append(f"the axis of {wheel.joint!r} points to -y: it rolls backward")
    across = [a - b for a, b in zip(left.centre, right.centre, strict=True)]
    apart = measure_separation(left, right)
    if _lengths_differ(pair.separation_m, apart):
        faults.append(
            f"wheel_separation {pair.separation_m:g} m, but {left.joint!r} and {right.joint!r} "
            f"are {apart:g} m apart; used as written"
        )
    if across[1] < 0.0:
        faults.append(f"left_joint {left.joint!r} is on the right side: turns are reversed")
    elif "right" in left.joint.lower() and "left" in right.joint.lower():
        faults.append(f"left_joint is {left.joint!r}, right_joint {right.joint!r}: names swapped?")
    return faults


def _lengths_differ(written: float, measured: float) -> bool:
    return abs(written - measured) > LENGTH_TOLERANCE * measured


def _check_base_frame(frame: str, lumped: LumpedModel, subject: str, report: ParseReport) -> None:
    root = lumped.links[0].name
    if frame == root or frame in {merged.name for merged in lumped.frames if merged.parent == root}:
        return
    named = {link.name for link in lumped.links} | {merged.name for merged in lumped.frames}
    fault = "moves on the root link" if frame in named else "is no link"
    report.suspicious(subject, f"robot_base_frame {frame!r} {fault}; it stands for {root!r}")


DriveKind = TypeVar("DriveKind", bound=DriveSettings)

DRIVE_ALIASES = {
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
UNUSED_DRIVE_TAGS = {
    "alwaysOn": "drives are always on",
    "always_on": "drives are always on",
    "robotNamespace": "the namespace is that of the spawn request",
    "publishWheelJointState": "add the joint_state_publisher plug-in",
    "publish_wheel_joint_state": "add the joint_state_publisher plug-in",
    "publishTf": "use <publish_odom_tf>",
    "rosDebugLevel": "of ROS 1",
}
ODOMETRY_SOURCES: dict[str, OdometrySource] = {
    "0": "encoder",
    "encoder": "encoder",
    "1": "world",
    "world": "world",
}
MIN_LENGTH_M, MAX_LENGTH_M = 1e-6, 1e6
MODEL_FRAME = "__model__"
"""Root of an SDF model whose first link is elsewhere than the model."""
WHEEL_JOINT_KINDS = ("continuous", "revolute")
GRAVITY = 9.81
GZ_ODOMETRY_RATE_HZ = 50.0


def read_drive_settings(drive: DriveKind, tags: PluginTags) -> DriveKind:
    """Read what every drive has; what is not given stays as the drive has it.

    Raises:
        ModelError: A number is none, or is negative.
    """
    return msgspec.structs.replace(
        drive,
        update_rate_hz=tags.number("update_rate", drive.update_rate_hz),
        odometry_source=_read_odometry_source(tags, drive.odometry_source),
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


def find_base_link(lumped: LumpedModel) -> str:
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
        if not MIN_LENGTH_M <= length <= MAX_LENGTH_M:
            raise ModelError(
                f"{tags.subject}, {tag}: {length:g} is no length of a robot; "
                f"write {MIN_LENGTH_M:g} to {MAX_LENGTH_M:g} metres",
                slug=f"drive.{tag}",
            )


def find_joint_fault(names: Iterable[str], joints: Mapping[str, Joint]) -> str:
    """Say why these cannot be turning joints of a drive; empty when they can."""
    seen: set[str] = set()
    for name in names:
        if name not in joints:
            known = ", ".join(list(joints)[:10]) or "none"
            return f"joint {name[:80]!r} does not exist or is fixed; moving joints: {known}"
        if joints[name].kind not in WHEEL_JOINT_KINDS:
            return f"joint {name!r} is {joints[name].kind}; a wheel's is continuous"
        if name in seen:
            return "a joint is named twice"
        seen.add(name)
    return ""


def find_grip_torque(
    lumped: LumpedModel, *, radius_m: float, wheels: int, joints: Iterable[str]
) -> float:
    """Find what a wheel's motor is to give where the plug-in sets no torque.

    It is what the ground can hold of the robot's weight, or less where a joint's limit is lower.
    """
    weight = GRAVITY * sum(link.inertial.mass_kg for link in lumped.links)
    limits = {joint.name: joint.effort for joint in lumped.joints if joint.effort > 0.0}
    return min(weight * radius_m / wheels, *(limits.get(name, weight) for name in joints))


def _read_odometry_source(tags: PluginTags, default: OdometrySource) -> OdometrySource:
    text = tags.text("odometry_source", default)
    if text.lower() not in ODOMETRY_SOURCES:
        tags.report.suspicious(
            f"{tags.subject}: <odometry_source>", f"{text[:40]!r} is neither 0 nor 1; taken as 1"
        )
    return ODOMETRY_SOURCES.get(text.lower(), "world")
