"""Links and joints as a URDF lists them, nothing merged yet. The only file to import yourdfpy."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, get_args

import msgspec
import numpy as np
import yourdfpy
from lxml import etree

from proto.model import Inertial, Joint, JointKind, Link, Origin, Shape, Vec3
from proto.result import SpawnCode
from proto.rotation import FloatArray, from_matrix
from sim_server.description.colours import colour_of, named_colours
from sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lxml.etree import _Element as Element

    from sim_server.description.assets import HasMesh
    from sim_server.description.report import Report

KINDS: dict[str, JointKind] = {kind: kind for kind in get_args(JointKind)}
LIMITED = ("revolute", "prismatic")


class Parts(msgspec.Struct, frozen=True):
    """What a URDF lists, in its order."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]


def read_parts(robot: Element, *, has_mesh: HasMesh, report: Report) -> Parts:
    """Read links and joints of a <robot> whose grammar was checked.

    Raises:
        ModelError: A joint's kind is none, a limit is missing, or a collision mesh is not here.
    """
    read = _kinematics(robot)
    colours = named_colours(robot, report)
    links = []
    for element, link in zip(robot.findall("link"), read.links, strict=True):
        rgba = [colour_of(visual, colours, report) for visual in element.findall("visual")]
        visuals = [
            msgspec.structs.replace(_shape(visual), rgba=colour)
            for visual, colour in zip(link.visuals, rgba, strict=True)
        ]
        collisions = tuple(_shape(collision) for collision in link.collisions)
        _check_collision_meshes(link.name, collisions, has_mesh)
        links.append(
            Link(
                name=link.name,
                inertial=_inertial(link.inertial),
                collisions=collisions,
                visuals=tuple(_served(link.name, visuals, has_mesh, report)),
            )
        )
    return Parts(read.name, tuple(links), tuple(_joint(joint) for joint in read.joints))


def _kinematics(robot: Element) -> yourdfpy.Robot:
    try:
        return yourdfpy.URDF.load(
            BytesIO(etree.tostring(robot)), build_scene_graph=False, load_meshes=False
        ).robot
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        # Any of these means a fault that the grammar let through; the text is not ours to trust.
        raise ModelError(
            f"the description cannot be read as URDF: {str(error)[:200]}", slug="urdf.unreadable"
        ) from error


def _joint(joint: yourdfpy.Joint) -> Joint:
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
    limit, dynamics = joint.limit, joint.dynamics
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
    )


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


def _shape(part: yourdfpy.Visual | yourdfpy.Collision) -> Shape:
    origin, geometry = _origin(part.origin), part.geometry
    if geometry.box is not None:
        x, y, z = geometry.box.size.tolist()
        return Shape("box", (x, y, z), origin)
    if geometry.sphere is not None:
        return Shape("sphere", (geometry.sphere.radius, 0.0, 0.0), origin)
    if geometry.cylinder is not None:
        cylinder = geometry.cylinder
        return Shape("cylinder", (cylinder.radius, cylinder.length, 0.0), origin)
    if geometry.mesh is not None:
        mesh = geometry.mesh
        return Shape("mesh", _scale(mesh.scale), origin, mesh=mesh.filename)
    raise ModelError("a <geometry> holds no shape", slug="urdf.geometry")


def _scale(scale: float | FloatArray | None) -> Vec3:
    if scale is None:
        return (1.0, 1.0, 1.0)
    x, y, z = np.broadcast_to(scale, 3).tolist()
    return (x, y, z)


def _origin(matrix: FloatArray | None) -> Origin:
    if matrix is None:
        return Origin()
    x, y, z = matrix[:3, 3].tolist()
    if np.array_equal(matrix[:3, :3], np.eye(3)):
        return Origin((x, y, z))
    qx, qy, qz, qw = from_matrix(matrix[:3, :3]).tolist()
    return Origin((x, y, z), (qx, qy, qz, qw))


def _check_collision_meshes(link: str, shapes: Iterable[Shape], has_mesh: HasMesh) -> None:
    for shape in shapes:
        if shape.kind == "mesh" and not has_mesh(shape.mesh):
            raise ModelError(
                f"collision mesh {shape.mesh!r} of link {link!r} is not on the server; "
                "use a box, sphere or cylinder, or send the mesh",
                code=SpawnCode.MISSING_ASSETS,
                slug="urdf.mesh",
            )


def _served(
    link: str, visuals: Iterable[Shape], has_mesh: HasMesh, report: Report
) -> Iterable[Shape]:
    for visual in visuals:
        if visual.kind == "mesh" and not has_mesh(visual.mesh):
            report.suspicious(
                f"link {link!r}", f"visual mesh {visual.mesh!r} is not on the server; not drawn"
            )
        else:
            yield visual
