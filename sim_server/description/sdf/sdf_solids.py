"""What the parts of an SDF link have: geometry, surface, colour, texture; and lights."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, get_args

import msgspec

from zensim.proto.messages.model_messages import (
    DOWNWARD,
    Light,
    LightKind,
    Origin,
    Shape,
    Texture,
    Vec3,
)
from zensim.proto.rigid_transforms import compose, from_directions, normalize, rotate
from zensim.sim_server.description.link_surfaces import (
    SurfaceParameters,
    SurfaceTagReader,
    read_gazebo_material,
    read_rgba,
    read_surface_texts,
)
from zensim.sim_server.description.meshes.generated_solids import (
    make_cone,
    make_ellipsoid,
    make_prisms,
)
from zensim.sim_server.description.sdf.sdf_values import (
    read_child_numbers,
    read_flag,
    read_scalar,
    read_text,
    read_vector,
)
from zensim.sim_server.description.strict_parsing import quote, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Quat
    from zensim.sim_server.description.report import ParseReport


GEOMETRY_TAGS = (
    "box", "sphere", "cylinder", "capsule", "plane", "mesh", "ellipsoid", "cone", "polyline",
)  # fmt: skip
UNSUPPORTED_GEOMETRIES = {
    "heightmap": "heightmaps are not simulated; use a mesh",
    "image": "shapes from images are not simulated; use a mesh",
}
MAX_POLYLINE_POINTS = 100
MIN_POLYLINE_POINTS = 3
UNIT_SIZE: Vec3 = (1.0, 1.0, 1.0)
UP: Vec3 = (0.0, 0.0, 1.0)
GROUND_SLAB_M: Vec3 = (1000.0, 1000.0, 1.0)
GROUND_SLAB_ORIGIN = Origin((0.0, 0.0, -0.5))
"""Centre of a slab relative to its plane."""
SHEET_THICKNESS_M = 0.002
EXTENT_TAGS = ("size", "scale", "radius", "length", "radii")
MAX_POLYLINE_M = 1e6
ALBEDO_PATHS = ("material/pbr/metal/albedo_map", "material/pbr/specular/albedo_map")
LIGHT_KINDS: dict[str, LightKind] = {kind: kind for kind in get_args(LightKind)}


def read_geometry(part: Element, where: str, report: ParseReport) -> list[Shape]:
    """Read the <geometry> of a collision or visual; empty and reported when not supported.

    Raises:
        ModelError: That of a collision is missing, or a size is not a positive number.
    """
    geometry = part.find("geometry")
    solids = (
        [child for child in geometry if child.tag in GEOMETRY_TAGS] if geometry is not None else []
    )
    if geometry is not None and len(geometry) and not solids:
        tag = geometry[0].tag
        if tag != "empty":
            fault = UNSUPPORTED_GEOMETRIES.get(tag, "unknown geometry")
            report.suspicious(f"{where}: <{tag[:80]}>", f"{fault}; left out")
        return []
    if not solids and part.tag == "visual":
        report.suspicious(where, "has no geometry; not drawn")
        return []
    if not solids:
        raise ModelError(
            f"{where} has no geometry; write one of {', '.join(GEOMETRY_TAGS)}", slug="sdf.geometry"
        )
    if solids[0].tag == "polyline":
        return _read_polylines(solids, where, report)
    _report_unused_shapes(solids, where, report)
    if _has_no_extent(solids[0]):
        report.suspicious(where, f"<{solids[0].tag}> of size 0; left out")
        return []
    return [_read_geometry_element(solids[0], where)]


def _report_unused_shapes(solids: Sequence[Element], where: str, report: ParseReport) -> None:
    if len(solids) > 1:
        report.suspicious(f"{where}: <geometry>", f"{len(solids)} shapes; the first is used")
    if solids[0].find("submesh") is not None:
        report.suspicious(f"{where}: <submesh>", "not supported; the whole mesh is used")


def _has_no_extent(solid: Element) -> bool:
    """Whether one of its sizes is written as 0."""
    words = " ".join(read_text(solid, tag) for tag in EXTENT_TAGS).split()
    return any("0" in word and not word.strip("+-0.") for word in words)


def _read_polylines(polylines: Sequence[Element], where: str, report: ParseReport) -> list[Shape]:
    """Read outlines that are extruded along z; an outline within another is a hole in SDF."""
    if len(polylines) > 1:
        report.suspicious(f"{where}: <polyline>", "given more than once; holes are filled")
    shapes: list[Shape] = []
    for polyline in polylines:
        texts = [point.text for point in polyline.findall("point")]
        if not MIN_POLYLINE_POINTS <= len(texts) <= MAX_POLYLINE_POINTS:
            raise ModelError(
                f"{where}: a polyline has {len(texts)} points; "
                f"use {MIN_POLYLINE_POINTS} to {MAX_POLYLINE_POINTS}",
                slug="sdf.size",
            )
        points = [read_numbers(text, counts=(2,), where=where, slug="sdf.number") for text in texts]
        height = read_scalar(polyline, "height", 1.0, where)
        if height <= 0.0 or max(abs(value) for point in points for value in point) > MAX_POLYLINE_M:
            raise ModelError(f"{where}: a polyline is too flat or too wide", slug="sdf.size")
        shapes += make_prisms([(x, y) for x, y in points], height)
    return shapes


def read_surface(collision: Element, where: str, report: ParseReport) -> SurfaceParameters:
    """Read the surface of a collision.

    Raises:
        ModelError: Its friction is not a number >= 0.
    """
    texts = read_surface_texts(collision)
    return SurfaceTagReader(texts, subject=where, slug="sdf.friction", report=report).read()


def read_colour(visual: Element, where: str, report: ParseReport) -> Quat | None:
    """Read the colour of a visual: that of a known Gazebo script, else diffuse or ambient.

    Raises:
        ModelError: A colour is not three or four numbers.
    """
    material = visual.find("material")
    if material is None:
        return None
    return read_gazebo_material(material, where=where, slug="sdf.number", report=report)


def read_texture(visual: Element) -> Texture | None:
    """Read the image of a visual's physically based material."""
    named = (read_text(visual, path) for path in ALBEDO_PATHS)
    return next((Texture(uri) for uri in named if uri), None)


def read_light(light: Element, origin: Origin, report: ParseReport) -> Light | None:
    """Read a <light>; None and reported when its type is unknown or it is off.

    Args:
        light: Of a world or a link.
        origin: Its pose in its owner's frame.
        report: Gets what was read.

    Raises:
        ModelError: A value is not a number.
    """
    where = f"light {quote(light.get('name'))}"
    kind = LIGHT_KINDS.get(light.get("type") or "")
    if kind is None:
        report.unknown(where, f"unknown light type {quote(light.get('type'))}")
        return None
    if not read_flag(light, "light_on", default=True, where=where):
        report.applied(where, "off")
        return None
    report.applied(where, kind)
    diffuse, default = read_text(light, "diffuse"), Light("", kind)
    factors = zip(("constant", "linear", "quadratic"), default.attenuation, strict=True)
    constant, linear, quadratic = (
        max(read_scalar(light, f"attenuation/{tag}", value, where), 0.0) for tag, value in factors
    )
    return Light(
        name=(light.get("name") or "")[:80],
        kind=kind,
        origin=origin,
        direction=rotate(origin.orientation, read_vector(light, "direction", DOWNWARD, where)),
        rgba=read_rgba(diffuse, where=f"{where}, diffuse", slug="sdf.number", report=None)
        if diffuse
        else default.rgba,
        intensity=max(read_scalar(light, "intensity", default.intensity, where), 0.0),
        range_m=max(read_scalar(light, "attenuation/range", default.range_m, where), 0.0),
        attenuation=(constant, linear, quadratic),
        outer_angle_rad=max(read_scalar(light, "spot/outer_angle", 0.0, where), 0.0),
        casts_shadows=read_flag(light, "cast_shadows", default=False, where=where),
    )


def apply_transparency(colour: Quat | None, transparency: float) -> Quat | None:
    """Apply the transparency of a visual to its colour."""
    if transparency <= 0.0:
        return colour
    r, g, b, a = colour or (1.0, 1.0, 1.0, 1.0)
    return (r, g, b, a * max(0.0, 1.0 - transparency))


def make_ground_slab(plane: Shape) -> Shape:
    """Make the collision of a plane: a wide slab below it; Gazebo's is infinite."""
    return msgspec.structs.replace(
        plane, kind="box", size=GROUND_SLAB_M, origin=compose(plane.origin, GROUND_SLAB_ORIGIN)
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
        return Shape("mesh", scale, mesh=uri)
    return _read_round_solid(solid, where)


def _read_round_solid(solid: Element, where: str) -> Shape:
    if solid.tag == "ellipsoid":
        radii = read_vector(solid, "radii", UNIT_SIZE, where)
        return _check_size(make_ellipsoid(radii), 3 if len(set(radii)) > 1 else 1, where)
    radius = read_scalar(solid, "radius", 1.0 if solid.tag == "sphere" else 0.5, where)
    if solid.tag == "sphere":
        return _check_size(Shape("sphere", (radius, 0.0, 0.0)), 1, where)
    length = read_scalar(solid, "length", 1.0, where)
    if solid.tag == "cone":
        return _check_size(make_cone(radius, length), 3, where)
    kind = "cylinder" if solid.tag == "cylinder" else "capsule"
    return _check_size(Shape(kind, (radius, length, 0.0)), 2, where)  # type: ignore[arg-type]


def _check_size(shape: Shape, count: int, where: str) -> Shape:
    if min(shape.size[:count]) <= 0.0:
        raise ModelError(
            f"{where}: {shape.kind} of size {shape.size[:count]}; use sizes > 0", slug="sdf.size"
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
