"""Links of SDF models: inertia, collisions and visuals, each placed in its link."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import (
    Decay,
    Inertial,
    Link,
    Origin,
    Shape,
    Vec3,
)
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.rigid_transforms import compose, from_directions, invert, normalize
from zensim.proto.se3 import to_matrix
from zensim.sim_server.description.link_surfaces import (
    SurfaceParameters,
    SurfaceTagReader,
    find_gazebo_colour,
    to_decay_rate,
)
from zensim.sim_server.description.sdf.sdf_values import (
    read_flag,
    read_pose,
    read_scalar,
    read_text,
    read_vector,
)
from zensim.sim_server.description.strict_parsing import quote, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Set

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.meshes.mesh_lookup import MeshPolicy
    from zensim.sim_server.description.report import ParseReport
    from zensim.sim_server.description.sdf.sdf_frames import PoseGraph

GEOMETRY_TAGS = ("box", "sphere", "cylinder", "capsule", "plane", "mesh")
_NO_SUCH_SHAPE = "no engine here has it"
UNSUPPORTED_GEOMETRIES = {
    "cone": _NO_SUCH_SHAPE,
    "ellipsoid": _NO_SUCH_SHAPE,
    "heightmap": "heightmaps are not simulated",
    "image": "made of an image",
    "polyline": "extruded outlines are not simulated",
}
UNIT_SIZE: Vec3 = (1.0, 1.0, 1.0)
UP: Vec3 = (0.0, 0.0, 1.0)
RGB_COUNT = 3
GROUND_SLAB_M: Vec3 = (1000.0, 1000.0, 1.0)
GROUND_SLAB_ORIGIN = Origin((0.0, 0.0, -0.5))
"""Where the middle of a slab is below its plane."""
SHEET_THICKNESS_M = 0.002
FRICTION_PATHS = ("surface/friction/ode/mu", "surface/friction/bullet/friction")
"""Where a collision says how rough it is; the first counts."""
SURFACE_PATHS = {
    "mu2": "surface/friction/ode/mu2",
    "fdir1": "surface/friction/ode/fdir1",
    "kp": "surface/contact/ode/kp",
    "kd": "surface/contact/ode/kd",
    "maxVel": "surface/contact/ode/max_vel",
    "minDepth": "surface/contact/ode/min_depth",
}
"""Where it says the rest, by the names of URDF."""


def read_geometry(part: Element, where: str, report: ParseReport) -> Shape | None:
    """Read the <geometry> of a collision or visual; None, noted, when it is not supported.

    Raises:
        ModelError: There is none, or a size is no number.
    """
    geometry = part.find("geometry")
    solids = (
        [child for child in geometry if child.tag in GEOMETRY_TAGS] if geometry is not None else []
    )
    if geometry is not None and len(geometry) and not solids:
        tag = geometry[0].tag
        if tag == "empty":
            return None
        report.suspicious(
            f"{where}: <{tag[:80]}>",
            f"not supported: {UNSUPPORTED_GEOMETRIES.get(tag, 'not known')}; left out",
        )
        return None
    if not solids:
        raise ModelError(
            f"{where} has no geometry; write one of {', '.join(GEOMETRY_TAGS)}", slug="sdf.geometry"
        )
    if solids[0].find("submesh") is not None:
        report.suspicious(f"{where}: <submesh>", "not supported; the whole mesh is used")
    return _read_geometry_element(solids[0], where)


def read_surface(collision: Element, where: str, report: ParseReport) -> SurfaceParameters:
    """Read how a collision touches.

    Raises:
        ModelError: Its friction is no number, or negative.
    """
    friction = next(
        (path for path in FRICTION_PATHS if read_text(collision, path)), FRICTION_PATHS[0]
    )
    paths = {"mu1": friction} | SURFACE_PATHS
    texts = {tag: text for tag, path in paths.items() if (text := read_text(collision, path))}
    return SurfaceTagReader(texts, subject=where, slug="sdf.friction", report=report).read()


def read_colour(visual: Element, where: str, report: ParseReport) -> Quat | None:
    """Read the colour of a visual: its script's when Gazebo ships that, else diffuse or ambient.

    Raises:
        ModelError: A colour is no numbers.
    """
    material = visual.find("material")
    if material is None:
        return None
    script = read_text(material, "script/name") or read_text(material, "script")
    if script and (colour := find_gazebo_colour(script)) is not None:
        return colour
    for tag in ("diffuse", "ambient"):
        if text := read_text(material, tag):
            return _read_rgba(text, f"{where}, {tag}", report)
    if script:
        report.unknown(f"{where}: <script>", f"no colour is called {quote(script)}")
    return None


def apply_transparency(colour: Quat | None, transparency: float) -> Quat | None:
    """Make a colour as transparent as its visual."""
    if transparency <= 0.0:
        return colour
    r, g, b, a = colour or (1.0, 1.0, 1.0, 1.0)
    return (r, g, b, a * max(0.0, 1.0 - transparency))


def has_usable_mesh(
    shape: Shape, where: str, *, rule: MeshPolicy, report: ParseReport, collides: bool
) -> bool:
    """Whether a shape can be used: no mesh, or one that is here.

    Raises:
        ModelError: A collision's mesh is not here, and may not be missing.
    """
    if shape.kind != "mesh" or rule.has_mesh(shape.mesh):
        return True
    fault = f"mesh {quote(shape.mesh)} is not on the server"
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


def transform_shape(shape: Shape, origin: Origin) -> Shape:
    """Put a shape, placed in its own frame, where that frame is."""
    return msgspec.structs.replace(shape, origin=compose(origin, shape.origin))


def make_ground_slab(plane: Shape) -> Shape:
    """Make the solid that a plane is to others: a wide slab below it, endless in Gazebo."""
    return msgspec.structs.replace(
        plane,
        kind="box",
        size=GROUND_SLAB_M,
        origin=compose(plane.origin, GROUND_SLAB_ORIGIN),
    )


def make_visual_sheet(plane: Shape) -> Shape:
    """Make the solid that a plane looks like: a sheet of its size."""
    return msgspec.structs.replace(plane, kind="box", size=(*plane.size[:2], SHEET_THICKNESS_M))


def _read_geometry_element(solid: Element, where: str) -> Shape:
    if solid.tag == "box":
        return _check_size(Shape("box", read_vector(solid, "size", UNIT_SIZE, where)), 3, where)
    if solid.tag == "plane":
        size = read_numbers(
            read_text(solid, "size", "1 1"), counts=(2,), where=f"{where}, size", slug="sdf.number"
        )
        up = Origin(orientation=_rotation_to_normal(solid, where))
        return _check_size(Shape("plane", (*size, 0.0), up), 2, where)  # type: ignore[arg-type]
    if solid.tag == "mesh":
        uri, scale = read_text(solid, "uri"), read_vector(solid, "scale", UNIT_SIZE, where)
        if not uri:
            raise ModelError(f"{where}: its mesh has no <uri>; write one", slug="sdf.uri")
        if 0.0 in scale:
            raise ModelError(f"{where}: its mesh has scale 0; write 1 1 1", slug="sdf.size")
        return Shape("mesh", scale, mesh=uri)
    radius = read_scalar(solid, "radius", 1.0 if solid.tag == "sphere" else 0.5, where)
    if solid.tag == "sphere":
        return _check_size(Shape("sphere", (radius, 0.0, 0.0)), 1, where)
    length = read_scalar(solid, "length", 1.0, where)
    kind = "cylinder" if solid.tag == "cylinder" else "capsule"
    return _check_size(Shape(kind, (radius, length, 0.0)), 2, where)  # type: ignore[arg-type]


def _check_size(shape: Shape, count: int, where: str) -> Shape:
    if min(shape.size[:count]) <= 0.0:
        raise ModelError(
            f"{where}: {shape.kind} of size {shape.size[:count]}; sizes must be > 0",
            slug="sdf.size",
        )
    return shape


def _rotation_to_normal(plane: Element, where: str) -> Quat:
    """Find the shortest turn that takes z to the plane's normal."""
    normal = read_vector(plane, "normal", UP, where)
    length = math.hypot(*normal)
    if length == 0.0 or not math.isfinite(length):
        raise ModelError(
            f"{where}: a plane's normal is {normal}; write one such as 0 0 1", slug="sdf.size"
        )
    return from_directions(UP, normalize(normal))


def _read_rgba(text: str, where: str, report: ParseReport) -> Quat:
    written = read_numbers(text, counts=(3, 4), where=where, slug="sdf.number")
    if len(written) == RGB_COUNT:
        written = (*written, 1.0)
    r, g, b, a = (min(max(part, 0.0), 1.0) for part in written)
    if (r, g, b, a) != written:
        report.suspicious(where, "colours lie in 0 to 1; cut to it")
    return (r, g, b, a)


DEFAULT_MOMENTS = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
"""What SDF takes where one is not written [kg m^2]."""
DEFAULT_INERTIAL = Inertial(mass_kg=1.0, inertia=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
"""What SDF takes for a link without <inertial>."""


@dataclass(frozen=True)
class LinkElement:
    """A <link>, the scoped name of the model that it is in, and its own."""

    element: Element
    scope: str
    name: str


@dataclass(frozen=True)
class SdfLinkReader:
    """Reads links of one top model."""

    frames: PoseGraph
    rule: MeshPolicy
    report: ParseReport
    is_static: bool
    self_colliding: Set[str] = frozenset()
    """Scopes of models whose links touch each other."""

    def read(self, tag: LinkElement) -> Link:
        """Read a link.

        Raises:
            ModelError: A number is none, a size is not positive, or a collision's mesh is missing.
        """
        where, inertial = f"link {quote(tag.name)}", self._read_inertial(tag)
        has_gravity = read_flag(tag.element, "gravity", default=True, where=where)
        return Link(
            tag.name,
            inertial,
            tuple(self._read_collisions(tag)),
            tuple(self._read_visuals(tag)),
            weightless=Inertial() if has_gravity else inertial,
            decay=Decay(*(self._read_decay(tag, part) for part in ("linear", "angular"))),
            self_collides=tag.scope in self.self_colliding
            or read_flag(tag.element, "self_collide", default=False, where=where),
        )

    def _read_decay(self, tag: LinkElement, part: str) -> float:
        where = f"link {quote(tag.name)}"
        share = read_scalar(tag.element, f"velocity_decay/{part}", 0.0, where)
        return to_decay_rate(max(share, 0.0))

    def _read_inertial(self, tag: LinkElement) -> Inertial:
        inertial, where = tag.element.find("inertial"), f"link {quote(tag.name)}, inertial"
        if inertial is None:
            return Inertial()
        origin = self._read_origin(tag, inertial, where)
        matrix = inertial.find("inertia")
        if matrix is None:
            self.report.suspicious(where, "has no <inertia>; 1 kg m^2 is used, as by SDF")
            moments = tuple(DEFAULT_MOMENTS.values())
        else:
            moments = tuple(read_scalar(matrix, n, d, where) for n, d in DEFAULT_MOMENTS.items())
        ixx, ixy, ixz, iyy, iyz, izz = moments
        turn = to_matrix(np.array(origin.orientation))
        turned = turn @ np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) @ turn.T
        ixx, ixy, ixz, _, iyy, iyz, _, _, izz = turned.ravel().tolist()
        return Inertial(
            read_scalar(inertial, "mass", 1.0, where),
            origin.position,
            (ixx, ixy, ixz, iyy, iyz, izz),
        )

    def _read_collisions(self, tag: LinkElement) -> list[Shape]:
        kept = []
        for element in tag.element.findall("collision"):
            where = _describe_place(tag, element)
            shape = self._read_shape(tag, element, where)
            if shape is None:
                continue
            if shape.kind == "plane" and not self.is_static:
                self.report.suspicious(where, "a plane collides in static models only; left out")
                continue
            shape = make_ground_slab(shape) if shape.kind == "plane" else shape
            if has_usable_mesh(shape, where, rule=self.rule, report=self.report, collides=True):
                kept.append(read_surface(element, where, self.report).apply_to_shape(shape))
        return kept

    def _read_visuals(self, tag: LinkElement) -> list[Shape]:
        kept = []
        for element in tag.element.findall("visual"):
            where = _describe_place(tag, element)
            shape = self._read_shape(tag, element, where)
            if shape is not None and has_usable_mesh(
                shape, where, rule=self.rule, report=self.report, collides=False
            ):
                shape = make_visual_sheet(shape) if shape.kind == "plane" else shape
                colour = read_colour(element, where, self.report)
                through = read_scalar(element, "transparency", 0.0, where)
                kept.append(
                    msgspec.structs.replace(shape, rgba=apply_transparency(colour, through))
                )
        return kept

    def _read_shape(self, tag: LinkElement, element: Element, where: str) -> Shape | None:
        origin = self._read_origin(tag, element, where)
        shape = read_geometry(element, where, self.report)
        return None if shape is None else transform_shape(shape, origin)

    def _read_origin(self, tag: LinkElement, element: Element, where: str) -> Origin:
        pose = read_pose(element, where)
        if not pose.frame:
            return pose.origin
        outer = self.frames.pose(self.frames.full_name(tag.scope, pose.frame))
        return compose(invert(self.frames.pose(tag.name)), compose(outer, pose.origin))


def _describe_place(tag: LinkElement, element: Element) -> str:
    return f"link {quote(tag.name)}, {element.tag} {quote(element.get('name'))}"
