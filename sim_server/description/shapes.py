"""Collisions and visuals as a URDF lists them; meshes that are not here are noted or refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Origin, Shape, Vec3
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.rotation import from_rpy
from zensim.sim_server.description.colours import colour_of
from zensim.sim_server.description.decimals import read_numbers
from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.assets import HasMesh
    from zensim.sim_server.description.report import Report

ROUND = {"sphere": ("radius",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}
"""Attributes that make the size, by kind."""


@dataclass(frozen=True)
class MeshRule:
    """Which meshes are here, and whether a robot may do without those of collisions."""

    has_mesh: HasMesh
    allow_missing: bool = False


def read_collisions(link: Element, rule: MeshRule, report: Report) -> tuple[Shape, ...]:
    """Read the collisions of a <link>.

    Raises:
        ModelError: A mesh is not here, and may not be missing.
    """
    name = link.get("name") or ""
    shapes = [_shape(collision) for collision in link.findall("collision")]
    kept = []
    for shape in shapes:
        if shape.kind == "mesh" and not rule.has_mesh(shape.mesh):
            _miss_collision(name, shape.mesh, rule, report)
        else:
            kept.append(shape)
    return tuple(kept)


def read_visuals(
    link: Element, rule: MeshRule, colours: dict[str, Quat], report: Report
) -> tuple[Shape, ...]:
    """Read the visuals of a <link>; those whose mesh is not here, or without a size, are noted."""
    name = link.get("name") or ""
    shapes = [
        msgspec.structs.replace(_shape(visual), rgba=colour_of(visual, colours, report))
        for visual in link.findall("visual")
    ]
    kept = []
    for number, shape in enumerate(shapes, start=1):
        which = f"link {shown(name)}" + (f", visual {number}" if len(shapes) > 1 else "")
        if shape.kind == "mesh" and not rule.has_mesh(shape.mesh):
            report.suspicious(
                which, f"visual mesh {shown(shape.mesh)} is not on the server; not drawn"
            )
        elif shape.kind != "mesh" and not any(shape.size):
            report.suspicious(which, f"{shape.kind} of size 0; not drawn")
        else:
            kept.append(shape)
    return tuple(kept)


def read_origin(part: Element) -> Origin:
    """Read the <origin> of a part; identity when there is none."""
    origin = part.find("origin")
    if origin is None:
        return Origin()
    x, y, z = _numbers(origin, "xyz", 3)
    rpy = _numbers(origin, "rpy", 3)
    if not any(rpy):
        return Origin((x, y, z))
    qx, qy, qz, qw = from_rpy(*rpy).tolist()
    return Origin((x, y, z), (qx, qy, qz, qw))


def _shape(part: Element) -> Shape:
    geometry = part.find("geometry")
    if geometry is None or not len(geometry):
        raise ModelError("a part of a link has no geometry; add one", slug="urdf.geometry")
    solid, origin = geometry[0], read_origin(part)
    if solid.tag == "box":
        x, y, z = _numbers(solid, "size", 3)
        return Shape("box", (x, y, z), origin)
    if solid.tag == "mesh":
        return Shape("mesh", _scale(solid), origin, mesh=(solid.get("filename") or "").strip())
    radius, *length = (_numbers(solid, name, 1)[0] for name in ROUND[solid.tag])
    size = (radius, length[0] if length else 0.0, 0.0)
    if solid.tag == "sphere":
        return Shape("sphere", size, origin)
    return Shape("cylinder" if solid.tag == "cylinder" else "capsule", size, origin)


def _scale(mesh: Element) -> Vec3:
    written = read_numbers(
        mesh.get("scale", "1"), counts=(1, 3), where="mesh, scale", slug="urdf.number"
    )
    x, y, z = np.broadcast_to(written, 3).tolist()
    return (x, y, z)


def _numbers(element: Element, name: str, count: int) -> tuple[float, ...]:
    written = element.get(name, " ".join(["0"] * count))
    return read_numbers(
        written, counts=(count,), where=f"{element.tag}, {name}", slug="urdf.number"
    )


def _miss_collision(link: str, uri: str, rule: MeshRule, report: Report) -> None:
    fault = f"collision mesh {shown(uri)} of link {shown(link)} is not on the server"
    if not rule.allow_missing:
        raise ModelError(
            f"{fault}; send the mesh, use a box, sphere or cylinder, or allow it to be missing",
            code=SpawnCode.MISSING_ASSETS,
            slug="mesh.missing",
        )
    report.suspicious(f"link {shown(link)}", f"{fault}; nothing collides there")
