"""Ray casting by Embree: rays of any direction at large scenes, as exact as closed forms.

Embree finds which triangle a ray hits, in float32; the range is computed in float64. Round shapes
are prisms about them for Embree, and closed forms of `ray_casting` for the range.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from zensim.proto.messages.model_messages import Shape
from zensim.proto.se3 import FloatArray, conjugate, cross, rotate, transform_points
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges
from zensim.sim_server.scene.convex_shapes import UNIT_CUBE
from zensim.sim_server.scene.level_sections import ROUND_KINDS
from zensim.sim_server.scene.ray_casting import (
    NO_ENTITY,
    PlacedShapes,
    RayHits,
    Rays,
    ShapeGeometry,
    cast_rays_exactly,
    find_solid_ranges,
)

BoolArray = npt.NDArray[np.bool_]

SKIP_M = 2e-5
"""By which a ray goes on behind what it passes through; more than float32 rounds."""
FLOAT32_ERROR_M = 1e-3
"""Ranges of Embree and of the plane of the triangle that differ by more: the ray grazes it."""
MAX_PASSES = 64
"""Surfaces that a ray passes through before it is cast exactly."""
PRISM_SIDES = 16
PRISM_MARGIN = 1.0 + 1e-4
"""By which prisms are larger than what they enclose, against rounding."""
PRISM_REACH = 1.5
"""Bounding radius of a prism in that of what it encloses, at most."""
DIRECT_KINDS = ("plane", *ROUND_KINDS)
CUBE_FACES = np.reshape(
    [int(i) for i in "013032467475045051237276026064157173"],
    (12, 3),
)
"""Corners of `UNIT_CUBE` of the triangles of its faces."""


@dataclass(frozen=True)
class _Triangles:
    """Triangles (t,) in the world, in a scene of Embree.

    Attributes:
        corners: (t, 3, 3).
        shape: (t,) index in `PlacedShapes`.
    """

    corners: FloatArray
    shape: IntArray

    @cached_property
    def normals(self) -> FloatArray:
        """Normals (t, 3) of any length."""
        first, second, third = np.moveaxis(self.corners, 1, 0)
        return cross(second - first, third - first)

    @cached_property
    def scene(self) -> EmbreeScene:
        """The built scene."""
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, self.corners.astype(np.float32))
        return scene

    def find_ranges(self, triangle: IntArray, rays: Rays) -> FloatArray:
        """Find where rays (n,) cross the planes of triangles (n,): ranges (n,) [m]."""
        normal = self.normals[triangle]
        slope = np.einsum("ij,ij->i", normal, rays.directions)
        height = np.einsum("ij,ij->i", normal, self.corners[triangle, 0] - rays.origins)
        is_parallel = slope == 0.0
        return np.asarray(np.where(is_parallel, np.inf, height / np.where(is_parallel, 1.0, slope)))


class EmbreeCaster:
    """Casts rays at the shapes of a scene; what it builds of fixed shapes is kept."""

    def __init__(self, is_fixed: BoolArray) -> None:
        """Cast at the shapes of a layout.

        Args:
            is_fixed: (s,) whether a shape moves only by requests; see `SceneLayout`.
        """
        self._fixed = np.flatnonzero(is_fixed)
        self._moving = np.flatnonzero(~is_fixed)
        self._fixed_shapes: PlacedShapes | None = None
        self._parts: tuple[_Triangles, ...] = ()

    def place(self, shapes: PlacedShapes) -> None:
        """Take the poses of one step; what was built of fixed shapes is valid while they stay."""
        known = self._fixed_shapes
        poses = shapes.poses[self._fixed]
        if known is None or not np.array_equal(known.poses[self._fixed], poses):
            self._fixed_shapes, self._parts = shapes, (_place_triangles(shapes, self._fixed),)
        self._shapes = shapes
        self._parts = self._parts[0], _place_triangles(shapes, self._moving)

    def cast(self, rays: Rays) -> RayHits:
        """Cast rays; see `RayCaster`, but of equally near entities any is hit."""
        hits = _cast_directly(self._shapes, rays)
        active, starts = np.arange(len(rays.origins)), np.zeros(len(rays.origins))
        for _ in range(MAX_PASSES):
            active, starts = self._advance(rays, hits, active, starts)
            if not len(active):
                return hits
        rest = cast_rays_exactly(self._shapes, _take_rays(rays, active))
        hits.ranges[active], hits.entities[active] = rest.ranges, rest.entities
        return hits

    def _advance(
        self, rays: Rays, hits: RayHits, active: IntArray, starts: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Find the next triangle of some rays; return those that pass it, and where they go on."""
        part, triangle, at = self._find_triangles(rays, hits, active, starts)
        is_hit = triangle >= 0
        active, part, triangle, at = active[is_hit], part[is_hit], triangle[is_hit], at[is_hit]
        found = _take_rays(rays, active)
        shape, ranges = np.zeros(len(active), np.intp), np.full(len(active), np.inf)
        for number, triangles in enumerate(self._parts):
            chosen = np.flatnonzero(part == number)
            shape[chosen] = triangles.shape[triangle[chosen]]
            ranges[chosen] = triangles.find_ranges(triangle[chosen], _take_rays(found, chosen))
        ranges = np.where(np.abs(ranges - at) <= FLOAT32_ERROR_M, ranges, at)
        is_own = self._shapes.entity[shape] == found.ignored
        is_round = np.isin(self._shapes.kinds, ROUND_KINDS)[self._shapes.geometry[shape]]
        exact = np.flatnonzero(is_round & ~is_own)
        ranges[exact] = _find_round_ranges(self._shapes, shape[exact], _take_rays(found, exact))
        is_nearer = ~is_own & (ranges <= np.minimum(hits.ranges[active], rays.max_range_m))
        hits.ranges[active[is_nearer]] = ranges[is_nearer]
        hits.entities[active[is_nearer]] = self._shapes.entity[shape[is_nearer]]
        is_passed = is_own | is_round
        return active[is_passed], at[is_passed] + SKIP_M

    def _find_triangles(
        self, rays: Rays, hits: RayHits, active: IntArray, starts: FloatArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Find the next triangle of each ray: part, index in it or -1, and range (n,)."""
        directions = rays.directions[active]
        origins = (rays.origins[active] + starts[:, None] * directions).astype(np.float32)
        limits = np.minimum(hits.ranges[active], rays.max_range_m) - starts
        nearest = np.maximum(limits, 0.0).astype(np.float32)
        part, triangle = np.zeros(len(active), np.intp), np.full(len(active), -1)
        for number, triangles in enumerate(self._parts):
            if len(triangles.shape) and len(active):
                found = triangles.scene.run(
                    origins,
                    directions.astype(np.float32),
                    dists=nearest,
                    query="INTERSECT",
                    output=True,
                )
                is_hit = found["primID"] >= 0
                part[is_hit], triangle[is_hit] = number, found["primID"][is_hit]
                nearest = np.where(is_hit, found["tfar"], nearest).astype(np.float32)
        return part, triangle, nearest + starts


def _take_rays(rays: Rays, chosen: IntArray) -> Rays:
    return Rays(
        rays.origins[chosen], rays.directions[chosen], rays.max_range_m, rays.ignored[chosen]
    )


def _cast_directly(shapes: PlacedShapes, rays: Rays) -> RayHits:
    """Cast rays at planes, and at round shapes in whose prisms they may begin."""
    count = len(rays.origins)
    hits = RayHits(np.full(count, np.inf), np.full(count, NO_ENTITY, np.intp))
    centres, radii = shapes.bounding_spheres()
    numbers = np.flatnonzero(np.isin(shapes.kinds, DIRECT_KINDS)[shapes.geometry])
    starts = _find_origins(rays)
    counts = np.diff(np.append(starts, count))
    for number in numbers.tolist():
        away = rays.origins[starts] - centres[number]
        reach = PRISM_REACH * radii[number]
        near = np.flatnonzero((away * away).sum(axis=1) <= reach * reach)
        _keep_nearest(shapes, rays, hits, expand_ranges(starts[near], counts[near])[1], number)
    return hits


def _find_origins(rays: Rays) -> IntArray:
    """Find the first ray of each run of rays that have one origin."""
    is_new = (rays.origins[1:] != rays.origins[:-1]).any(axis=1)
    return np.flatnonzero(np.append(np.ones(min(len(rays.origins), 1), np.bool_), is_new))


def _keep_nearest(
    shapes: PlacedShapes, rays: Rays, hits: RayHits, chosen: IntArray, number: int
) -> None:
    """Keep the hits of some rays at one shape where they are nearer."""
    if not len(chosen):
        return
    part = _take_rays(rays, chosen)
    ranges = _find_round_ranges(shapes, np.full(len(chosen), number), part)
    is_nearer = (ranges < hits.ranges[chosen]) & (ranges <= rays.max_range_m)
    is_nearer &= shapes.entity[number] != part.ignored
    hits.ranges[chosen[is_nearer]] = ranges[is_nearer]
    hits.entities[chosen[is_nearer]] = shapes.entity[number]


def _find_round_ranges(shapes: PlacedShapes, number: IntArray, rays: Rays) -> FloatArray:
    """Find ranges (n,) [m] of rays, each at a shape without triangles, by closed forms."""
    ranges = np.full(len(number), np.inf)
    geometry, poses = shapes.geometry[number], shapes.poses[number]
    back = conjugate(poses[:, 3:])
    origins = rotate(back, rays.origins - poses[:, :3])
    directions = rotate(back, rays.directions)
    kinds = shapes.kinds[geometry]
    for kind in np.unique(kinds).tolist():
        chosen = np.flatnonzero(kinds == kind)
        sizes = shapes.sizes[geometry[chosen]]
        ranges[chosen] = find_solid_ranges(kind, sizes, origins[chosen], directions[chosen])
    return ranges


def _place_triangles(shapes: PlacedShapes, numbers: IntArray) -> _Triangles:
    corners, shape = [np.zeros((0, 3, 3))], [np.zeros(0, np.intp)]
    geometry = shapes.geometry[numbers]
    for number in np.unique(geometry).tolist():
        local = triangulate(shapes.geometries[number])
        found = numbers[geometry == number]
        placed = transform_points(shapes.poses[found, None, None], local)
        corners.append(placed.reshape(-1, 3, 3))
        shape.append(np.repeat(found, len(local)))
    return _Triangles(np.concatenate(corners), np.concatenate(shape))


def triangulate(geometry: ShapeGeometry) -> FloatArray:
    """Make triangles (f, 3, 3) of a shape in its own frame; round shapes become prisms about them.

    A plane has none.
    """
    shape = geometry.shape
    if shape.kind == "box":
        return np.asarray((UNIT_CUBE * np.array(shape.size))[CUBE_FACES])
    if shape.kind in ROUND_KINDS:
        return _triangulate_prism(*_enclose(shape))
    return geometry.triangles


def _enclose(shape: Shape) -> tuple[float, float]:
    """Find radius and half length [m] of a cylinder along z about a round shape."""
    radius, length, _ = shape.size
    if shape.kind == "sphere":
        return radius, radius
    return radius, length / 2.0 + (radius if shape.kind == "capsule" else 0.0)


def _triangulate_prism(radius: float, half: float) -> FloatArray:
    turns = np.arange(PRISM_SIDES) * (2.0 * np.pi / PRISM_SIDES)
    reach = PRISM_MARGIN * radius / np.cos(np.pi / PRISM_SIDES)
    rim = np.stack([np.cos(turns), np.sin(turns), np.zeros(PRISM_SIDES)], axis=1) * reach
    rise = np.array([0.0, 0.0, half * PRISM_MARGIN])
    low, high, after = rim - rise, rim + rise, np.roll(np.arange(PRISM_SIDES), -1)
    return np.concatenate(
        [
            np.stack([low, low[after], high[after]], axis=1),
            np.stack([low, high[after], high], axis=1),
            np.stack([high, high[after], np.broadcast_to(rise, high.shape)], axis=1),
            np.stack([low[after], low, np.broadcast_to(-rise, low.shape)], axis=1),
        ]
    )
