"""Model plug-ins by file name: read, known but unused, or unknown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import GroundTruth, JointStatePublisher, Model
from zensim.sim_server.description.plugins import (
    diff_drive_plugins,
    mecanum_plugins,
    planar_move_plugins,
    steered_drive_plugins,
)
from zensim.sim_server.description.plugins.drive_controllers import DRIVE_CONTROLLERS
from zensim.sim_server.description.plugins.plugin_tags import PluginTags, list_plugin_tags
from zensim.sim_server.description.plugins.publisher_plugins import (
    GROUND_TRUTH_ALIASES,
    GROUND_TRUTH_FILENAMES,
    JOINT_STATE_ALIASES,
    JOINT_STATE_FILENAMES,
    read_ground_truth,
    read_joint_state,
)
from zensim.sim_server.description.plugins.sensor_reader import is_sensor_plugin, read_sensors
from zensim.sim_server.description.strict_parsing import quote

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.drive_plugin import DrivePlugin
    from zensim.sim_server.description.plugins.sensor_tags import SensorElement
    from zensim.sim_server.description.report import ParseReport

MAX_PLUGINS = 100
_ROS_CONTROL = "its controllers are read from the files of the request (--controllers FILE)"
_NOT_SIMULATED = "not simulated"
_COMMANDED = "its joint is commanded on joint_commands, or by a trajectory of its controller"
_NO_SENSOR_PLUGIN = "sensors need no plug-in"
UNUSED_PLUGINS = {
    "gazebo_ros_control": _ROS_CONTROL,
    "gazebo_ros2_control": _ROS_CONTROL,
    "gz_ros2_control": _ROS_CONTROL,
    "ign_ros2_control": _ROS_CONTROL,
    "gazebo_ros_ft_sensor": _NOT_SIMULATED,
    "gazebo_ros_joint_pose_trajectory": _NOT_SIMULATED,
    "joint-position-controller-system": _COMMANDED,
    "joint-trajectory-controller-system": _COMMANDED,
    "joint-controller-system": _COMMANDED,
    "tracked-vehicle-system": _NOT_SIMULATED,
    "track-controller-system": _NOT_SIMULATED,
    "odometry-publisher-system": "the drive publishes odometry",
    "pose-publisher-system": "the snapshot has the true poses",
    "sensors-system": _NO_SENSOR_PLUGIN,
    "imu-system": _NO_SENSOR_PLUGIN,
    "contact-system": _NO_SENSOR_PLUGIN,
    "navsat-system": _NO_SENSOR_PLUGIN,
    "altimeter-system": _NO_SENSOR_PLUGIN,
    "magnetometer-system": _NO_SENSOR_PLUGIN,
    "cpu-lidar-system": _NO_SENSOR_PLUGIN,
    "air-pressure-system": _NOT_SIMULATED,
    "forcetorque-system": _NOT_SIMULATED,
}
"""Known plug-ins without effect, by part of their file name, and the reason."""
DRIVE_PLUGINS: tuple[DrivePlugin[Any], ...] = (
    *diff_drive_plugins.PLUGINS,
    *planar_move_plugins.PLUGINS,
    *mecanum_plugins.PLUGINS,
    *steered_drive_plugins.PLUGINS,
)


class RobotPlugins(msgspec.Struct, frozen=True):
    """Drive and publishers of the plug-ins of a robot."""

    drive: Drive | None = None
    joint_state: JointStatePublisher | None = None
    ground_truths: tuple[GroundTruth, ...] = ()


def make_model(
    name: str,
    lumped: LumpedModel,
    *,
    plugins: Iterable[Element],
    sensors: Iterable[SensorElement],
    report: ParseReport,
) -> Model:
    """Make a model of links and joints, plug-ins and sensors; its own report stays empty.

    Raises:
        ModelError: A value is not a number or out of range.
    """
    given = list(plugins)
    measuring = [plugin for plugin in given if is_sensor_plugin(plugin)]
    found = read_plugins([one for one in given if one not in measuring], lumped, report)
    return Model(
        name=name,
        links=lumped.links,
        joints=lumped.joints,
        frames=lumped.frames,
        drive=found.drive,
        joint_state=found.joint_state,
        ground_truths=found.ground_truths,
        sensors=read_sensors(sensors, measuring, lumped, report),
    )


def summarize_drive(drive: Drive) -> str:
    """Describe a drive in one line."""
    known = (*DRIVE_PLUGINS, *DRIVE_CONTROLLERS)
    plugin = next(plugin for plugin in known if plugin.drive_type is type(drive))
    return plugin.summarize(drive)


def read_plugins(
    plugins: Iterable[Element], lumped: LumpedModel, report: ParseReport
) -> RobotPlugins:
    """Read the plug-ins of a robot; the first of a kind is used.

    Raises:
        ModelError: A value is not a number or out of range.
    """
    found, given = RobotPlugins(), list(plugins)
    if len(given) > MAX_PLUGINS:
        report.suspicious("plugins", f"{len(given)}; the first {MAX_PLUGINS} are read")
    for element in given[:MAX_PLUGINS]:
        filename = element.get("filename") or ""
        plugin = next((one for one in DRIVE_PLUGINS if _matches(filename, one.filenames)), None)
        if plugin is not None:
            found = _add_drive(found, element, plugin, lumped=lumped, report=report)
        elif _matches(filename, JOINT_STATE_FILENAMES):
            found = _add_joint_state(found, element, lumped, report)
        elif _matches(filename, GROUND_TRUTH_FILENAMES):
            found = _add_ground_truth(found, element, lumped, report)
        else:
            _report_unread_plugin(element, filename, report)
    return found


def _add_drive(
    found: RobotPlugins,
    element: Element,
    plugin: DrivePlugin[Any],
    *,
    lumped: LumpedModel,
    report: ParseReport,
) -> RobotPlugins:
    tags = PluginTags(
        list_plugin_tags(element), slug="drive", aliases=plugin.aliases, report=report
    )
    drive = plugin.read(tags, lumped)
    if drive is None:
        return found
    if found.drive is not None:
        report.suspicious(tags.subject, "a second drive; the first is used")
        return found
    report.applied(tags.subject, f"drive: {plugin.summarize(drive)}")
    plugin.check(drive, lumped, subject=tags.subject, report=report)
    return msgspec.structs.replace(found, drive=drive)


def _add_joint_state(
    found: RobotPlugins, element: Element, lumped: LumpedModel, report: ParseReport
) -> RobotPlugins:
    tags = PluginTags(
        list_plugin_tags(element), slug="joint_state", aliases=JOINT_STATE_ALIASES, report=report
    )
    publisher = read_joint_state(tags, lumped)
    if publisher is None:
        return found
    if found.joint_state is not None:
        report.suspicious(tags.subject, "a second joint state publisher; the first is used")
        return found
    report.applied(tags.subject, f"joint states of {', '.join(publisher.joints)}")
    return msgspec.structs.replace(found, joint_state=publisher)


def _add_ground_truth(
    found: RobotPlugins, element: Element, lumped: LumpedModel, report: ParseReport
) -> RobotPlugins:
    tags = PluginTags(
        list_plugin_tags(element), slug="ground_truth", aliases=GROUND_TRUTH_ALIASES, report=report
    )
    truth = read_ground_truth(tags, lumped)
    if truth is None:
        return found
    report.applied(tags.subject, f"ground truth of {truth.body!r} in {truth.frame_id!r}")
    return msgspec.structs.replace(found, ground_truths=(*found.ground_truths, truth))


def _report_unread_plugin(element: Element, filename: str, report: ParseReport) -> None:
    subject = f"plugin {(element.get('name') or '')[:80]!r}"
    for known, reason in UNUSED_PLUGINS.items():
        if known in filename:
            named = ", ".join(quote(tag.text) for tag in element.findall("parameters"))
            report.ignored(subject, f"{reason}; it names {named}" if named else reason)
            return
    report.unknown(subject, f"no plug-in has the file name {filename[:80]!r}")


def _matches(filename: str, names: Iterable[str]) -> bool:
    return any(name in filename for name in names)
