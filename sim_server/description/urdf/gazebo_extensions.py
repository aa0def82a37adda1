"""The <gazebo> blocks of a URDF: surfaces, colours, kept joints, sensors and plug-ins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec

from zensim.sim_server.description.link_surfaces import SURFACE_TAG_NAMES as SURFACE_TAGS
from zensim.sim_server.description.link_surfaces import (
    SurfaceParameters,
    SurfaceTagReader,
    find_gazebo_colour,
)
from zensim.sim_server.description.plugins.sensor_tags import SensorElement
from zensim.sim_server.description.strict_parsing import parse_flag

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Link, Quat
    from zensim.sim_server.description.parsed_model import ParsedModel
    from zensim.sim_server.description.report import ParseReport

_NO_EFFECT = "Gazebo tag without effect"
KEEP_JOINT_TAGS = ("preserveFixedJoint", "disableFixedJointLumping")
LINK_TAGS = (*SURFACE_TAGS, "material", "sensor")
UNUSED_LINK_TAGS = dict.fromkeys(("laserRetro", "maxContacts", "max_contacts"), _NO_EFFECT)
UNUSED_JOINT_TAGS = dict.fromkeys(
    (
        "cfmDamping", "dampingFactor", "erp", "fudgeFactor", "implicitSpringDamper",
        "initial_joint_position", "provideFeedback", "springReference", "springStiffness",
        "stopCfm", "stopErp",
    ),
    _NO_EFFECT,
)  # fmt: skip
MODEL_TAGS = ("plugin", "static", "self_collide")
UNUSED_MODEL_TAGS = {
    "allow_auto_disable": _NO_EFFECT,
    "enable_wind": _NO_EFFECT,
    "pose": "the pose is set by the spawn request",
}


@dataclass
class GazeboExtensions:
    """Contents of the <gazebo> blocks.

    Attributes:
        surface_texts: Texts of surface tags, by link.
        surfaces: The same, read.
        colours: By link; they override the colours of URDF materials, as in Gazebo.
        kept_joints: Fixed joints that are not lumped.
        plugins: Of the model.
        sensors: Of links.
        is_static: The robot does not move.
        self_collides: All links collide with each other.
    """

    surface_texts: dict[str, dict[str, str]] = field(default_factory=dict)
    surfaces: dict[str, SurfaceParameters] = field(default_factory=dict)
    colours: dict[str, Quat] = field(default_factory=dict)
    kept_joints: set[str] = field(default_factory=set)
    plugins: list[Element] = field(default_factory=list)
    sensors: list[SensorElement] = field(default_factory=list)
    is_static: bool = False
    self_collides: bool = False


def read_gazebo_extensions(
    robot: Element, parts: ParsedModel, report: ParseReport
) -> GazeboExtensions:
    """Read all <gazebo> blocks; the last of equal tags is used.

    Raises:
        ModelError: A friction is not a number >= 0.
    """
    blocks = GazeboExtensions()
    links = {link.name for link in parts.links}
    joints = {joint.name for joint in parts.joints}
    for block in robot.findall("gazebo"):
        reference = block.get("reference")
        for child in block:
            if reference is None:
                _read_model_tag(child, blocks, report)
            elif reference in links:
                _read_link_tag(reference, child, blocks, report)
            elif reference in joints:
                _read_joint_tag(reference, child, blocks, report)
        if reference is not None and reference not in links | joints:
            report.suspicious(
                f"gazebo {reference[:80]!r}", "no link or joint has this name; block not read"
            )
    for link, texts in blocks.surface_texts.items():
        tags = SurfaceTagReader(texts, subject=f"gazebo {link!r}", slug="gazebo.mu1", report=report)
        blocks.surfaces[link] = tags.read()
    return blocks


def apply_surfaces(links: Iterable[Link], blocks: GazeboExtensions) -> tuple[Link, ...]:
    """Apply the surfaces and colours of the blocks to links before lumping."""
    return tuple(_apply_surface(link, blocks) for link in links)


def _apply_surface(link: Link, blocks: GazeboExtensions) -> Link:
    replace = msgspec.structs.replace
    if link.name in blocks.surfaces:
        link = blocks.surfaces[link.name].apply_to_link(link)
    if link.name in blocks.colours:
        colour = blocks.colours[link.name]
        link = replace(link, visuals=tuple(replace(shape, rgba=colour) for shape in link.visuals))
    return replace(link, self_collides=True) if blocks.self_collides else link


def _read_model_tag(child: Element, blocks: GazeboExtensions, report: ParseReport) -> None:
    if child.tag == "plugin":
        blocks.plugins.append(child)
    elif child.tag == "static":
        blocks.is_static = bool(parse_flag(_element_text(child)))
        report.applied("gazebo: <static>", "the robot does not move" if blocks.is_static else "")
    elif child.tag == "self_collide":
        blocks.self_collides = bool(parse_flag(_element_text(child)))
        report.applied("gazebo: <self_collide>")
    elif child.tag in UNUSED_MODEL_TAGS:
        report.ignored(f"gazebo: <{child.tag}>", UNUSED_MODEL_TAGS[child.tag])
    else:
        report.unread_tag("gazebo", child.tag, (*MODEL_TAGS, *UNUSED_MODEL_TAGS))


def _read_link_tag(
    link: str, child: Element, blocks: GazeboExtensions, report: ParseReport
) -> None:
    subject = f"gazebo {link!r}"
    if child.tag in SURFACE_TAGS:
        blocks.surface_texts.setdefault(link, {})[SURFACE_TAGS[child.tag]] = _element_text(child)
    elif child.tag == "material":
        _read_material(link, child, blocks, report)
    elif child.tag == "sensor":
        blocks.sensors.append(SensorElement(link, child))
    elif child.tag == "plugin":
        report.suspicious(
            f"{subject}: <plugin>", "not read in a block with a reference; remove the reference"
        )
    elif child.tag in UNUSED_LINK_TAGS:
        report.ignored(f"{subject}: <{child.tag}>", UNUSED_LINK_TAGS[child.tag])
    else:
        report.unread_tag(subject, child.tag, (*LINK_TAGS, *UNUSED_LINK_TAGS))


def _read_material(
    link: str, child: Element, blocks: GazeboExtensions, report: ParseReport
) -> None:
    subject, name = f"gazebo {link!r}: <material>", _element_text(child)
    colour = find_gazebo_colour(name)
    if colour is None:
        report.unknown(subject, f"no colour is named {name[:80]!r}")
    else:
        blocks.colours[link] = colour
        report.applied(subject, name)


def _read_joint_tag(
    joint: str, child: Element, blocks: GazeboExtensions, report: ParseReport
) -> None:
    subject = f"gazebo {joint!r}"
    if child.tag in KEEP_JOINT_TAGS:
        if parse_flag(_element_text(child)):
            blocks.kept_joints.add(joint)
        report.applied(f"{subject}: <{child.tag}>")
    elif child.tag in UNUSED_JOINT_TAGS:
        report.ignored(f"{subject}: <{child.tag}>", UNUSED_JOINT_TAGS[child.tag])
    else:
        report.unread_tag(subject, child.tag, (*KEEP_JOINT_TAGS, *UNUSED_JOINT_TAGS))


def _element_text(child: Element) -> str:
    return (child.text or child.get("value") or "").strip()
