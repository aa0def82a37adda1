"""Tags of a <sensor> and of its plug-in: by path, with noise in both spellings of SDF."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

from zensim.proto.messages.sensor_messages import NO_NOISE, Noise, NoiseKind, NoiseOfVector
from zensim.sim_server.description.plugins.plugin_tags import (
    NOT_A_NUMBER,
    PluginTags,
    WrittenTags,
    list_plugin_tags,
)
from zensim.sim_server.description.strict_parsing import quote

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Origin
    from zensim.sim_server.description.report import ParseReport

OWN_TAGS = ("sees_itself",)
"""Tags of the zensim namespace."""
INFINITIES = ("inf", "infinity")
PLUGIN_TAG = "plugin"
POSE_TAG = "pose"
SENSOR_ATTRIBUTES = ("name", "type")
KNOWN_ATTRIBUTES = {"camera": ("name",), "noise": ("type",)}
"""Attributes that are read, or mean nothing, by tag below a <sensor>."""


class UnusableSensor(ValueError):
    """Settings that no sensor can have; the text is the reason for the report."""


@dataclass(frozen=True)
class SensorElement:
    """A <sensor>, or a plug-in that is a sensor, and the link that it is on."""

    link: str
    element: Element
    origin: Origin | None = None
    """Pose in the link; None = that of its <pose>, six numbers."""


@dataclass(frozen=True)
class SensorSource:
    """The tags of one sensor.

    Attributes:
        name: Of the sensor; for one of several cameras with the name of the camera.
        kind: Type in Gazebo.
        link: In the description.
        tags: By path, such as `ray/scan/horizontal/samples`.
        plugin: Tags of its plug-in, if it has one.
        node: Name of the plug-in, which stands for `~` in topics.
    """

    name: str
    kind: str
    link: str
    tags: PluginTags
    plugin: PluginTags | None = None
    node: str = ""

    @property
    def report(self) -> ParseReport:
        """Gets what is unusual."""
        return self.tags.report

    @property
    def subject(self) -> str:
        """Name of the sensor in the report."""
        return self.tags.subject

    def written(self, *names: str, default: str = "") -> str:
        """Read the first tag of the plug-in that has one of these names."""
        if self.plugin is None:
            return default
        for name in names:
            if text := self.plugin.text(name, ""):
                return text
        return default

    def has(self, *names: str) -> bool:
        """Whether the plug-in has a tag with one of these names."""
        return self.plugin is not None and any(self.plugin.has(name) for name in names)

    def plugin_value(self, *names: str, default: float = 0.0) -> float:
        """Read the first number of the plug-in under one of these names; see `read_value`."""
        for name in names:
            if self.plugin is not None and self.plugin.has(name):
                return read_value(self.plugin, name, default)
        return default


def describe_sensor(name: str, link: str) -> str:
    """Name a sensor in the report."""
    return f"sensor {quote(name)} on {quote(link)}"


def list_sensor_tags(tag: SensorElement, subject: str, camera: Element | None) -> WrittenTags:
    """List the tags of a sensor by path.

    Args:
        tag: The <sensor>.
        subject: Its name in the report.
        camera: The only one of several cameras whose tags are listed.
    """
    element = tag.element
    left_out = [one for one in element.findall("camera") if camera not in (None, one)]
    texts = [
        (path, text)
        for path, text in list_settings(element, left_out=left_out)
        if path.partition("/")[0] != PLUGIN_TAG
    ]
    bare = [path for path, text in texts if not text]
    bare += (f"@{name}" for name in element.attrib if name not in SENSOR_ATTRIBUTES)
    for child in element:
        if child.tag != PLUGIN_TAG and child not in left_out:
            bare += _list_attributes(child, child.tag)
            bare += (f"{POSE_TAG}/{one.tag}" for one in child if child.tag == POSE_TAG)
    bare = [path for path in bare if tag.origin is None or not path.startswith(f"{POSE_TAG}@")]
    return WrittenTags(subject, "", [one for one in texts if one[1]], is_xml=True, bare=bare)


def _list_attributes(element: Element, path: str) -> Iterator[str]:
    known = KNOWN_ATTRIBUTES.get(str(element.tag), ())
    for name in element.attrib:
        if name not in known and (name != "value" or (element.text or "").strip()):
            yield f"{path}@{name}"
    for child in element:
        yield from _list_attributes(child, f"{path}/{child.tag}")


def list_sensor_plugin_tags(plugin: Element, subject: str) -> WrittenTags:
    """List the tags of a sensor's plug-in."""
    return list_plugin_tags(plugin)._replace(subject=f"{subject}: plugin")


def list_settings(
    element: Element, above: str = "", left_out: Sequence[Element] = ()
) -> Iterator[tuple[str, str]]:
    """List path and text of each setting but the pose; the attribute `type` of noise is one."""
    for child in element:
        if child in left_out or (child.tag == POSE_TAG and not above):
            continue
        tag = next((own for own in OWN_TAGS if child.tag.endswith(own)), child.tag)
        if tag == "noise" and (kind := child.get("type")) and child.find("type") is None:
            yield f"{above}{tag}/type", kind.strip()
        text = (child.text or child.get("value") or "").strip()
        yield from list_settings(child, f"{above}{tag}/")
        if text or not len(child):
            yield f"{above}{tag}", text


def read_value(tags: PluginTags, tag: str, default: float) -> float:
    """Read a number of either sign, or `inf`.

    Raises:
        UnusableSensor: It is NaN.
        ModelError: It is not a number.
    """
    text = tags.text(tag, "").lower()
    if text.lstrip("+-") in INFINITIES:
        return -math.inf if text.startswith("-") else math.inf
    if text in NOT_A_NUMBER:
        raise UnusableSensor(f"<{tag}> is {text}; write a number")
    found = tags.signed(tag)
    return default if found is None else found


def read_count(tags: PluginTags, tag: str, default: int) -> float:
    """Read a whole number.

    Raises:
        UnusableSensor: It has a fraction, or is NaN or infinite.
        ModelError: It is not a number.
    """
    number = read_value(tags, tag, default)
    if not math.isfinite(number) or number % 1.0:
        raise UnusableSensor(f"<{tag}> is {number:g}; write a whole number")
    return number


NOISE_FIELDS = {
    "mean": "mean",
    "stddev": "stddev",
    "bias_mean": "bias_mean",
    "bias_stddev": "bias_stddev",
    "precision": "precision",
    "dynamic_bias_stddev": "dynamic_bias_stddev",
    "dynamic_bias_correlation_time": "dynamic_bias_correlation_time_s",
}
"""Fields of a noise by tag."""
MAY_BE_NEGATIVE = ("mean", "bias_mean")


def read_noise(tags: PluginTags, path: str) -> Noise:
    """Read a <noise>; one that is impossible is reported and left out.

    Raises:
        UnusableSensor: A number is NaN.
        ModelError: It is not a number.
    """
    kind = tags.text(f"{path}/type", "")
    values = {field: read_value(tags, f"{path}/{tag}", 0.0) for tag, field in NOISE_FIELDS.items()}
    if not any(values.values()):
        return NO_NOISE
    fault = find_noise_fault(kind, values)
    if fault:
        tags.report.suspicious(tags.label(path), f"{fault}; no noise")
    for known in get_args(NoiseKind):
        if known == kind and known != "none" and not fault:
            return Noise(kind=known, **values)
    return NO_NOISE


def find_noise_fault(kind: str, values: dict[str, float]) -> str:
    """Find what is impossible in a noise; empty if nothing is."""
    if not kind:
        return "has no type"
    if kind not in get_args(NoiseKind):
        return f"type {quote(kind)} is not one of {', '.join(get_args(NoiseKind))}"
    for field, value in values.items():
        if not math.isfinite(value) or (value < 0.0 and field not in MAY_BE_NEGATIVE):
            return f"{field} is {value:g}"
    if kind == "gaussian_quantized" and values["precision"] == 0.0:
        return "is quantized without <precision>"
    return ""


def read_vector_noise(tags: PluginTags, path: str) -> NoiseOfVector:
    """Read the noise along x, y and z."""
    x, y, z = (read_noise(tags, f"{path}/{axis}/noise") for axis in "xyz")
    return (x, y, z)


def make_gaussian(stddev: float, mean: float = 0.0) -> Noise:
    """Make the noise of a plug-in's tag; none for 0."""
    if not (stddev or mean):
        return NO_NOISE
    return Noise(kind="gaussian", stddev=abs(stddev), mean=mean)
