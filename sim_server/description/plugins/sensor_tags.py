"""Sensors of URDF <gazebo> blocks and SDF links, with all their settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import Origin, Parameter, RosBlock, Sensor
from zensim.proto.rigid_transforms import compose
from zensim.sim_server.description.model_geometry import make_origin
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
"""Prefixes of Gazebo's sensor types: `depth_camera` is a `depth`."""
NUMBER_COUNTS = {"update_rate": 1, "pose": 6}
"""Tags that are read as so many numbers; all others are kept as text."""
MAX_SENSORS = 500
MAX_PARAMETERS = 200
MAX_VALUE_LENGTH = 1000


@dataclass(frozen=True)
class SensorElement:
    """A <sensor> and the link that it is on."""

    link: str
    element: Element


def read_sensors(
    tags: Iterable[SensorElement], lumped: LumpedModel, report: ParseReport
) -> tuple[Sensor, ...]:
    """Read sensors; each is placed in the moving link that its link was merged into.

    Raises:
        ModelError: A pose or an update rate is not a number.
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
        report.ignored(subject, f"{quote(kind)} is known, not simulated yet")
    else:
        report.unknown(subject, f"unknown sensor type {quote(kind)}")
    (rate,) = _read_numbers(element, "update_rate", subject)
    x, y, z, *rpy = _read_numbers(element, "pose", subject)
    ros = plugin.find("ros") if plugin is not None else None
    filename = (plugin.get("filename") or "") if plugin is not None else ""
    return Sensor(
        name=name[:MAX_VALUE_LENGTH],
        kind=kind[:MAX_VALUE_LENGTH],
        link=link,
        frame=tag.link,
        origin=compose(place, make_origin((x, y, z), tuple(rpy))),
        update_rate_hz=max(rate, 0.0),
        plugin=filename[:MAX_VALUE_LENGTH],
        ros=RosBlock() if ros is None else read_ros_block(ros, subject=subject, report=report),
        parameters=_read_parameters(element, subject, report),
    )


def _read_numbers(element: Element, tag: str, subject: str) -> tuple[float, ...]:
    count = NUMBER_COUNTS[tag]
    text = (element.findtext(tag) or "").strip() or " ".join(["0"] * count)
    return read_numbers(text, counts=(count,), where=f"{subject}, {tag}", slug="urdf.sensor")


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
