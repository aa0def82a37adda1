"""Ray casting: the interface of a ray caster, and a plain exact one on arrays.

A ray hits a shape where it first crosses its surface, from outside or from inside. A mesh is hit
at its triangles, from either side.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Shape
from zensim.proto.se3 import FloatArray, conjugate, cross, rotate, transform_points
from zensim.sim_server.scene.broad_phase import IntArray

NO_ENTITY = -1
"""Index of what a ray hits that hits nothing."""
GROUND = -2
"""Index of the ground plane."""
MAX_PAIRS = 1 << 18
"""Rays and shapes, or rays and triangles, that are tested at once: bounds the memory."""
BOUND_MARGIN = 1e-9
"""Relative margin of bounding spheres against rounding."""
MIN_DETERMINANT = 1e-300
"""Determinant below which a ray counts as parallel to a triangle."""


@dataclass(frozen=True)
class ShapeGeometry:
    """A collision shape in its own frame.

    Attributes:
        shape: Kind and size.
        triangles: (f, 3, 3) of a mesh, scaled; (0, 3, 3) of any other kind.
        centre: (3,) of a bounding sphere.
        radius_m: Of that sphere; infinite for a plane.
    """

    shape: Shape
    triangles: FloatArray
    centre: FloatArray
    radius_m: float


@dataclass(frozen=True)
class PlacedShapes:
    """Shapes (s,) in the world.

    Attributes:
        geometries: Distinct geometries.
        geometry: (s,) index of each shape's geometry.
        entity: (s,) index of each shape's entity, or `GROUND`.
        poses: (s, 7).
    """

    geometries: tuple[ShapeGeometry, ...]
    geometry: IntArray
    entity: IntArray
    poses: FloatArray

    @property
    def kinds(self) -> npt.NDArray[np.str_]:
        """Kinds (g,) of all geometries; see `Shape`."""
        return np.array([one.shape.kind for one in self.geometries], dtype="<U8")

    @property
    def sizes(self) -> FloatArray:
        """Sizes (g, 3) of all geometries; see `Shape`."""
        return np.array([one.shape.size for one in self.geometries]).reshape(-1, 3)

    def bounding_spheres(self) -> tuple[FloatArray, FloatArray]:
        """Find centres (s, 3) in the world and radii (s,) of bounding spheres."""
        centres = np.array([one.centre for one in self.geometries]).reshape(-1, 3)
        radii = np.array([one.radius_m for one in self.geometries])
        placed = transform_points(self.poses, centres[self.geometry])
        return placed, radii[self.geometry]


@dataclass(frozen=True)
class Rays:
    """Rays (n,) in the world.

    Attributes:
        origins: (n, 3).
        directions: (n, 3), of unit length.
        max_range_m: Hits beyond it do not count.
        ignored: (n,) index of an entity that each ray passes through, or `NO_ENTITY`.
    """

    origins: FloatArray
    directions: FloatArray
    max_range_m: float
    ignored: IntArray


@dataclass(frozen=True)
class RayHits:
    """First hits of rays (n,).

    Attributes:
        ranges: (n,) [m]; infinite where nothing is hit.
        entities: (n,) index of the entity that is hit, `GROUND` or `NO_ENTITY`.
    """

    ranges: FloatArray
    entities: IntArray


class RayCaster(Protocol):
    """Finds the first hits of rays."""

    def __call__(self, shapes: PlacedShapes, rays: Rays) -> RayHits:
        """Cast rays at shapes; of equally near entities the lowest index is hit."""


def cast_rays_exactly(shapes: PlacedShapes, rays: Rays) -> RayHits:
    """Cast rays at every shape whose bounding sphere they cross; see `RayCaster`."""
    count = len(rays.origins)
    hits = RayHits(np.full(count, np.inf), np.full(count, NO_ENTITY, np.intp))
    centres, radii = shapes.bounding_spheres()
    batch = max(1, MAX_PAIRS // max(len(radii), 1))
    for start in range(0, count, batch):
        part = np.arange(start, min(start + batch, count))
        row, shape = np.nonzero(_find_candidates(rays, part, centres, radii))
        ray = part[row]
        is_wanted = shapes.entity[shape] != rays.ignored[ray]
        _keep_first(hits, shapes, rays, ray[is_wanted], shape[is_wanted])
    return hits


def _find_candidates(
    rays: Rays, part: IntArray, centres: FloatArray, radii: FloatArray
) -> npt.NDArray[np.bool_]:
    """Find which rays (r,) cross which bounding spheres (s,): (r, s)."""
    directions = rays.directions[part, None]
    away = centres - rays.origins[part, None]
    along = np.einsum("rsi,rsi->rs", away, np.broadcast_to(directions, away.shape))
    aside = away - along[..., None] * directions
    reach = radii + BOUND_MARGIN * (radii + np.abs(along))
    is_crossed = np.einsum("rsi,rsi->rs", aside, aside) <= reach * reach
    return np.asarray(is_crossed & (along >= -reach) & (along - reach <= rays.max_range_m))


def _keep_first(
    hits: RayHits, shapes: PlacedShapes, rays: Rays, ray: IntArray, shape: IntArray
) -> None:
    """Find the hits of pairs (p,) of a ray and a shape, and keep the first of each ray."""
    poses = shapes.poses[shape]
    back = conjugate(poses[:, 3:])
    origins = rotate(back, rays.origins[ray] - poses[:, :3])
    directions = rotate(back, rays.directions[ray])
    ranges = np.full(len(ray), np.inf)
    geometry = shapes.geometry[shape]
    for number in np.unique(geometry).tolist():
        pairs = np.flatnonzero(geometry == number)
        ranges[pairs] = find_ranges(shapes.geometries[number], origins[pairs], directions[pairs])
    is_hit = ranges <= rays.max_range_m
    ray, entity, ranges = ray[is_hit], shapes.entity[shape[is_hit]], ranges[is_hit]
    order = np.lexsort((entity, ranges, ray))
    found, first = np.unique(ray[order], return_index=True)
    hits.ranges[found] = ranges[order[first]]
    hits.entities[found] = entity[order[first]]


def find_ranges(geometry: ShapeGeometry, origins: FloatArray, directions: FloatArray) -> FloatArray:
    """Find ranges (p,) [m] along rays (p, 3) in the frame of a shape; infinite without a hit."""
    shape = geometry.shape
    if shape.kind == "mesh":
        return _find_mesh_ranges(geometry.triangles, origins, directions)
    sizes = np.broadcast_to(np.array(shape.size), (len(origins), 3))
    return find_solid_ranges(shape.kind, sizes, origins, directions)


def find_solid_ranges(
    kind: str, sizes: FloatArray, origins: FloatArray, directions: FloatArray
) -> FloatArray:
    """Find ranges (p,) [m] along rays (p, 3) in the frames of shapes of one kind but mesh.

    Args:
        kind: Of all shapes; see `Shape`.
        sizes: (p, 3) `Shape.size` of each.
        origins: (p, 3).
        directions: (p, 3), of unit length.
    """
    enter, leave = _CROSSINGS[kind](sizes.T, origins, directions)
    ranges = np.where(enter >= 0.0, enter, leave)
    return np.where((enter <= leave) & (ranges >= 0.0), ranges, np.inf)


def find_plane_ranges(heights: FloatArray, rises: FloatArray) -> FloatArray:
    """Find ranges (p,) [m] of rays at a plane.

    Args:
        heights: (p,) of the origins above the plane [m].
        rises: (p,) of unit directions along the normal of the plane.
    """
    is_parallel = rises == 0.0
    ranges = -heights / np.where(is_parallel, 1.0, rises)
    return np.asarray(np.where(is_parallel | (ranges < 0.0), np.inf, ranges))


# Functions below take sizes (3, p), one column for each ray.
Interval = tuple[FloatArray, FloatArray]
"""Where lines (p,) enter and leave a convex solid; enter > leave where they miss it."""


def _cross_slab(half: FloatArray, origin: FloatArray, direction: FloatArray) -> Interval:
    """Cross -half <= coordinate <= half; `origin` and `direction` are those coordinates (p,)."""
    is_parallel = direction == 0.0
    step = np.where(is_parallel, 1.0, direction)
    one, other = (-half - origin) / step, (half - origin) / step
    is_inside = np.abs(origin) <= half
    enter = np.where(is_parallel, np.where(is_inside, -np.inf, np.inf), np.minimum(one, other))
    leave = np.where(is_parallel, np.where(is_inside, np.inf, -np.inf), np.maximum(one, other))
    return enter, leave


def _cross_ball(radius: FloatArray, origins: FloatArray, directions: FloatArray) -> Interval:
    """Cross a ball of any dimension about the origin; directions may be of any length."""
    square = np.einsum("ij,ij->i", directions, directions)
    is_point = square == 0.0
    square = np.where(is_point, 1.0, square)
    along = -np.einsum("ij,ij->i", origins, directions) / square
    nearest = origins + along[:, None] * directions
    rest = radius * radius - np.einsum("ij,ij->i", nearest, nearest)
    half = np.sqrt(np.maximum(rest, 0.0) / square)
    enter = np.where(is_point, -np.inf, along - half)
    leave = np.where(is_point, np.inf, along + half)
    return np.where(rest >= 0.0, enter, np.inf), np.where(rest >= 0.0, leave, -np.inf)


def _intersect(*intervals: Interval) -> Interval:
    return (
        np.maximum.reduce([enter for enter, _ in intervals]),
        np.minimum.reduce([leave for _, leave in intervals]),
    )


def _cross_box(size: FloatArray, origins: FloatArray, directions: FloatArray) -> Interval:
    return _intersect(
        *(_cross_slab(size[i] / 2.0, origins[:, i], directions[:, i]) for i in range(3))
    )


def _cross_sphere(size: FloatArray, origins: FloatArray, directions: FloatArray) -> Interval:
    return _cross_ball(size[0], origins, directions)


def _cross_cylinder(size: FloatArray, origins: FloatArray, directions: FloatArray) -> Interval:
    side = _cross_ball(size[0], origins[:, :2], directions[:, :2])
    return _intersect(side, _cross_slab(size[1] / 2.0, origins[:, 2], directions[:, 2]))


def _cross_capsule(size: FloatArray, origins: FloatArray, directions: FloatArray) -> Interval:
    """Join the intervals of the cylinder and of both balls: a line crosses their union once."""
    shift = size[1][:, None] * np.array([0.0, 0.0, 0.5])
    parts = [
        _cross_cylinder(size, origins, directions),
        _cross_ball(size[0], origins - shift, directions),
        _cross_ball(size[0], origins + shift, directions),
    ]
    enters = [np.where(enter <= leave, enter, np.inf) for enter, leave in parts]
    leaves = [np.where(enter <= leave, leave, -np.inf) for enter, leave in parts]
    return np.minimum.reduce(enters), np.maximum.reduce(leaves)


def _cross_plane(_: FloatArray, origins: FloatArray, directions: FloatArray) -> Interval:
    ranges = find_plane_ranges(origins[:, 2], directions[:, 2])
    return ranges, ranges


_CROSSINGS: dict[str, Callable[[FloatArray, FloatArray, FloatArray], Interval]] = {
    "box": _cross_box,
    "sphere": _cross_sphere,
    "cylinder": _cross_cylinder,
    "capsule": _cross_capsule,
    "plane": _cross_plane,
}


def _find_mesh_ranges(
    triangles: FloatArray, origins: FloatArray, directions: FloatArray
) -> FloatArray:
    """Find the nearest triangle (f, 3, 3) along each ray (p, 3).

    Source: Moeller, Trumbore, 'Fast, minimum storage ray/triangle intersection', 1997.
    """
    ranges = np.full(len(origins), np.inf)
    first, second, third = np.moveaxis(triangles, 1, 0)
    one, other = second - first, third - first
    batch = max(1, MAX_PAIRS // max(len(triangles), 1))
    for start in range(0, len(origins) if len(triangles) else 0, batch):
        origin, direction = origins[start : start + batch, None], directions[start : start + batch]
        across = cross(np.broadcast_to(direction[:, None], (len(direction), *one.shape)), other)
        determinant = np.einsum("fi,pfi->pf", one, across)
        is_parallel = np.abs(determinant) < MIN_DETERMINANT
        inverse = 1.0 / np.where(is_parallel, 1.0, determinant)
        away = origin - first
        u = np.einsum("pfi,pfi->pf", away, across) * inverse
        normal = cross(away, one)
        v = np.einsum("pi,pfi->pf", direction, normal) * inverse
        at = np.einsum("fi,pfi->pf", other, normal) * inverse
        is_hit = ~is_parallel & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (at >= 0.0)
        ranges[start : start + batch] = np.where(is_hit, at, np.inf).min(axis=1)
    return ranges
