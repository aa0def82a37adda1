"""Collisions and visuals of SDF links: solids, friction, colours."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import IDENTITY, Origin, Shape, Vec3
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.colours import gazebo_colour
from zensim.sim_server.description.decimals import read_numbers
from zensim.sim_server.description.sdf_values import read_scalar, read_text, read_vector
from zensim.sim_server.description.surface import Surface, SurfaceTags
from zensim.sim_server.description.transforms import compose
from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.report import Report
    from zensim.sim_server.description.shapes import MeshRule

SOLIDS = ("box", "sphere", "cylinder", "capsule", "plane", "mesh")
CONES = "no engine here has it"
UNSUPPORTED = {
    "cone": CONES,
    "ellipsoid": CONES,
    "heightmap": "heightmaps are not simulated",
    "image": "made of an image",
    "polyline": "extruded outlines are not simulated",
}
BOX_SIZE: Vec3 = (1.0, 1.0, 1.0)
UP: Vec3 = (0.0, 0.0, 1.0)
RGB = 3
SLAB_M: Vec3 = (1000.0, 1000.0, 1.0)
LOWERED = Origin((0.0, 0.0, -0.5))
"""Where the middle of a slab is below its plane."""
SHEET_M = 0.002
FRICTION = ("surface/friction/ode/mu", "surface/friction/bullet/friction")
"""Where a collision says how rough it is; the first counts."""
SURFACE = {
    "mu2": "surface/friction/ode/mu2",
    "fdir1": "surface/friction/ode/fdir1",
    "kp": "surface/contact/ode/kp",
    "kd": "surface/contact/ode/kd",
    "maxVel": "surface/contact/ode/max_vel",
    "minDepth": "surface/contact/ode/min_depth",
}
"""Where it says the rest, by the names of URDF."""


def read_solid(part: Element, where: str, report: Report) -> Shape | None:
    """Read the <geometry> of a collision or visual; None, noted, when it is not supported.

    Raises:
        ModelError: There is none, or a size is no number.
    """
    geometry = part.find("geometry")
    solids = [child for child in geometry if child.tag in SOLIDS] if geometry is not None else []
    if geometry is not None and len(geometry) and not solids:
        tag = geometry[0].tag
        if tag == "empty":
            return None
        report.suspicious(
            f"{where}: <{tag[:80]}>",
            f"not supported: {UNSUPPORTED.get(tag, 'not known')}; left out",
        )
        return None
    if not solids:
        raise ModelError(
            f"{where} has no geometry; write one of {', '.join(SOLIDS)}", slug="sdf.geometry"
        )
    if solids[0].find("submesh") is not None:
        report.suspicious(f"{where}: <submesh>", "not supported; the whole mesh is used")
    return _solid(solids[0], where)


def surface_of(collision: Element, where: str, report: Report) -> Surface:
    """Read how a collision touches.

    Raises:
        ModelError: Its friction is no number, or negative.
    """
    friction = next((path for path in FRICTION if read_text(collision, path)), FRICTION[0])
    paths = {"mu1": friction} | SURFACE
    texts = {tag: text for tag, path in paths.items() if (text := read_text(collision, path))}
    return SurfaceTags(texts, subject=where, slug="sdf.friction", report=report).read()


def colour_of(visual: Element, where: str, report: Report) -> Quat | None:
    """Read the colour of a visual: its script's when Gazebo ships that, else diffuse or ambient.

    Raises:
        ModelError: A colour is no numbers.
    """
    material = visual.find("material")
    if material is None:
        return None
    script = read_text(material, "script/name") or read_text(material, "script")
    if script and (colour := gazebo_colour(script)) is not None:
        return colour
    for tag in ("diffuse", "ambient"):
        if text := read_text(material, tag):
            return _rgba(text, f"{where}, {tag}", report)
    if script:
        report.unknown(f"{where}: <script>", f"no colour is called {shown(script)}")
    return None


def seen_through(colour: Quat | None, transparency: float) -> Quat | None:
    """Make a colour as transparent as its visual."""
    if transparency <= 0.0:
        return colour
    r, g, b, a = colour or (1.0, 1.0, 1.0, 1.0)
    return (r, g, b, a * max(0.0, 1.0 - transparency))


def is_here(shape: Shape, where: str, *, rule: MeshRule, report: Report, collides: bool) -> bool:
    """Whether a shape can be used: no mesh, or one that is here.

    Raises:
        ModelError: A collision's mesh is not here, and may not be missing.
    """
    if shape.kind != "mesh" or rule.has_mesh(shape.mesh):
        return True
    fault = f"mesh {shown(shape.mesh)} is not on the server"
    if not collides:
        report.suspicious(where, f"visual {fault}; not drawn")
    elif rule.allow_missing:
        report.suspicious(where, f"collision {fault}; nothing collides there")
    else:
        raise ModelError(
            f"{where}: collision {fault}; send the mesh, use a box, sphere or cylinder, "
            "or allow it to be missing",
            code=SpawnCode.MISSING_ASSETS,
            slug="mesh.missing",
        )
    return False


def moved(shape: Shape, origin: Origin) -> Shape:
    """Put a shape, placed in its own frame, where that frame is."""
    return msgspec.structs.replace(shape, origin=compose(origin, shape.origin))


def slab_of(plane: Shape) -> Shape:
    """Make the solid that a plane is to others: a wide slab below it, endless in Gazebo."""
    return msgspec.structs.replace(
        plane, kind="box", size=SLAB_M, origin=compose(plane.origin, LOWERED)
    )


def sheet_of(plane: Shape) -> Shape:
    """Make the solid that a plane looks like: a sheet of its size."""
    return msgspec.structs.replace(plane, kind="box", size=(*plane.size[:2], SHEET_M))


def _solid(solid: Element, where: str) -> Shape:
    if solid.tag == "box":
        return _checked(Shape("box", read_vector(solid, "size", BOX_SIZE, where)), 3, where)
    if solid.tag == "plane":
        size = read_numbers(
            read_text(solid, "size", "1 1"), counts=(2,), where=f"{where}, size", slug="sdf.number"
        )
        up = Origin(orientation=_up_to(solid, where))
        return _checked(Shape("plane", (*size, 0.0), up), 2, where)  # type: ignore[arg-type]
    if solid.tag == "mesh":
        uri, scale = read_text(solid, "uri"), read_vector(solid, "scale", BOX_SIZE, where)
        if not uri:
            raise ModelError(f"{where}: its mesh has no <uri>; write one", slug="sdf.uri")
        if 0.0 in scale:
            raise ModelError(f"{where}: its mesh has scale 0; write 1 1 1", slug="sdf.size")
        return Shape("mesh", scale, mesh=uri)
    radius = read_scalar(solid, "radius", 1.0 if solid.tag == "sphere" else 0.5, where)
    if solid.tag == "sphere":
        return _checked(Shape("sphere", (radius, 0.0, 0.0)), 1, where)
    length = read_scalar(solid, "length", 1.0, where)
    kind = "cylinder" if solid.tag == "cylinder" else "capsule"
    return _checked(Shape(kind, (radius, length, 0.0)), 2, where)  # type: ignore[arg-type]


def _checked(shape: Shape, count: int, where: str) -> Shape:
    if min(shape.size[:count]) <= 0.0:
        raise ModelError(
            f"{where}: {shape.kind} of size {shape.size[:count]}; sizes must be > 0",
            slug="sdf.size",
        )
    return shape


def _up_to(plane: Element, where: str) -> Quat:
    """Find the shortest turn that takes z to the plane's normal."""
    x, y, z = normal = read_vector(plane, "normal", UP, where)
    length = math.hypot(*normal)
    if length == 0.0 or not math.isfinite(length):
        raise ModelError(
            f"{where}: a plane's normal is {normal}; write one such as 0 0 1", slug="sdf.size"
        )
    if normal == UP:
        return IDENTITY
    w = length + z
    if w < 1e-9 * length:
        return (1.0, 0.0, 0.0, 0.0)
    turn = np.array([-y, x, 0.0, w])
    qx, qy, qz, qw = (turn / np.linalg.norm(turn)).tolist()
    return (qx, qy, qz, qw)


def _rgba(text: str, where: str, report: Report) -> Quat:
    written = read_numbers(text, counts=(3, 4), where=where, slug="sdf.number")
    if len(written) == RGB:
        written = (*written, 1.0)
    r, g, b, a = (min(max(part, 0.0), 1.0) for part in written)
    if (r, g, b, a) != written:
        report.suspicious(where, "colours lie in 0 to 1; cut to it")
    return (r, g, b, a)
