"""Planar footprints of models: bounding discs, heights, outlines of what is static."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.rigid_transforms import compose
from zensim.proto.se3 import FloatArray, from_origin
from zensim.sim_server.description.model_geometry import find_link_poses
from zensim.sim_server.description.wheel_contacts import links_in_contact
from zensim.sim_server.scene.convex_shapes import ConvexShape, to_convex_shape

MeshTriangles = Callable[[str], FloatArray]
"""Finds the corners (3 f, 3) of the triangles of a `Shape.mesh`, unscaled."""
CIRCLE_VERTICES = 16
"""Vertices of the polygon about a circle."""
CONTACT_HEIGHT_M = 0.01
"""Parts up to this height above the lowest point touch the ground."""
LARGE_ROUND_M = 0.3
"""Radius above which spheres and capsules become polygons."""
LARGE_CIRCLE_VERTICES = 32
"""Vertices of the polygon of a large sphere or capsule."""


@dataclass(frozen=True)
class Footprint:
    """Bounding disc and heights [m] of a model in its root link at joint positions 0.

    Attributes:
        feet: (m, 2) points that touch the ground.
    """

    centre: tuple[float, float]
    radius_m: float
    low: float
    high: float
    feet: FloatArray


def make_circumscribed_polygon(radius_m: float, corners: int = CIRCLE_VERTICES) -> FloatArray:
    """Make the vertices (k, 2) of a polygon about a circle at the origin."""
    turns = np.arange(corners) * (2.0 * math.pi / corners)
    reach = radius_m / math.cos(math.pi / corners)
    return np.stack([np.cos(turns), np.sin(turns)], axis=1) * reach


def list_hulls_at_zero(
    model: Model, links: Iterable[Link], meshes: MeshTriangles
) -> Iterator[tuple[Shape, ConvexShape]]:
    """List the collisions of links in the root link at joint positions 0; planes are left out.

    Discs become polygons about them.
    """
    poses = find_link_poses(model.links[0].name, model.joints)
    for link in links:
        for shape in link.collisions:
            if shape.kind != "plane":
                pose = from_origin(compose(poses[link.name], shape.origin))
                yield shape, _expand_disc(to_convex_shape(shape, meshes)).transformed_by(pose)


def _expand_disc(shape: ConvexShape) -> ConvexShape:
    """Replace the disc of a shape in its own frame by a polygon about it."""
    if not shape.disc_radius_m:
        return shape
    rim = np.pad(make_circumscribed_polygon(shape.disc_radius_m), ((0, 0), (0, 1)))
    return ConvexShape((shape.points[:, None, :] + rim).reshape(-1, 3))


def _height_range(shape: ConvexShape) -> tuple[float, float]:
    heights, radius = shape.points[:, 2], shape.sphere_radius_m
    return float(heights.min()) - radius, float(heights.max()) + radius


def measure_footprint(
    model: Model, meshes: MeshTriangles, pivot: tuple[float, float] | None = None
) -> Footprint:
    """Measure the disc that holds an upright model at any heading.

    Args:
        model: Its joints are at 0.
        meshes: Triangles by name.
        pivot: Centre of the disc; None = centre of all collisions.
    """
    hulls = [hull for _, hull in list_hulls_at_zero(model, links_in_contact(model, meshes), meshes)]
    hulls = hulls or [ConvexShape(np.zeros((1, 3)))]
    ranges = [_height_range(hull) for hull in hulls]
    low = min(bottom for bottom, _ in ranges)
    if pivot is None:
        least = np.min([h.points[:, :2].min(axis=0) - h.sphere_radius_m for h in hulls], axis=0)
        most = np.max([h.points[:, :2].max(axis=0) + h.sphere_radius_m for h in hulls], axis=0)
        x, y = ((least + most) / 2.0).tolist()
        pivot = (x, y)
    radius = max(_planar_radius(hull, np.array(pivot)) for hull in hulls)
    feet = [
        _contact_points(hull)
        for hull, (bottom, _) in zip(hulls, ranges, strict=True)
        if bottom <= low + CONTACT_HEIGHT_M
    ]
    return Footprint(pivot, radius, low, max(top for _, top in ranges), np.concatenate(feet))


def _planar_radius(hull: ConvexShape, pivot: FloatArray) -> float:
    arms = hull.points[:, :2] - pivot
    return float(np.hypot(arms[:, 0], arms[:, 1]).max()) + hull.sphere_radius_m


def _contact_points(hull: ConvexShape) -> FloatArray:
    lowest = hull.points[:, 2] <= hull.points[:, 2].min() + CONTACT_HEIGHT_M
    return hull.points[lowest, :2]


@dataclass(frozen=True)
class StaticEdges:
    """Line segments in the plane, swept by discs.

    Attributes:
        ends: (n, 4): x and y of both ends.
        thick: (n,) radii [m] of the discs.
        heights: (n, 2) lowest and highest point [m].
    """

    ends: FloatArray
    thick: FloatArray
    heights: FloatArray

    def __len__(self) -> int:
        return len(self.thick)


NO_EDGES = StaticEdges(np.zeros((0, 4)), np.zeros(0), np.zeros((0, 2)))


def concatenate_edges(parts: list[StaticEdges]) -> StaticEdges:
    """Concatenate edges."""
    if not parts:
        return NO_EDGES
    return StaticEdges(
        np.concatenate([part.ends for part in parts]),
        np.concatenate([part.thick for part in parts]),
        np.concatenate([part.heights for part in parts]),
    )


def find_outline(model: Model, base: FloatArray, meshes: MeshTriangles) -> StaticEdges:
    """Find the outlines of a static model in the plane.

    Of a mesh they are the edges of its triangles, of any other shape the hull of its projection.

    Args:
        model: Its joints are at 0.
        base: State row (7,) or longer of its root link.
        meshes: Triangles by name.
    """
    found = []
    for shape, hull in list_hulls_at_zero(model, model.links, meshes):
        placed = hull.transformed_by(base[:7])
        is_mesh = shape.kind == "mesh"
        found.append(_triangle_edges(placed.points) if is_mesh else _convex_edges(placed))
    return concatenate_edges(found)


def _convex_edges(hull: ConvexShape) -> StaticEdges:
    flat, thick = hull.points[:, :2], hull.sphere_radius_m
    if thick > LARGE_ROUND_M:
        flat = (
            flat[:, None, :] + make_circumscribed_polygon(thick, LARGE_CIRCLE_VERTICES)
        ).reshape(-1, 2)
        thick = 0.0
    ends = find_hull_edges(flat)
    count = len(ends)
    return StaticEdges(
        ends, np.full(count, thick), np.tile(np.array([_height_range(hull)]), (count, 1))
    )


def find_hull_edges(points: FloatArray) -> FloatArray:
    """Find the edges (k, 4) of the hull of points (n, 2); collinear points give one segment.

    Source: Andrew, 'Another efficient algorithm for convex hulls in two dimensions', 1979.
    """
    ordered = [(x, y) for x, y in np.unique(points, axis=0).tolist()]
    corners = np.array(_half_hull(ordered)[:-1] + _half_hull(ordered[::-1])[:-1] or ordered)
    return np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1)


def _half_hull(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Find the right half of the hull of sorted points, from the first to the last."""
    found: list[tuple[float, float]] = []
    for x, y in points:
        while len(found) > 1 and _cross_product(found[-2], found[-1], (x, y)) <= 0.0:
            found.pop()
        found.append((x, y))
    return found


def _cross_product(
    first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]
) -> float:
    (ax, ay), (bx, by), (cx, cy) = first, second, third
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _triangle_edges(points: FloatArray) -> StaticEdges:
    triangles = points.reshape(-1, 3, 3)
    low, high = triangles[:, :, 2].min(axis=1), triangles[:, :, 2].max(axis=1)
    starts = triangles[:, :, :2]
    ends = np.concatenate([starts, np.roll(starts, -1, axis=1)], axis=2).reshape(-1, 4)
    heights = np.repeat(np.stack([low, high], axis=1), 3, axis=0)
    return StaticEdges(ends, np.zeros(len(ends)), heights)
