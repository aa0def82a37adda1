"""Sensors of URDF <gazebo> blocks and SDF links, read in full for clients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import Origin, Parameter, RosBlock, Sensor
from zensim.proto.rigid_transforms import compose, from_rpy
from zensim.sim_server.description.plugins.plugin_tags import read_ros_block
from zensim.sim_server.description.strict_parsing import quote, read_numbers

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.report import ParseReport

SENSOR_KINDS = (
    "altimeter", "camera", "contact", "depth", "force_torque", "gps", "gpu_lidar", "gpu_ray", "imu",
    "lidar", "logical_camera", "magnetometer", "multicamera", "ray", "rgbd_camera", "sonar",
    "wideanglecamera", "wireless_receiver", "wireless_transmitter",
)  # fmt: skip
"""Sensors that Gazebo has; `depth_camera` and the like count as what they begin with."""
MAX_SENSORS = 500
MAX_PARAMETERS = 200
MAX_VALUE_LENGTH = 1000
_NOT_SIMULATED_YET = "known, not simulated yet"


@dataclass(frozen=True)
class SensorElement:
    """A <sensor> and the link that its block refers to."""

    link: str
    element: Element


def read_sensors(
    tags: Iterable[SensorElement], lumped: LumpedModel, report: ParseReport
) -> tuple[Sensor, ...]:
    """Read sensors; each is placed in the link that moves it.

    Raises:
        ModelError: A pose or an update rate is no number.
    """
    places = {link.name: (link.name, Origin()) for link in lumped.links}
    places |= {frame.name: (frame.parent, frame.origin) for frame in lumped.frames}
    given = list(tags)
    if len(given) > MAX_SENSORS:
        report.suspicious("sensors", f"{len(given)}; the first {MAX_SENSORS} are read")
    return tuple(_read_sensor(tag, *places[tag.link], report) for tag in given[:MAX_SENSORS])


def _read_sensor(tag: SensorElement, link: str, place: Origin, report: ParseReport) -> Sensor:
    element, plugin = tag.element, tag.element.find("plugin")
    kind, name = element.get("type") or "", element.get("name") or ""
    subject = f"sensor {quote(name)} on {quote(tag.link)}"
    if kind.startswith(SENSOR_KINDS):
        report.ignored(subject, f"{quote(kind)} is {_NOT_SIMULATED_YET}")
    else:
        report.unknown(subject, f"no sensor is of type {quote(kind)}")
    rate = _read_number(element, "update_rate", subject)
    return Sensor(
        name=name[:MAX_VALUE_LENGTH],
        kind=kind[:MAX_VALUE_LENGTH],
        link=link,
        frame=tag.link,
        origin=compose(place, _read_pose(element, subject)),
        update_rate_hz=max(rate, 0.0),
        plugin=((plugin.get("filename") or "") if plugin is not None else "")[:MAX_VALUE_LENGTH],
        ros=_read_ros(plugin, subject, report),
        parameters=_read_parameters(element, subject, report),
    )


def _read_number(element: Element, tag: str, subject: str) -> float:
    text = (element.findtext(tag) or "").strip() or "0"
    (number,) = read_numbers(text, counts=(1,), where=f"{subject}, {tag}", slug="urdf.sensor")
    return number


def _read_pose(element: Element, subject: str) -> Origin:
    text = (element.findtext("pose") or "").strip() or "0 0 0 0 0 0"
    x, y, z, roll, pitch, yaw = read_numbers(
        text, counts=(6,), where=f"{subject}, pose", slug="urdf.sensor"
    )
    if not any((roll, pitch, yaw)):
        return Origin((x, y, z))
    return Origin((x, y, z), from_rpy(roll, pitch, yaw))


def _read_ros(plugin: Element | None, subject: str, report: ParseReport) -> RosBlock:
    ros = plugin.find("ros") if plugin is not None else None
    return RosBlock() if ros is None else read_ros_block(ros, subject=subject, report=report)


def _read_parameters(element: Element, subject: str, report: ParseReport) -> tuple[Parameter, ...]:
    found = list(_flatten_settings(element, ""))
    if len(found) > MAX_PARAMETERS:
        report.suspicious(
            subject, f"has {len(found)} settings; the first {MAX_PARAMETERS} are read"
        )
    return tuple(found[:MAX_PARAMETERS])


def _flatten_settings(element: Element, above: str) -> Iterator[Parameter]:
    for child in element:
        path = f"{above}{child.tag}"
        if len(child):
            yield from _flatten_settings(child, f"{path}/")
        elif path != "pose":
            text = (child.text or child.get("value") or "").strip()
            yield Parameter(path[:MAX_VALUE_LENGTH], text[:MAX_VALUE_LENGTH])
