"""The <gazebo> blocks of a URDF: surface, colour, joints to keep, and the plug-ins to be read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec

from zensim.sim_server.description.colours import gazebo_colour
from zensim.sim_server.description.sensors import SensorTag
from zensim.sim_server.description.surface import TAGS as SURFACE_TAGS
from zensim.sim_server.description.surface import Surface, SurfaceTags

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Link, Quat
    from zensim.sim_server.description.part_list import Parts
    from zensim.sim_server.description.report import Report

_NO_EFFECT = "known to Gazebo; no effect here"
KEEP = ("preserveFixedJoint", "disableFixedJointLumping")
LINK_TAGS = (*SURFACE_TAGS, "material", "sensor")
LINK_UNUSED = dict.fromkeys(("laserRetro", "maxContacts", "max_contacts"), _NO_EFFECT)
JOINT_UNUSED = dict.fromkeys(
    (
        "cfmDamping", "dampingFactor", "erp", "fudgeFactor", "implicitSpringDamper",
        "initial_joint_position", "provideFeedback", "springReference", "springStiffness",
        "stopCfm", "stopErp",
    ),
    _NO_EFFECT,
)  # fmt: skip
MODEL_TAGS = ("plugin", "static", "self_collide")
MODEL_UNUSED = {
    "allow_auto_disable": _NO_EFFECT,
    "enable_wind": _NO_EFFECT,
    "pose": "the pose is that of the spawn request",
}
TRUE = ("true", "1")


@dataclass
class GazeboBlocks:
    """What the <gazebo> blocks say, gathered block by block.

    Attributes:
        wishes: How links touch and fall: by link, what is written of each tag.
        surfaces: The same once read.
        colours: By link; they win over the colours of URDF materials, as in Gazebo.
        kept_joints: Fixed joints that are not to be lumped.
        plugins: Of the model.
        sensors: By the link that they are on.
        is_static: Nothing of the robot moves.
        self_collides: All its links touch each other.
    """

    wishes: dict[str, dict[str, str]] = field(default_factory=dict)
    surfaces: dict[str, Surface] = field(default_factory=dict)
    colours: dict[str, Quat] = field(default_factory=dict)
    kept_joints: set[str] = field(default_factory=set)
    plugins: list[Element] = field(default_factory=list)
    sensors: list[SensorTag] = field(default_factory=list)
    is_static: bool = False
    self_collides: bool = False


def read_gazebo(robot: Element, parts: Parts, report: Report) -> GazeboBlocks:
    """Read all <gazebo> blocks; where two say the same, the last counts.

    Raises:
        ModelError: A friction is no number, or negative.
    """
    blocks = GazeboBlocks()
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
                f"gazebo {reference[:80]!r}", "no link or joint of this name; block not read"
            )
    for link, texts in blocks.wishes.items():
        tags = SurfaceTags(texts, subject=f"gazebo {link!r}", slug="gazebo.mu1", report=report)
        blocks.surfaces[link] = tags.read()
    return blocks


def with_surfaces(links: Iterable[Link], blocks: GazeboBlocks) -> tuple[Link, ...]:
    """Give links, before they are lumped, the surface and colour of their blocks."""
    return tuple(_with_surface(link, blocks) for link in links)


def _with_surface(link: Link, blocks: GazeboBlocks) -> Link:
    replace = msgspec.structs.replace
    if link.name in blocks.surfaces:
        link = blocks.surfaces[link.name].under(link)
    if link.name in blocks.colours:
        colour = blocks.colours[link.name]
        link = replace(link, visuals=tuple(replace(shape, rgba=colour) for shape in link.visuals))
    return replace(link, self_collides=True) if blocks.self_collides else link


def _read_model_tag(child: Element, blocks: GazeboBlocks, report: Report) -> None:
    if child.tag == "plugin":
        blocks.plugins.append(child)
    elif child.tag == "static":
        blocks.is_static = _text(child).lower() in TRUE
        report.applied("gazebo: <static>", "nothing of it moves" if blocks.is_static else "")
    elif child.tag == "self_collide":
        blocks.self_collides = _text(child).lower() in TRUE
        report.applied("gazebo: <self_collide>")
    elif child.tag in MODEL_UNUSED:
        report.ignored(f"gazebo: <{child.tag}>", MODEL_UNUSED[child.tag])
    else:
        report.unread_tag("gazebo", child.tag, (*MODEL_TAGS, *MODEL_UNUSED))


def _read_link_tag(link: str, child: Element, blocks: GazeboBlocks, report: Report) -> None:
    subject = f"gazebo {link!r}"
    if child.tag in SURFACE_TAGS:
        blocks.wishes.setdefault(link, {})[SURFACE_TAGS[child.tag]] = _text(child)
    elif child.tag == "material":
        _read_material(link, child, blocks, report)
    elif child.tag == "sensor":
        blocks.sensors.append(SensorTag(link, child))
    elif child.tag == "plugin":
        report.suspicious(
            f"{subject}: <plugin>", "not read in a block with a reference; remove the reference"
        )
    elif child.tag in LINK_UNUSED:
        report.ignored(f"{subject}: <{child.tag}>", LINK_UNUSED[child.tag])
    else:
        report.unread_tag(subject, child.tag, (*LINK_TAGS, *LINK_UNUSED))


def _read_material(link: str, child: Element, blocks: GazeboBlocks, report: Report) -> None:
    subject, name = f"gazebo {link!r}: <material>", _text(child)
    colour = gazebo_colour(name)
    if colour is None:
        report.unknown(subject, f"no colour is called {name[:80]!r}")
    else:
        blocks.colours[link] = colour
        report.applied(subject, name)


def _read_joint_tag(joint: str, child: Element, blocks: GazeboBlocks, report: Report) -> None:
    subject = f"gazebo {joint!r}"
    if child.tag in KEEP:
        if _text(child).lower() in TRUE:
            blocks.kept_joints.add(joint)
        report.applied(f"{subject}: <{child.tag}>")
    elif child.tag in JOINT_UNUSED:
        report.ignored(f"{subject}: <{child.tag}>", JOINT_UNUSED[child.tag])
    else:
        report.unread_tag(subject, child.tag, (*KEEP, *JOINT_UNUSED))


def _text(child: Element) -> str:
    return (child.text or child.get("value") or "").strip()
