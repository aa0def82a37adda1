"""Model-level plug-ins of Gazebo: which are read, which are known, which are not."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import msgspec

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import GroundTruth, JointStatePublisher
from zensim.sim_server.description import (
    ackermann,
    classic_drive,
    diff_drive,
    ground_truth,
    gz_body,
    gz_diff_drive,
    joint_state,
    planar_move,
    tricycle,
)
from zensim.sim_server.description.drive_geometry import check_drive
from zensim.sim_server.description.drive_words import in_words
from zensim.sim_server.description.plugin_tags import PluginTags
from zensim.sim_server.description.rolling import contact_notes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.report import Report

MAX_PLUGINS = 100
_ROS_CONTROL = "ros_control is not used here; wheels are driven by the diff_drive plug-in"
_NOT_SIMULATED = "not simulated"
NOT_USED = {
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


class Plugins(msgspec.Struct, frozen=True):
    """What the plug-ins of a robot come to."""

    drive: Drive | None = None
    joint_state: JointStatePublisher | None = None
    ground_truths: tuple[GroundTruth, ...] = ()


class DriveReader(NamedTuple):
    """How one kind of drive is read."""

    filenames: tuple[str, ...]
    aliases: Mapping[str, str]
    read: Callable[[PluginTags, Lumped], Drive | None]


DRIVES = (
    DriveReader(diff_drive.FILENAMES, diff_drive.ALIASES, diff_drive.read_diff_drive),
    DriveReader(planar_move.FILENAMES, planar_move.ALIASES, planar_move.read_planar_move),
    DriveReader(ackermann.FILENAMES, ackermann.ALIASES, ackermann.read_ackermann),
    DriveReader(tricycle.FILENAMES, tricycle.ALIASES, tricycle.read_tricycle),
    DriveReader(classic_drive.FILENAMES, classic_drive.ALIASES, classic_drive.read_classic_drive),
    DriveReader(gz_diff_drive.FILENAMES, gz_diff_drive.ALIASES, gz_diff_drive.read_gz_diff_drive),
    DriveReader(gz_body.FILENAMES, gz_body.ALIASES, gz_body.read_gz_body),
)


def read_plugins(plugins: Iterable[Element], lumped: Lumped, report: Report) -> Plugins:
    """Read the plug-ins of a robot; the first of a kind counts.

    Raises:
        ModelError: A number in one is none, or cannot be.
    """
    found, given = Plugins(), list(plugins)
    if len(given) > MAX_PLUGINS:
        report.suspicious("plugins", f"{len(given)}; the first {MAX_PLUGINS} are read")
    for plugin in given[:MAX_PLUGINS]:
        filename = plugin.get("filename") or ""
        reader = next((one for one in DRIVES if _is_one_of(filename, one.filenames)), None)
        if reader is not None:
            found = _with_drive(found, plugin, reader, lumped=lumped, report=report)
        elif _is_one_of(filename, joint_state.FILENAMES):
            found = _with_joint_state(found, plugin, lumped, report)
        elif _is_one_of(filename, ground_truth.FILENAMES):
            found = _with_ground_truth(found, plugin, lumped, report)
        else:
            _note(plugin, filename, report)
    return found


def _with_drive(
    found: Plugins, plugin: Element, reader: DriveReader, *, lumped: Lumped, report: Report
) -> Plugins:
    tags = PluginTags(plugin, slug="drive", aliases=reader.aliases, report=report)
    drive = reader.read(tags, lumped)
    if drive is None:
        return found
    if found.drive is not None:
        report.suspicious(tags.subject, "a second drive; the first counts")
        return found
    report.applied(tags.subject, f"drive: {in_words(drive)}")
    check_drive(drive, lumped, subject=tags.subject, report=report)
    for note in contact_notes(drive, lumped.links, lumped.joints):
        report.applied(tags.subject, note)
    return msgspec.structs.replace(found, drive=drive)


def _with_joint_state(found: Plugins, plugin: Element, lumped: Lumped, report: Report) -> Plugins:
    tags = PluginTags(plugin, slug="joint_state", aliases=joint_state.ALIASES, report=report)
    publisher = joint_state.read_joint_state(tags, {joint.name: joint for joint in lumped.joints})
    if publisher is None:
        return found
    if found.joint_state is not None:
        report.suspicious(tags.subject, "a second joint state publisher; the first counts")
        return found
    report.applied(tags.subject, f"joint states of {', '.join(publisher.joints)}")
    return msgspec.structs.replace(found, joint_state=publisher)


def _with_ground_truth(found: Plugins, plugin: Element, lumped: Lumped, report: Report) -> Plugins:
    tags = PluginTags(plugin, slug="ground_truth", aliases=ground_truth.ALIASES, report=report)
    truth = ground_truth.read_ground_truth(tags, lumped)
    if truth is None:
        return found
    report.applied(tags.subject, f"ground truth of {truth.body!r} in {truth.frame_id!r}")
    truths = (*found.ground_truths, truth)
    return msgspec.structs.replace(found, ground_truths=truths)


def _note(plugin: Element, filename: str, report: Report) -> None:
    subject = f"plugin {(plugin.get('name') or '')[:80]!r}"
    for known, reason in NOT_USED.items():
        if known in filename:
            report.ignored(subject, reason)
            return
    report.unknown(subject, f"no plug-in {filename[:80]!r} here")


def _is_one_of(filename: str, names: Iterable[str]) -> bool:
    return any(name in filename for name in names)
