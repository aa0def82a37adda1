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
from zensim.sim_server.scene.convex_shapes import UNIT_CUBE, Z_AXIS
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
END_MARGIN = 1e-6
"""Points of a cylinder that are this near its end, of its length, are on the end."""
NO_SHAPE = -1
"""Index of what a ray hits that hits nothing."""
DIRECT_KINDS = ("plane", *ROUND_KINDS)
CUBE_FACES = np.array(
    [
        (0, 1, 3),
        (0, 3, 2),
        (4, 6, 7),
        (4, 7, 5),
        (0, 4, 5),
        (0, 5, 1),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
        (1, 5, 7),
        (1, 7, 3),
    ]
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


@dataclass(frozen=True)
class Surfaces:
    """What rays (n,) hit first.

    Attributes:
        ranges: (n,) [m]; infinite where nothing is hit.
        shape: (n,) index in `PlacedShapes`, or `NO_SHAPE`.
        triangle: (n,) for boxes and meshes: twice the index of the triangle, plus 1 if it moves;
            else negative.
    """

    ranges: FloatArray
    shape: IntArray
    triangle: IntArray


NO_SHAPES = PlacedShapes((), np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros((0, 7)))


class EmbreeCaster:
    """A `RayCaster` that keeps what it builds of fixed shapes.

    All shapes are of one layout. Of equally near entities it hits any.
    """

    def __init__(self, is_fixed: BoolArray) -> None:
        """Cast at the shapes of a layout.

        Args:
            is_fixed: (s,) whether a shape moves only by requests; see `SceneLayout`.
        """
        self._fixed = np.flatnonzero(is_fixed)
        self._moving = np.flatnonzero(~is_fixed)
        self._fixed_shapes: PlacedShapes | None = None
        self._shapes: PlacedShapes = NO_SHAPES
        self._parts: tuple[_Triangles, ...] = ()

    def __call__(self, shapes: PlacedShapes, rays: Rays) -> RayHits:
        """Cast rays at shapes of the layout; see `RayCaster`."""
        self.place(shapes)
        found = self._cast(rays)
        entities = np.full(len(found.shape), NO_ENTITY, np.intp)
        is_hit = found.shape != NO_SHAPE
        entities[is_hit] = shapes.entity[found.shape[is_hit]]
        return RayHits(found.ranges, entities)

    def place(self, shapes: PlacedShapes) -> None:
        """Take the poses of one step; what was built of fixed shapes is valid while they stay."""
        if shapes is self._shapes:
            return
        known = self._fixed_shapes
        poses = shapes.poses[self._fixed]
        if known is None or not np.array_equal(known.poses[self._fixed], poses):
            self._fixed_shapes, self._parts = shapes, (_place_triangles(shapes, self._fixed),)
        self._shapes = shapes
        self._parts = self._parts[0], _place_triangles(shapes, self._moving)

    def find_surfaces(self, rays: Rays) -> tuple[FloatArray, IntArray, FloatArray]:
        """Cast rays at what has colours.

        Returns:
            Ranges (n,) [m], shapes (n,) or `NO_SHAPE`, and unit normals (n, 3) towards the origin;
            0 where nothing is hit.
        """
        found = self._cast(rays)
        normals = np.zeros((len(found.shape), 3))
        for number, triangles in enumerate(self._parts):
            chosen = np.flatnonzero((found.triangle >= 0) & (found.triangle % 2 == number))
            normals[chosen] = triangles.normals[found.triangle[chosen] // 2]
        others = np.flatnonzero((found.triangle < 0) & (found.shape != NO_SHAPE))
        points = rays.origins[others] + found.ranges[others, None] * rays.directions[others]
        normals[others] = _find_round_normals(self._shapes, found.shape[others], points)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        is_away = np.einsum("ij,ij->i", normals, rays.directions) > 0.0
        normals *= np.where(is_away[:, None], -1.0, 1.0) / np.where(lengths > 0.0, lengths, 1.0)
        return found.ranges, found.shape, normals

    def _cast(self, rays: Rays) -> Surfaces:
        found = _cast_directly(self._shapes, rays)
        active, starts = np.arange(len(rays.origins)), np.zeros(len(rays.origins))
        for _ in range(MAX_PASSES):
            active, starts = self._advance(rays, found, active, starts)
            if not len(active):
                return found
        rest = cast_rays_exactly(self._shapes, _take_rays(rays, active))
        found.ranges[active], found.triangle[active] = rest.ranges, -1
        found.shape[active] = [
            np.flatnonzero(self._shapes.entity == entity)[0] if entity != NO_ENTITY else NO_SHAPE
            for entity in rest.entities.tolist()
        ]
        return found

    def _advance(
        self, rays: Rays, found: Surfaces, active: IntArray, starts: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Find the next triangle of some rays; return those that pass it, and where they go on."""
        part, triangle, at = self._find_triangles(rays, found, active, starts)
        is_hit = triangle >= 0
        active, part, triangle, at = active[is_hit], part[is_hit], triangle[is_hit], at[is_hit]
        beams = _take_rays(rays, active)
        shape, ranges = np.zeros(len(active), np.intp), np.full(len(active), np.inf)
        for number, triangles in enumerate(self._parts):
            chosen = np.flatnonzero(part == number)
            shape[chosen] = triangles.shape[triangle[chosen]]
            ranges[chosen] = triangles.find_ranges(triangle[chosen], _take_rays(beams, chosen))
        ranges = np.where(np.abs(ranges - at) <= FLOAT32_ERROR_M, ranges, at)
        is_own = self._shapes.entity[shape] == beams.ignored
        is_round = np.isin(self._shapes.kinds, ROUND_KINDS)[self._shapes.geometry[shape]]
        exact = np.flatnonzero(is_round & ~is_own)
        ranges[exact] = _find_round_ranges(self._shapes, shape[exact], _take_rays(beams, exact))
        is_nearer = ~is_own & (ranges <= np.minimum(found.ranges[active], rays.max_range_m))
        nearer = active[is_nearer]
        found.ranges[nearer], found.shape[nearer] = ranges[is_nearer], shape[is_nearer]
        found.triangle[nearer] = np.where(is_round, -1, 2 * triangle + part)[is_nearer]
        is_passed = is_own | is_round
        return active[is_passed], at[is_passed] + SKIP_M

    def _find_triangles(
        self, rays: Rays, known: Surfaces, active: IntArray, starts: FloatArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Find the next triangle of each ray: part, index in it or -1, and range (n,)."""
        directions = rays.directions[active]
        origins = (rays.origins[active] + starts[:, None] * directions).astype(np.float32)
        limits = np.minimum(known.ranges[active], rays.max_range_m) - starts
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


def _cast_directly(shapes: PlacedShapes, rays: Rays) -> Surfaces:
    """Cast rays at planes, and at round shapes in whose prisms they may begin."""
    count = len(rays.origins)
    none = np.full(count, NO_SHAPE)
    found = Surfaces(np.full(count, np.inf), none, none.copy())
    centres, radii = shapes.bounding_spheres()
    numbers = np.flatnonzero(np.isin(shapes.kinds, DIRECT_KINDS)[shapes.geometry])
    starts = _find_origins(rays)
    counts = np.diff(np.append(starts, count))
    for number in numbers.tolist():
        away = rays.origins[starts] - centres[number]
        reach = PRISM_REACH * radii[number]
        near = np.flatnonzero((away * away).sum(axis=1) <= reach * reach)
        _keep_nearest(shapes, rays, found, expand_ranges(starts[near], counts[near])[1], number)
    return found


def _find_origins(rays: Rays) -> IntArray:
    """Find the first ray of each run of rays that have one origin."""
    is_new = (rays.origins[1:] != rays.origins[:-1]).any(axis=1)
    return np.flatnonzero(np.append(np.ones(min(len(rays.origins), 1), np.bool_), is_new))


def _keep_nearest(
    shapes: PlacedShapes, rays: Rays, found: Surfaces, chosen: IntArray, number: int
) -> None:
    """Keep the hits of some rays at one shape where they are nearer."""
    if not len(chosen):
        return
    part = _take_rays(rays, chosen)
    ranges = _find_round_ranges(shapes, np.full(len(chosen), number), part)
    is_nearer = (ranges < found.ranges[chosen]) & (ranges <= rays.max_range_m)
    is_nearer &= shapes.entity[number] != part.ignored
    found.ranges[chosen[is_nearer]] = ranges[is_nearer]
    found.shape[chosen[is_nearer]] = number


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


def _find_round_normals(shapes: PlacedShapes, number: IntArray, points: FloatArray) -> FloatArray:
    """Find outward normals (n, 3), of any length, of round shapes and planes at points on them."""
    geometry, poses = shapes.geometry[number], shapes.poses[number]
    local = rotate(conjugate(poses[:, 3:]), points - poses[:, :3])
    kind, half, height = shapes.kinds[geometry], shapes.sizes[geometry, 1] / 2.0, local[:, 2]
    is_end = (kind == "cylinder") & (np.abs(height) >= half * (1.0 - END_MARGIN))
    # Beside the ends, the normal points away from the nearest point of the axis.
    is_straight = np.isin(kind, ("capsule", "cylinder"))
    local[:, 2] -= np.where(is_straight, np.clip(height, -half, half), 0.0)
    local = np.where((is_end | (kind == "plane"))[:, None], Z_AXIS, local)
    return rotate(poses[:, 3:], local)


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
