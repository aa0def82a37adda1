"""Model plug-ins by file name: read, known but unused, or unknown."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import msgspec

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import GroundTruth, JointStatePublisher
from zensim.sim_server.description.model_geometry import describe_contacts
from zensim.sim_server.description.model_printer import summarize_drive
from zensim.sim_server.description.plugins import (
    diff_drive_plugins,
    planar_move_plugins,
    publisher_plugins,
    steered_drive_plugins,
)
from zensim.sim_server.description.plugins.drive_plugin import check_drive
from zensim.sim_server.description.plugins.plugin_tags import PluginTags

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.report import ParseReport

MAX_PLUGINS = 100
_ROS_CONTROL = "ros_control is not used here; wheels are driven by the diff_drive plug-in"
_NOT_SIMULATED = "not simulated"
UNUSED_PLUGINS = {
    "gazebo_ros_control": _ROS_CONTROL,
    "gazebo_ros2_control": _ROS_CONTROL,
    "gz_ros2_control": _ROS_CONTROL,
    "ign_ros2_control": _ROS_CONTROL,
    "gazebo_ros_ft_sensor": _NOT_SIMULATED,
    "gazebo_ros_joint_pose_trajectory": _NOT_SIMULATED,
    "ackermann-steering-system": _NOT_SIMULATED,
    "odometry-publisher-system": "odometry is that of the drive",
    "pose-publisher-system": "true poses are on the snapshot",
    "sensors-system": "sensors need no plug-in of their own",
    "imu-system": "sensors need no plug-in of their own",
    "contact-system": "sensors need no plug-in of their own",
}
"""Plug-ins that are known, by part of their file name, and why they have no effect."""


class RobotPlugins(msgspec.Struct, frozen=True):
    """What the plug-ins of a robot come to."""

    drive: Drive | None = None
    joint_state: JointStatePublisher | None = None
    ground_truths: tuple[GroundTruth, ...] = ()


class DrivePluginReader(NamedTuple):
    """How one kind of drive is read."""

    filenames: tuple[str, ...]
    aliases: Mapping[str, str]
    read: Callable[[PluginTags, LumpedModel], Drive | None]


DRIVE_READERS = (
    DrivePluginReader(
        diff_drive_plugins.DIFF_DRIVE_FILENAMES,
        diff_drive_plugins.DIFF_DRIVE_ALIASES,
        diff_drive_plugins.read_diff_drive,
    ),
    DrivePluginReader(
        planar_move_plugins.PLANAR_MOVE_FILENAMES,
        planar_move_plugins.PLANAR_MOVE_ALIASES,
        planar_move_plugins.read_planar_move,
    ),
    DrivePluginReader(
        steered_drive_plugins.ACKERMANN_FILENAMES,
        steered_drive_plugins.ACKERMANN_ALIASES,
        steered_drive_plugins.read_ackermann,
    ),
    DrivePluginReader(
        steered_drive_plugins.TRICYCLE_FILENAMES,
        steered_drive_plugins.TRICYCLE_ALIASES,
        steered_drive_plugins.read_tricycle,
    ),
    DrivePluginReader(
        diff_drive_plugins.CLASSIC_DRIVE_FILENAMES,
        diff_drive_plugins.CLASSIC_DRIVE_ALIASES,
        diff_drive_plugins.read_classic_drive,
    ),
    DrivePluginReader(
        diff_drive_plugins.GZ_DIFF_DRIVE_FILENAMES,
        diff_drive_plugins.GZ_DIFF_DRIVE_ALIASES,
        diff_drive_plugins.read_gz_diff_drive,
    ),
    DrivePluginReader(
        planar_move_plugins.GZ_BODY_FILENAMES,
        planar_move_plugins.GZ_BODY_ALIASES,
        planar_move_plugins.read_gz_body_drive,
    ),
)


def read_plugins(
    plugins: Iterable[Element], lumped: LumpedModel, report: ParseReport
) -> RobotPlugins:
    """Read the plug-ins of a robot; the first of a kind counts.

    Raises:
        ModelError: A number in one is none, or cannot be.
    """
    found, given = RobotPlugins(), list(plugins)
    if len(given) > MAX_PLUGINS:
        report.suspicious("plugins", f"{len(given)}; the first {MAX_PLUGINS} are read")
    for plugin in given[:MAX_PLUGINS]:
        filename = plugin.get("filename") or ""
        reader = next((one for one in DRIVE_READERS if _matches_any(filename, one.filenames)), None)
        if reader is not None:
            found = _add_drive(found, plugin, reader, lumped=lumped, report=report)
        elif _matches_any(filename, publisher_plugins.JOINT_STATE_FILENAMES):
            found = _add_joint_state(found, plugin, lumped, report)
        elif _matches_any(filename, publisher_plugins.GROUND_TRUTH_FILENAMES):
            found = _add_ground_truth(found, plugin, lumped, report)
        else:
            _report_unread_plugin(plugin, filename, report)
    return found


def _add_drive(
    found: RobotPlugins,
    plugin: Element,
    reader: DrivePluginReader,
    *,
    lumped: LumpedModel,
    report: ParseReport,
) -> RobotPlugins:
    tags = PluginTags(plugin, slug="drive", aliases=reader.aliases, report=report)
    drive = reader.read(tags, lumped)
    if drive is None:
        return found
    if found.drive is not None:
        report.suspicious(tags.subject, "a second drive; the first counts")
        return found
    report.applied(tags.subject, f"drive: {summarize_drive(drive)}")
    check_drive(drive, lumped, subject=tags.subject, report=report)
    for note in describe_contacts(drive, lumped.links, lumped.joints):
        report.applied(tags.subject, note)
    return msgspec.structs.replace(found, drive=drive)


def _add_joint_state(
    found: RobotPlugins, plugin: Element, lumped: LumpedModel, report: ParseReport
) -> RobotPlugins:
    tags = PluginTags(
        plugin, slug="joint_state", aliases=publisher_plugins.JOINT_STATE_ALIASES, report=report
    )
    publisher = publisher_plugins.read_joint_state(
        tags, {joint.name: joint for joint in lumped.joints}
    )
    if publisher is None:
        return found
    if found.joint_state is not None:
        report.suspicious(tags.subject, "a second joint state publisher; the first counts")
        return found
    report.applied(tags.subject, f"joint states of {', '.join(publisher.joints)}")
    return msgspec.structs.replace(found, joint_state=publisher)


def _add_ground_truth(
    found: RobotPlugins, plugin: Element, lumped: LumpedModel, report: ParseReport
) -> RobotPlugins:
    tags = PluginTags(
        plugin, slug="ground_truth", aliases=publisher_plugins.GROUND_TRUTH_ALIASES, report=report
    )
    truth = publisher_plugins.read_ground_truth(tags, lumped)
    if truth is None:
        return found
    report.applied(tags.subject, f"ground truth of {truth.body!r} in {truth.frame_id!r}")
    truths = (*found.ground_truths, truth)
    return msgspec.structs.replace(found, ground_truths=truths)


def _report_unread_plugin(plugin: Element, filename: str, report: ParseReport) -> None:
    subject = f"plugin {(plugin.get('name') or '')[:80]!r}"
    for known, reason in UNUSED_PLUGINS.items():
        if known in filename:
            report.ignored(subject, reason)
            return
    report.unknown(subject, f"no plug-in {filename[:80]!r} here")


def _matches_any(filename: str, names: Iterable[str]) -> bool:
    return any(name in filename for name in names)
