"""Links of SDF models: inertia, collisions and visuals, with poses in their link."""

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
from zensim.proto.rigid_transforms import compose, from_directions, invert, normalize
from zensim.proto.se3 import to_matrix
from zensim.sim_server.description.link_surfaces import (
    SurfaceParameters,
    SurfaceTagReader,
    find_gazebo_colour,
    read_rgba,
    to_decay_rate,
)
from zensim.sim_server.description.sdf.sdf_values import (
    read_child_numbers,
    read_flag,
    read_pose,
    read_scalar,
    read_text,
    read_vector,
)
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Set

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.meshes.mesh_lookup import MeshPolicy
    from zensim.sim_server.description.report import ParseReport
    from zensim.sim_server.description.sdf.sdf_frames import PoseGraph

GEOMETRY_TAGS = ("box", "sphere", "cylinder", "capsule", "plane", "mesh")
UNSUPPORTED_GEOMETRIES = ("cone", "ellipsoid", "heightmap", "image", "polyline")
UNIT_SIZE: Vec3 = (1.0, 1.0, 1.0)
UP: Vec3 = (0.0, 0.0, 1.0)
GROUND_SLAB_M: Vec3 = (1000.0, 1000.0, 1.0)
GROUND_SLAB_ORIGIN = Origin((0.0, 0.0, -0.5))
"""Centre of a slab relative to its plane."""
SHEET_THICKNESS_M = 0.002
FRICTION_PATHS = ("surface/friction/ode/mu", "surface/friction/bullet/friction")
"""The first that has a text is used."""
SURFACE_PATHS = {
    "mu2": "surface/friction/ode/mu2",
    "fdir1": "surface/friction/ode/fdir1",
    "kp": "surface/contact/ode/kp",
    "kd": "surface/contact/ode/kd",
    "maxVel": "surface/contact/ode/max_vel",
    "minDepth": "surface/contact/ode/min_depth",
}
"""By the names of URDF."""


def read_geometry(part: Element, where: str, report: ParseReport) -> Shape | None:
    """Read the <geometry> of a collision or visual; None and reported when not supported.

    Raises:
        ModelError: It is missing, or a size is not a positive number.
    """
    geometry = part.find("geometry")
    solids = (
        [child for child in geometry if child.tag in GEOMETRY_TAGS] if geometry is not None else []
    )
    if geometry is not None and len(geometry) and not solids:
        tag = geometry[0].tag
        if tag == "empty":
            return None
        fault = "not supported" if tag in UNSUPPORTED_GEOMETRIES else "unknown geometry"
        report.suspicious(f"{where}: <{tag[:80]}>", f"{fault}; left out")
        return None
    if not solids:
        raise ModelError(
            f"{where} has no geometry; write one of {', '.join(GEOMETRY_TAGS)}", slug="sdf.geometry"
        )
    if solids[0].find("submesh") is not None:
        report.suspicious(f"{where}: <submesh>", "not supported; the whole mesh is used")
    return _read_geometry_element(solids[0], where)


def read_surface(collision: Element, where: str, report: ParseReport) -> SurfaceParameters:
    """Read the surface of a collision.

    Raises:
        ModelError: Its friction is not a number >= 0.
    """
    friction = next(
        (path for path in FRICTION_PATHS if read_text(collision, path)), FRICTION_PATHS[0]
    )
    paths = {"mu1": friction} | SURFACE_PATHS
    texts = {tag: text for tag, path in paths.items() if (text := read_text(collision, path))}
    return SurfaceTagReader(texts, subject=where, slug="sdf.friction", report=report).read()


def read_colour(visual: Element, where: str, report: ParseReport) -> Quat | None:
    """Read the colour of a visual: that of a known Gazebo script, else diffuse or ambient.

    Raises:
        ModelError: A colour is not three or four numbers.
    """
    material = visual.find("material")
    if material is None:
        return None
    script = read_text(material, "script/name") or read_text(material, "script")
    if script and (colour := find_gazebo_colour(script)) is not None:
        return colour
    for tag in ("diffuse", "ambient"):
        if text := read_text(material, tag):
            return read_rgba(text, where=f"{where}, {tag}", slug="sdf.number", report=report)
    if script:
        report.unknown(f"{where}: <script>", f"no colour is named {quote(script)}")
    return None


def apply_transparency(colour: Quat | None, transparency: float) -> Quat | None:
    """Apply the transparency of a visual to its colour."""
    if transparency <= 0.0:
        return colour
    r, g, b, a = colour or (1.0, 1.0, 1.0, 1.0)
    return (r, g, b, a * max(0.0, 1.0 - transparency))


def make_ground_slab(plane: Shape) -> Shape:
    """Make the collision of a plane: a wide slab below it; Gazebo's is infinite."""
    return msgspec.structs.replace(
        plane,
        kind="box",
        size=GROUND_SLAB_M,
        origin=compose(plane.origin, GROUND_SLAB_ORIGIN),
    )


def make_visual_sheet(plane: Shape) -> Shape:
    """Make the visual of a plane: a sheet of its size."""
    return msgspec.structs.replace(plane, kind="box", size=(*plane.size[:2], SHEET_THICKNESS_M))


def _read_geometry_element(solid: Element, where: str) -> Shape:
    if solid.tag == "box":
        return _check_size(Shape("box", read_vector(solid, "size", UNIT_SIZE, where)), 3, where)
    if solid.tag == "plane":
        width, depth = read_child_numbers(solid, "size", (1.0, 1.0), where)
        up = Origin(orientation=_rotation_to_normal(solid, where))
        return _check_size(Shape("plane", (width, depth, 0.0), up), 2, where)
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
            f"{where}: {shape.kind} of size {shape.size[:count]}; use sizes > 0",
            slug="sdf.size",
        )
    return shape


def _rotation_to_normal(plane: Element, where: str) -> Quat:
    """Find the shortest rotation from z to the plane's normal."""
    normal = read_vector(plane, "normal", UP, where)
    length = math.hypot(*normal)
    if length == 0.0 or not math.isfinite(length):
        raise ModelError(
            f"{where}: the plane's normal is {normal}; write one such as 0 0 1", slug="sdf.size"
        )
    return from_directions(UP, normalize(normal))


DEFAULT_MOMENTS = {"ixx": 1.0, "ixy": 0.0, "ixz": 0.0, "iyy": 1.0, "iyz": 0.0, "izz": 1.0}
"""SDF's defaults [kg m^2]."""
DEFAULT_INERTIAL = Inertial(mass_kg=1.0, inertia=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
"""SDF's default for a link without <inertial>."""


@dataclass(frozen=True)
class LinkElement:
    """A <link>, the scoped name of its model, and its scoped name."""

    element: Element
    scope: str
    name: str


@dataclass(frozen=True)
class SdfLinkReader:
    """Reads the links of one top model."""

    frames: PoseGraph
    policy: MeshPolicy
    report: ParseReport
    is_static: bool
    self_colliding: Set[str] = frozenset()
    """Scopes of models whose links collide with each other."""

    def read(self, tag: LinkElement) -> Link:
        """Read a link.

        Raises:
            ModelError: A value is not a number, a size is not positive, or a mesh is missing.
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
            self.report.suspicious(where, "has no <inertia>; SDF's default 1 kg m^2 is used")
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
            if self.policy.can_use(shape, where, collides=True, report=self.report):
                kept.append(read_surface(element, where, self.report).apply_to_shape(shape))
        return kept

    def _read_visuals(self, tag: LinkElement) -> list[Shape]:
        kept = []
        for element in tag.element.findall("visual"):
            where = _describe_place(tag, element)
            shape = self._read_shape(tag, element, where)
            if shape is not None and self.policy.can_use(
                shape, where, collides=False, report=self.report
            ):
                shape = make_visual_sheet(shape) if shape.kind == "plane" else shape
                colour = read_colour(element, where, self.report)
                transparency = read_scalar(element, "transparency", 0.0, where)
                kept.append(
                    msgspec.structs.replace(shape, rgba=apply_transparency(colour, transparency))
                )
        return kept

    def _read_shape(self, tag: LinkElement, element: Element, where: str) -> Shape | None:
        origin = self._read_origin(tag, element, where)
        shape = read_geometry(element, where, self.report)
        if shape is None:
            return None
        return msgspec.structs.replace(shape, origin=compose(origin, shape.origin))

    def _read_origin(self, tag: LinkElement, element: Element, where: str) -> Origin:
        pose = read_pose(element, where)
        if not pose.frame:
            return pose.origin
        outer = self.frames.pose(self.frames.full_name(tag.scope, pose.frame))
        return compose(invert(self.frames.pose(tag.name)), compose(outer, pose.origin))


def _describe_place(tag: LinkElement, element: Element) -> str:
    return f"link {quote(tag.name)}, {element.tag} {quote(element.get('name'))}"
