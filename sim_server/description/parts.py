"""Links and joints as a URDF lists them, nothing merged yet. The only file to import yourdfpy."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, get_args

import msgspec
import numpy as np
import yourdfpy
from lxml import etree

from zensim.proto.messages.model_messages import Inertial, Joint, JointKind, Link, Mimic, Origin
from zensim.proto.rotation import FloatArray, from_matrix
from zensim.sim_server.description.colours import named_colours
from zensim.sim_server.description.grammar import INERTIAL, JOINT, LINK, Tag
from zensim.sim_server.description.part_list import Parts
from zensim.sim_server.description.shapes import MeshRule, read_collisions, read_visuals
from zensim.sim_server.description.wording import in_line
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import Report

KINDS: dict[str, JointKind] = {kind: kind for kind in get_args(JointKind)}
BONE = msgspec.structs.replace(LINK, children={"inertial": INERTIAL})
"""A link without its shapes: URDF has more kinds of them than yourdfpy."""
LIMITED = ("revolute", "prismatic")


def read_parts(robot: Element, rule: MeshRule, report: Report) -> Parts:
    """Read links and joints of a <robot> whose grammar was checked.

    Raises:
        ModelError: A joint's kind is none, a limit is missing, or a collision mesh is not here.
    """
    read = _kinematics(robot)
    colours = named_colours(robot, report)
    links = tuple(
        Link(
            name=link.name,
            inertial=_inertial(link.inertial),
            collisions=read_collisions(element, rule, report),
            visuals=read_visuals(element, rule, colours, report),
        )
        for element, link in zip(robot.findall("link"), read.links, strict=True)
    )
    return Parts(read.name, links, tuple(_joint(joint, report) for joint in read.joints))


def _skeleton(robot: Element) -> Element:
    """Copy what moves, and of it what was checked: shapes are read by themselves."""
    bare = etree.Element("robot", {"name": robot.get("name") or ""})
    for part in robot:
        if part.tag == "joint":
            _copy(part, JOINT, bare)
        elif part.tag == "link":
            _copy(part, BONE, bare)
    return bare


def _copy(element: Element, tag: Tag, into: Element) -> None:
    known = {name: value for name, value in element.attrib.items() if name in tag.attributes}
    copy = etree.SubElement(into, element.tag, known)
    for child in element:
        if child.tag in tag.children:
            _copy(child, tag.children[child.tag], copy)


def _kinematics(robot: Element) -> yourdfpy.Robot:
    try:
        return yourdfpy.URDF.load(
            BytesIO(etree.tostring(_skeleton(robot))), build_scene_graph=False, load_meshes=False
        ).robot
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        # Any of these means a fault that the grammar let through; the text is not ours to trust.
        raise ModelError(
            f"the description cannot be read as URDF: {in_line(str(error))}", slug="urdf.unreadable"
        ) from error


def _joint(joint: yourdfpy.Joint, report: Report) -> Joint:
    kind = KINDS.get(joint.type)
    if kind is None:
        raise ModelError(
            f"joint {joint.name!r} has type {joint.type!r}; use one of {', '.join(KINDS)}",
            slug="urdf.joint_type",
        )
    if kind in LIMITED and joint.limit is None:
        raise ModelError(
            f"{kind} joint {joint.name!r} has no <limit>; add one, or make it continuous",
            slug="urdf.limit",
        )
    limit, dynamics, mimic = joint.limit, joint.dynamics, joint.mimic
    if kind in LIMITED and limit is not None and limit.lower is None and limit.upper is None:
        report.suspicious(f"joint {joint.name!r}", "its <limit> has no lower and no upper: held")
    x, y, z = joint.axis.tolist()
    return Joint(
        name=joint.name,
        kind=kind,
        parent=joint.parent,
        child=joint.child,
        origin=_origin(joint.origin),
        axis=(x, y, z),
        lower=(limit.lower or 0.0) if limit else 0.0,
        upper=(limit.upper or 0.0) if limit else 0.0,
        effort=(limit.effort or 0.0) if limit else 0.0,
        velocity=(limit.velocity or 0.0) if limit else 0.0,
        damping=float(dynamics.damping or 0.0) if dynamics else 0.0,
        friction=float(dynamics.friction or 0.0) if dynamics else 0.0,
        mimic=_mimic(mimic) if mimic else None,
    )


def _mimic(mimic: yourdfpy.Mimic) -> Mimic:
    multiplier = 1.0 if mimic.multiplier is None else mimic.multiplier
    return Mimic(mimic.joint, multiplier, mimic.offset or 0.0)


def _inertial(inertial: yourdfpy.Inertial | None) -> Inertial:
    if inertial is None or inertial.mass is None or inertial.inertia is None:
        return Inertial()
    turn = np.eye(3) if inertial.origin is None else inertial.origin[:3, :3]
    moments = turn @ inertial.inertia @ turn.T
    ixx, ixy, ixz, _, iyy, iyz, _, _, izz = moments.ravel().tolist()
    return Inertial(
        mass_kg=inertial.mass,
        com_in_link=_origin(inertial.origin).position,
        inertia=(ixx, ixy, ixz, iyy, iyz, izz),
    )


def _origin(matrix: FloatArray | None) -> Origin:
    if matrix is None:
        return Origin()
    x, y, z = matrix[:3, 3].tolist()
    if np.array_equal(matrix[:3, :3], np.eye(3)):
        return Origin((x, y, z))
    qx, qy, qz, qw = from_matrix(matrix[:3, :3]).tolist()
    return Origin((x, y, z), (qx, qy, qz, qw))
