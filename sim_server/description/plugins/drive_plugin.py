"""Drive plug-ins: one row of parameters each, and the wheels as the links have them.

Each family of plug-ins lists its rows in `PLUGINS`; `plugin_registry` joins the lists.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import msgspec

from zensim.proto.messages.drive_messages import Drive, DriveSettings, OdometrySource
from zensim.proto.names import InvalidName, check_frame, check_namespace
from zensim.sim_server.description.plugins.plugin_tags import PluginTags

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.report import ParseReport

SUBSTITUTION = re.compile(r"\$\([^()]*\)|\$\{[^{}]*\}")
"""Argument of a launch file or of xacro."""
DriveT = TypeVar("DriveT", bound=Drive)
ODOMETRY_SOURCES: dict[str, OdometrySource] = {
    "0": "encoder",
    "encoder": "encoder",
    "1": "world",
    "world": "world",
}


class UnusableDrive(ValueError):
    """Joints, wheels or links do not fit the drive; the text is the reason for the report."""


@dataclass(frozen=True)
class DriveParameter:
    """A tag that sets one field of a drive; the field's value so far is the default."""

    tag: str
    read: Callable[[PluginTags, str, Any], object]
    """Called with the tags, the tag's name and the default."""
    field: str = ""
    """Empty: the tag's name."""
    default_field: str = ""
    """The field whose value is the default; empty: `field`."""

    def apply(self, drive: DriveT, tags: PluginTags) -> DriveT:
        """Set the field to the value of the tag."""
        name = self.field or self.tag
        default = getattr(drive, self.default_field or name)
        return msgspec.structs.replace(drive, **{name: self.read(tags, self.tag, default)})


@dataclass(frozen=True, kw_only=True)
class DrivePlugin(Generic[DriveT]):
    """How the plug-ins of one kind are read.

    Attributes:
        filenames: Parts of the plug-in's file name.
        drive_type: The message that is made.
        summarize: Describes a drive in one line.
        make: Makes the drive with the plug-in's defaults; by default those of `drive_type`.
        parameters: Read in this order.
        complete: Sets what depends on joints and links; raises `UnusableDrive`.
        find_faults: Finds contradictions between the drive and the links.
        aliases: Older spellings of tags.
        unused: Known tags without effect, and the reason.
    """

    filenames: tuple[str, ...]
    drive_type: type[DriveT]
    summarize: Callable[[DriveT], str]
    make: Callable[[PluginTags, LumpedModel], DriveT] | None = None
    parameters: tuple[DriveParameter, ...] = ()
    complete: Callable[[DriveT, PluginTags, LumpedModel], DriveT] | None = None
    find_faults: Callable[[DriveT, LumpedModel], Sequence[str]] | None = None
    aliases: Mapping[str, str] = field(default_factory=dict)
    unused: Mapping[str, str] = field(default_factory=dict)

    def read(self, tags: PluginTags, lumped: LumpedModel) -> DriveT | None:
        """Read the drive; None, with the reason in the report, where it is unusable.

        Raises:
            ModelError: A value is not a number or out of range.
        """
        drive = self.make(tags, lumped) if self.make else self.drive_type()
        for parameter in self.parameters:
            drive = parameter.apply(drive, tags)
        try:
            return self.complete(drive, tags, lumped) if self.complete else drive
        except UnusableDrive as fault:
            tags.report.suspicious(tags.subject, f"no drive: {fault}")
            return None
        finally:
            tags.report_unread(self.unused)

    def check(
        self, drive: DriveT, lumped: LumpedModel, *, subject: str, report: ParseReport
    ) -> None:
        """Report where the drive and the links disagree."""
        for fault in self.find_faults(drive, lumped) if self.find_faults else ():
            report.suspicious(subject, fault)
        _check_base_frame(drive, lumped, subject, report)


def _check_base_frame(
    drive: DriveSettings, lumped: LumpedModel, subject: str, report: ParseReport
) -> None:
    frame, root = drive.robot_base_frame, lumped.links[0].name
    if frame == root or frame in {merged.name for merged in lumped.frames if merged.parent == root}:
        return
    named = {link.name for link in lumped.links} | {merged.name for merged in lumped.frames}
    fault = "moves relative to the root link" if frame in named else "is not a link"
    report.suspicious(subject, f"robot_base_frame {frame!r} {fault}; {root!r} is used")


def read_frame(tags: PluginTags, tag: str, default: str) -> str:
    """Read a frame; an invalid name gives the default."""
    # An argument of a launch file is a prefix of frames.
    text = SUBSTITUTION.sub("", tags.text(tag, default))
    try:
        return check_frame(text.lstrip("/"))
    except InvalidName as error:
        tags.report.suspicious(tags.label(tag), f"{error}; {default!r} is used")
        return default


def read_topic(tags: PluginTags, tag: str, default: str) -> str:
    """Read a topic; empty where it is the default or an invalid name."""
    text = tags.text(tag, "").strip("/")
    if text in ("", default):
        return ""
    subject = tags.label(tag)
    try:
        topic = check_namespace(text)
    except InvalidName as error:
        tags.report.suspicious(subject, f"{error}; {default!r} is used")
        return ""
    reason = f"{default} is on <namespace>/{topic}"
    is_extension = tag in EXTENSION_TAGS
    caveat = "; Gazebo and compat gazebo11 ignore this tag" if is_extension else ""
    tags.report.applied(subject, reason + caveat)
    return topic


def _read_odometry_source(tags: PluginTags, tag: str, default: str) -> OdometrySource:
    text = tags.text(tag, default)
    if text.lower() not in ODOMETRY_SOURCES:
        tags.report.suspicious(tags.label(tag), f"{text[:40]!r} is neither 0 nor 1; 1 is used")
    return ODOMETRY_SOURCES.get(text.lower(), "world")


def _read_flag(tags: PluginTags, tag: str, default: object) -> bool:
    return tags.flag(tag, default=bool(default))


def _read_command_topic(tags: PluginTags, tag: str, _: str) -> str:
    return read_topic(tags, tag, "cmd_vel")


def _read_odometry_topic(tags: PluginTags, tag: str, _: str) -> str:
    return read_topic(tags, tag, "odom")


TEXT, NUMBER, LENGTH, FLAG = PluginTags.text, PluginTags.number, PluginTags.length, _read_flag
EXTENSION_TAGS = ("command_topic", "odometry_topic")
"""Tags that Gazebo Classic does not have."""
ROS_PARAMETERS = (
    DriveParameter("update_rate", NUMBER, "update_rate_hz"),
    DriveParameter("odometry_source", _read_odometry_source),
    DriveParameter("odometry_frame", read_frame),
    DriveParameter("robot_base_frame", read_frame),
    DriveParameter("publish_odom", FLAG),
    DriveParameter("publish_odom_tf", FLAG),
    DriveParameter("publish_wheel_tf", FLAG),
    DriveParameter("covariance_x", NUMBER),
    DriveParameter("covariance_y", NUMBER),
    DriveParameter("covariance_yaw", NUMBER),
    DriveParameter("command_topic", _read_command_topic),
    DriveParameter("odometry_topic", _read_odometry_topic),
    DriveParameter("ros", lambda tags, *_: tags.ros()),
)
"""Parameters of the gazebo_ros plug-ins."""
ROS_ALIASES = {
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
ROS_UNUSED = {
    "alwaysOn": "drives are always on",
    "always_on": "drives are always on",
    "robotNamespace": "the namespace is set by the spawn request",
    "publishWheelJointState": "add the joint_state_publisher plug-in",
    "publish_wheel_joint_state": "add the joint_state_publisher plug-in",
    "publishTf": "use <publish_odom_tf>",
    "rosDebugLevel": "ROS 1 only",
}
GZ_ODOMETRY_RATE_HZ = 50.0
GZ_PARAMETERS = (
    # Gazebo Sim's documentation has one spelling of the rate, its code the other.
    DriveParameter("odom_publisher_frequency", NUMBER, "odometry_rate_hz"),
    DriveParameter("odom_publish_frequency", NUMBER, "odometry_rate_hz"),
    DriveParameter("frame_id", read_frame, "odometry_frame"),
    DriveParameter("child_frame_id", read_frame, "robot_base_frame"),
    DriveParameter("topic", _read_command_topic, "command_topic"),
    DriveParameter("odom_topic", _read_odometry_topic, "odometry_topic"),
)
"""Parameters of Gazebo Sim's systems."""
