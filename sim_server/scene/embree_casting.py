"""Ray casting by Embree: rays of any direction at large scenes, as exact as closed forms.

Embree finds in float32 what a ray may hit; ranges are computed in float64. Boxes and meshes that
stand still are triangles of one scene. Of all other shapes Embree has boxes about them: where a ray
meets such a box, closed forms decide, or the triangles of a mesh in its own frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from zensim.proto.messages.model_messages import Shape
from zensim.proto.se3 import FloatArray, conjugate, cross, rotate, to_matrix, transform_points
from zensim.sim_server.scene.broad_phase import IntArray, expand_ranges
from zensim.sim_server.scene.convex_shapes import UNIT_CUBE, Z_AXIS
from zensim.sim_server.scene.level_sections import ROUND_KINDS
from zensim.sim_server.scene.ray_casting import (
    MAX_PAIRS,
    NO_ENTITY,
    PlacedShapes,
    RayHits,
    Rays,
    ShapeGeometry,
    cast_rays_exactly,
    find_plane_ranges,
    find_solid_ranges,
)

BoolArray = npt.NDArray[np.bool_]

SKIP_M = 2e-5
"""Distance from which a ray goes on behind what it passes through; more than float32 rounds."""
FLOAT32_ERROR_M = 1e-3
"""Ranges of Embree and of the plane of the triangle that differ by more: the ray grazes it."""
MAX_PASSES = 64
"""Surfaces that a ray passes through before it is cast exactly."""
BOX_MARGIN_M = 1e-4
"""Least excess of the half sides of a box over those of what it encloses."""
BOX_MARGINS, BOX_MARGIN_STEP_M = 64, 2.0 * SKIP_M
"""Margins differ in so many steps: a ray that goes on behind a face must not pass another one that
lies in the same plane, such as those of wheels with a tyre and a rim."""
BUNDLE_STEP_M = 0.5
"""Origins of consecutive rays that are farther apart belong to two bundles."""
END_MARGIN = 1e-6
"""Points of a cylinder that are this near its end, of its length, are on the end."""
NO_SHAPE = -1
"""Index of what a ray hits that hits nothing."""
SOLID_KINDS = ("box", *ROUND_KINDS)
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
    ],
    dtype=np.int32,
)
"""Corners of `UNIT_CUBE` of the triangles of its faces."""


class _Triangles:
    """Triangles (t,) as Embree has them.

    Args:
        vertices: (v, 3).
        faces: (t, 3) indices of vertices.
    """

    def __init__(self, vertices: FloatArray, faces: npt.NDArray[np.int32]) -> None:
        self._scene: EmbreeScene | None = None
        if len(faces):
            self._scene = EmbreeScene(robust=True)
            TriangleMesh(self._scene, vertices.astype(np.float32), faces)

    def find_next(
        self, rays: Rays, starts: FloatArray, known: FloatArray
    ) -> tuple[IntArray, FloatArray]:
        """Find the next triangle of each ray (n,).

        Args:
            rays: Any.
            starts: (n,) ranges from which on triangles count.
            known: (n,) ranges of hits; triangles behind them do not count.

        Returns:
            Triangles (n,), negative without a hit, and their ranges (n,) [m], in float32.
        """
        if self._scene is None or not len(starts):
            return np.full(len(starts), -1), starts
        origins = rays.origins
        if starts.any():
            origins = origins + starts[:, None] * rays.directions
        limits = np.minimum(known, rays.max_range_m) - starts
        found = self._scene.run(
            origins.astype(np.float32),
            rays.directions.astype(np.float32),
            dists=np.maximum(limits, 0.0).astype(np.float32),
            query="INTERSECT",
            output=True,
        )
        return found["primID"].astype(np.intp), found["tfar"] + starts


class _TriangleSet:
    """Triangles (t,) that rays hit exactly.

    Attributes:
        normals: (t, 3), of unit length; 0 of a triangle without area.
    """

    def __init__(self, corners: FloatArray) -> None:
        """Take corners (t, 3, 3)."""
        first, second, third = np.moveaxis(corners, 1, 0)
        normals = cross(second - first, third - first)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        self.normals: FloatArray = normals / np.where(lengths > 0.0, lengths, 1.0)
        self._offsets = np.einsum("ij,ij->i", self.normals, first)
        faces = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
        self._triangles = _Triangles(corners.reshape(-1, 3), faces)

    def find_next(
        self, rays: Rays, starts: FloatArray, known: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Find triangles and ranges (n,) as `_Triangles` does, and the ranges in float64."""
        triangle, at = self._triangles.find_next(rays, starts, known)
        if not len(self.normals):
            return triangle, at, at
        normal = self.normals[triangle]
        slope = np.einsum("ij,ij->i", normal, rays.directions)
        height = self._offsets[triangle] - np.einsum("ij,ij->i", normal, rays.origins)
        ranges = height / np.where(slope == 0.0, 1.0, slope)
        is_grazed = (slope == 0.0) | (np.abs(ranges - at) > FLOAT32_ERROR_M)
        return triangle, at, np.where(is_grazed, at, ranges)


@dataclass(frozen=True)
class _Bundles:
    """Runs (b,) of rays with origins near each other that pass through one entity.

    Attributes:
        first: (b,) index of the first ray.
        counts: (b,) of rays.
        centres: (b, 3) of a sphere about the origins.
        radii: (b,) of that sphere.
        ignored: (b,) see `Rays`.
    """

    first: IntArray
    counts: IntArray
    centres: FloatArray
    radii: FloatArray
    ignored: IntArray


class _ShapeBoxes:
    """Boxes (b,) about shapes, which are a little larger than these.

    Attributes:
        shape: (b,) index in `PlacedShapes`.
    """

    def __init__(self, shapes: PlacedShapes, numbers: IntArray) -> None:
        """Prepare boxes without poses.

        Args:
            shapes: Of the layout.
            numbers: (b,) of the shapes.
        """
        self.shape = numbers
        geometry = shapes.geometry[numbers]
        bounds = [_find_bounds(one) for one in shapes.geometries]
        low, high = np.moveaxis(np.array(bounds).reshape(-1, 2, 3)[geometry], 1, 0)
        # Of all shapes of an entity, and of a shape in four entities, no two margins are equal.
        turn = (4 * geometry + shapes.entity[numbers] % 4) % BOX_MARGINS
        margins = BOX_MARGIN_M + BOX_MARGIN_STEP_M * turn
        sizes = high - low + 2.0 * margins[:, None]
        self._local_centres = (low + high) / 2.0
        self._radii = np.linalg.norm(sizes, axis=1) / 2.0
        self._corners = sizes[:, None] * UNIT_CUBE
        firsts = np.arange(len(numbers), dtype=np.int32) * np.int32(len(UNIT_CUBE))
        self._faces = (firsts[:, None, None] + CUBE_FACES).reshape(-1, 3)
        self._poses = np.full((len(numbers), 7), np.nan)
        self._centres = np.zeros((len(numbers), 3))
        self._triangles = _Triangles(np.zeros((0, 3)), self._faces[:0])

    def place(self, shapes: PlacedShapes) -> None:
        """Take the poses of one step; what was built is kept while all of them stay."""
        poses = shapes.poses[self.shape]
        if np.array_equal(poses, self._poses):
            return
        self._poses = poses
        self._centres = transform_points(poses, self._local_centres)
        corners = self._centres[:, None] + rotate(poses[:, None, 3:], self._corners)
        self._triangles = _Triangles(corners.reshape(-1, 3), self._faces)

    def find_next(
        self, rays: Rays, starts: FloatArray, known: FloatArray
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Find the rays (k,) that meet a face of a box: their indices, shapes and ranges."""
        triangle, at = self._triangles.find_next(rays, starts, known)
        met = np.flatnonzero(triangle >= 0)
        return met, self.shape[triangle[met] // len(CUBE_FACES)], at[met]

    def find_gaps(
        self, bundles: _Bundles, entity: IntArray
    ) -> tuple[FloatArray, IntArray, IntArray]:
        """Find how far it is from the origins of bundles to boxes of foreign entities.

        Args:
            bundles: (b,).
            entity: (s,) of all shapes.

        Returns:
            Range (b,) [m] that is free of such boxes around all origins, and bundle and shape of
            each pair (p,) of which an origin may be in the box.
        """
        gaps = np.full(len(bundles.first), np.inf)
        ones, others = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
        batch = max(1, MAX_PAIRS // max(len(self.shape), 1))
        for start in range(0, len(gaps) if len(self.shape) else 0, batch):
            part = slice(start, start + batch)
            squares = sum(
                np.square(bundles.centres[part, None, axis] - self._centres[:, axis])
                for axis in range(3)
            )
            away = np.sqrt(squares) - (bundles.radii[part, None] + self._radii)
            away[bundles.ignored[part, None] == entity[self.shape]] = np.inf
            gaps[part] = away.min(axis=1)
            one, other = np.nonzero(away <= 0.0)
            is_in = self._are_in_boxes(bundles, one + start, other)
            ones.append(one[is_in] + start)
            others.append(self.shape[other[is_in]])
        return np.maximum(gaps, 0.0), np.concatenate(ones), np.concatenate(others)

    def _are_in_boxes(self, bundles: _Bundles, bundle: IntArray, box: IntArray) -> BoolArray:
        """Whether an origin of a bundle may be in a box, for pairs (p,) of them."""
        away = bundles.centres[bundle] - self._centres[box]
        local = np.abs(rotate(conjugate(self._poses[box, 3:]), away))
        outside = np.maximum(local - self._corners[box, -1], 0.0)
        return np.asarray((outside * outside).sum(axis=1) <= bundles.radii[bundle] ** 2)


@dataclass(frozen=True)
class Surfaces:
    """What rays (n,) hit first.

    Attributes:
        ranges: (n,) [m]; infinite where nothing is hit.
        shape: (n,) index in `PlacedShapes`, or `NO_SHAPE`.
        triangle: (n,) index of the triangle of a mesh or of what stands still; else negative.
    """

    ranges: FloatArray
    shape: IntArray
    triangle: IntArray

    def keep(
        self, ray: IntArray, ranges: FloatArray, shape: IntArray, triangle: IntArray | int
    ) -> None:
        """Keep some hits; of several hits of one ray, the last."""
        self.ranges[ray], self.shape[ray], self.triangle[ray] = ranges, shape, triangle


NO_SHAPES = PlacedShapes((), np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros((0, 7)))
NO_TRIANGLES = np.zeros((0, 3, 3))


class EmbreeCaster:
    """A `RayCaster` that keeps what it builds of shapes that stand still.

    All shapes are of one layout. Of equally near entities it hits any.
    """

    def __init__(self, is_fixed: BoolArray) -> None:
        """Cast at the shapes of a layout.

        Args:
            is_fixed: (s,) whether a shape moves only by requests; see `SceneLayout`.
        """
        self._is_fixed = is_fixed
        self._shapes, self._turns = NO_SHAPES, np.zeros((0, 3, 3))
        self._kind_codes = self._planes = self._still = np.zeros(0, np.intp)
        self._still_poses = np.full((0, 7), np.nan)
        self._triangles, self._triangle_shape = _TriangleSet(NO_TRIANGLES), np.zeros(0, np.intp)
        self._boxes: tuple[_ShapeBoxes, ...] = ()
        self._meshes: dict[int, _TriangleSet] = {}

    def __call__(self, shapes: PlacedShapes, rays: Rays) -> RayHits:
        """Cast rays at shapes of the layout; see `RayCaster`."""
        self.place(shapes)
        found = self._cast(rays)
        entities = np.full(len(found.shape), NO_ENTITY, np.intp)
        is_hit = found.shape != NO_SHAPE
        entities[is_hit] = shapes.entity[found.shape[is_hit]]
        return RayHits(found.ranges, entities)

    def place(self, shapes: PlacedShapes) -> None:
        """Take the poses of one step; what was built of shapes is valid while they stay."""
        if shapes is self._shapes:
            return
        if shapes.geometries is not self._shapes.geometries:
            self._sort(shapes)
        self._shapes, self._turns = shapes, to_matrix(shapes.poses[:, 3:])
        poses = shapes.poses[self._still]
        if not np.array_equal(poses, self._still_poses):
            self._still_poses = poses
            corners, self._triangle_shape = _place_triangles(shapes, self._still)
            self._triangles = _TriangleSet(corners)
        for boxes in self._boxes:
            boxes.place(shapes)

    def find_surfaces(self, rays: Rays) -> tuple[FloatArray, IntArray, FloatArray]:
        """Cast rays at what has colours.

        Returns:
            Ranges (n,) [m], shapes (n,) or `NO_SHAPE`, and unit normals (n, 3) towards the origin;
            0 where nothing is hit.
        """
        found = self._cast(rays)
        normals = np.zeros((len(found.shape), 3))
        self._add_triangle_normals(found, normals)
        is_other = (found.triangle < 0) & (found.shape != NO_SHAPE)
        for number in self._planes.tolist():
            is_plane = found.shape == number
            normals[is_plane] = self._turns[number, :, 2]
            is_other &= ~is_plane
        others = np.flatnonzero(is_other)
        points = rays.origins[others] + found.ranges[others, None] * rays.directions[others]
        normals[others] = _find_solid_normals(self._shapes, found.shape[others], points)
        is_away = np.einsum("ij,ij->i", normals, rays.directions) > 0.0
        normals[is_away] *= -1.0
        return found.ranges, found.shape, normals

    def _sort(self, shapes: PlacedShapes) -> None:
        """Sort the shapes by how they are cast at."""
        known = [one.shape.kind for one in shapes.geometries]
        self._kind_codes = np.array([(*SOLID_KINDS, kind).index(kind) for kind in known], np.intp)
        kinds = shapes.kinds[shapes.geometry]
        is_plane = kinds == "plane"
        is_still = self._is_fixed & np.isin(kinds, ("box", "mesh"))
        self._planes, self._still = np.flatnonzero(is_plane), np.flatnonzero(is_still)
        self._still_poses = np.full((len(self._still), 7), np.nan)
        self._triangles, self._triangle_shape = _TriangleSet(NO_TRIANGLES), self._still[:0]
        is_boxed = ~is_plane & ~is_still
        self._boxes = tuple(
            _ShapeBoxes(shapes, np.flatnonzero(is_chosen))
            for is_chosen in (is_boxed & self._is_fixed, is_boxed & ~self._is_fixed)
            if is_chosen.any()
        )
        self._meshes = {}

    def _cast(self, rays: Rays) -> Surfaces:
        count = len(rays.origins)
        none = np.full(count, NO_SHAPE)
        found = Surfaces(np.full(count, np.inf), none, none.copy())
        if not count:
            return found
        for number in self._planes.tolist():
            self._cast_at_plane(number, rays, found)
        rest = [self._cast_at_triangles(rays, found)]
        bundles = _find_bundles(rays)
        rest += [self._cast_at_boxes(boxes, bundles, rays, found) for boxes in self._boxes]
        self._cast_exactly(np.unique(np.concatenate(rest)), rays, found)
        return found

    def _cast_at_plane(self, number: int, rays: Rays, found: Surfaces) -> None:
        shapes, up = self._shapes, self._turns[number, :, 2]
        heights = np.einsum("ij,j->i", rays.origins - shapes.poses[number, :3], up)
        ranges = find_plane_ranges(heights, np.einsum("ij,j->i", rays.directions, up))
        is_nearer = (ranges < found.ranges) & (ranges <= rays.max_range_m)
        nearer = np.flatnonzero(is_nearer & (shapes.entity[number] != rays.ignored))
        found.keep(nearer, ranges[nearer], np.full(len(nearer), number), -1)

    def _cast_at_triangles(self, rays: Rays, found: Surfaces) -> IntArray:
        """Cast rays at what stands still; return those that pass through too much of their own."""
        active, starts = np.arange(len(rays.origins)), np.zeros(len(rays.origins))
        for _ in range(MAX_PASSES if len(self._triangle_shape) else 0):
            beams, known = _take_rays(rays, active), found.ranges[active]
            triangle, at, ranges = self._triangles.find_next(beams, starts, known)
            shape = self._triangle_shape[triangle]
            is_hit, is_own = triangle >= 0, self._shapes.entity[shape] == beams.ignored
            kept = is_hit & ~is_own & (ranges <= np.minimum(known, rays.max_range_m))
            found.keep(active[kept], ranges[kept], shape[kept], triangle[kept])
            is_passed = is_hit & is_own
            active, starts = active[is_passed], at[is_passed] + SKIP_M
            if not len(active):
                break
        return active if len(self._triangle_shape) else active[:0]

    def _cast_at_boxes(
        self, boxes: _ShapeBoxes, bundles: _Bundles, rays: Rays, found: Surfaces
    ) -> IntArray:
        """Cast rays at shapes in boxes; return those that meet too many of these."""
        gaps, bundle, shape = boxes.find_gaps(bundles, self._shapes.entity)
        near, ray = expand_ranges(bundles.first[bundle], bundles.counts[bundle])
        self._keep_nearest(ray, shape[near], rays, found)
        # Rays begin where foreign boxes may: mostly behind their own robot.
        starts = np.repeat(np.maximum(gaps - FLOAT32_ERROR_M, 0.0), bundles.counts)
        active = np.arange(len(rays.origins))
        for _ in range(MAX_PASSES):
            known = np.minimum(found.ranges[active], rays.max_range_m)
            is_left = starts < known
            active, starts, known = active[is_left], starts[is_left], known[is_left]
            met, shape, at = boxes.find_next(_take_rays(rays, active), starts, known)
            active, starts = active[met], at + SKIP_M
            is_foreign = self._shapes.entity[shape] != rays.ignored[active]
            self._keep_nearest(active[is_foreign], shape[is_foreign], rays, found)
            if not len(active):
                break
        return active

    def _keep_nearest(self, ray: IntArray, shape: IntArray, rays: Rays, found: Surfaces) -> None:
        """Keep the hits of pairs (p,) of a ray and a shape that are nearer than what is known."""
        if not len(ray):
            return
        ranges, triangle = self._find_pair_ranges(ray, shape, rays)
        is_nearer = (ranges < found.ranges[ray]) & (ranges <= rays.max_range_m)
        nearer = np.flatnonzero(is_nearer)
        nearer = nearer[np.argsort(-ranges[nearer], kind="stable")]
        found.keep(ray[nearer], ranges[nearer], shape[nearer], triangle[nearer])

    def _find_pair_ranges(
        self, ray: IntArray, shape: IntArray, rays: Rays
    ) -> tuple[FloatArray, IntArray]:
        """Find ranges (p,) [m] of rays, each at a shape, and the triangles of meshes."""
        shapes = self._shapes
        geometry, turns = shapes.geometry[shape], self._turns[shape]
        away = rays.origins[ray] - shapes.poses[shape, :3]
        origins = np.einsum("pji,pj->pi", turns, away)
        directions = np.einsum("pji,pj->pi", turns, rays.directions[ray])
        ranges, triangle = np.full(len(ray), np.inf), np.full(len(ray), -1)
        codes, sizes = self._kind_codes[geometry], shapes.sizes[geometry]
        for code, kind in enumerate(SOLID_KINDS):
            pairs = np.flatnonzero(codes == code)
            if len(pairs):
                solid = sizes[pairs], origins[pairs], directions[pairs]
                ranges[pairs] = find_solid_ranges(kind, *solid)
        others = np.flatnonzero(codes == len(SOLID_KINDS))
        for number in np.unique(geometry[others]).tolist():
            pairs = others[geometry[others] == number]
            local = Rays(origins[pairs], directions[pairs], rays.max_range_m, ray[pairs])
            none, start = np.full(len(pairs), np.inf), np.zeros(len(pairs))
            triangle[pairs], _, exact = self._find_mesh(number).find_next(local, start, none)
            ranges[pairs] = np.where(triangle[pairs] >= 0, exact, np.inf)
        return ranges, triangle

    def _find_mesh(self, number: int) -> _TriangleSet:
        """Find the triangles of a mesh in its own frame."""
        if number not in self._meshes:
            self._meshes[number] = _TriangleSet(self._shapes.geometries[number].triangles)
        return self._meshes[number]

    def _cast_exactly(self, chosen: IntArray, rays: Rays, found: Surfaces) -> None:
        if not len(chosen):
            return
        hits = cast_rays_exactly(self._shapes, _take_rays(rays, chosen))
        shape = [
            np.flatnonzero(self._shapes.entity == entity)[0] if entity != NO_ENTITY else NO_SHAPE
            for entity in hits.entities.tolist()
        ]
        found.keep(chosen, hits.ranges, np.array(shape), -1)

    def _add_triangle_normals(self, found: Surfaces, normals: FloatArray) -> None:
        flat = np.flatnonzero(found.triangle >= 0)
        is_still = np.isin(found.shape[flat], self._still)
        still, moving = flat[is_still], flat[~is_still]
        normals[still] = self._triangles.normals[found.triangle[still]]
        geometry = self._shapes.geometry[found.shape[moving]]
        for number in np.unique(geometry).tolist():
            chosen = moving[geometry == number]
            local = self._find_mesh(number).normals[found.triangle[chosen]]
            normals[chosen] = rotate(self._shapes.poses[found.shape[chosen], 3:], local)


def _take_rays(rays: Rays, chosen: IntArray) -> Rays:
    """Take some rays, in ascending order."""
    if len(chosen) == len(rays.origins):
        return rays
    return Rays(
        rays.origins[chosen], rays.directions[chosen], rays.max_range_m, rays.ignored[chosen]
    )


def _find_bundles(rays: Rays) -> _Bundles:
    origins, ignored = rays.origins, rays.ignored
    steps = origins[1:] - origins[:-1]
    is_new = np.einsum("ij,ij->i", steps, steps) > BUNDLE_STEP_M**2
    is_new |= ignored[1:] != ignored[:-1]
    first = np.flatnonzero(np.append(True, is_new))
    low, high = np.minimum.reduceat(origins, first), np.maximum.reduceat(origins, first)
    radii = np.linalg.norm(high - low, axis=1) / 2.0
    counts = np.diff(np.append(first, len(origins)))
    return _Bundles(first, counts, (low + high) / 2.0, radii, ignored[first])


def _find_bounds(geometry: ShapeGeometry) -> tuple[FloatArray, FloatArray]:
    """Find the lowest and the highest coordinates (3,) of a shape in its own frame."""
    shape = geometry.shape
    if shape.kind == "mesh":
        corners = geometry.triangles.reshape(-1, 3)
        return corners.min(axis=0), corners.max(axis=0)
    half = np.array(_list_half_sides(shape))
    return -half, half


def _list_half_sides(shape: Shape) -> Sequence[float]:
    first, second, third = shape.size
    if shape.kind == "box":
        return first / 2.0, second / 2.0, third / 2.0
    if shape.kind == "sphere":
        return first, first, first
    return first, first, second / 2.0 + (first if shape.kind == "capsule" else 0.0)


def _find_solid_normals(shapes: PlacedShapes, number: IntArray, points: FloatArray) -> FloatArray:
    """Find outward unit normals (n, 3) of boxes and round shapes at points on them."""
    geometry, poses = shapes.geometry[number], shapes.poses[number]
    local = rotate(conjugate(poses[:, 3:]), points - poses[:, :3])
    kind, sizes, height = shapes.kinds[geometry], shapes.sizes[geometry], local[:, 2]
    half = sizes[:, 1] / 2.0
    is_end = (kind == "cylinder") & (np.abs(height) >= half * (1.0 - END_MARGIN))
    is_box = kind == "box"
    face = np.abs(local[is_box]) / sizes[is_box]
    # Beside the ends, the normal points away from the nearest point of the axis.
    is_straight = np.isin(kind, ("capsule", "cylinder"))
    local[:, 2] -= np.where(is_straight, np.clip(height, -half, half), 0.0)
    local[is_box] *= face == face.max(axis=1, keepdims=True)
    local[is_end] = Z_AXIS
    lengths = np.linalg.norm(local, axis=1, keepdims=True)
    return rotate(poses[:, 3:], local / np.where(lengths > 0.0, lengths, 1.0))


def _place_triangles(shapes: PlacedShapes, numbers: IntArray) -> tuple[FloatArray, IntArray]:
    """Place triangles (t, 3, 3) of boxes and meshes; return the shape (t,) of each, too."""
    corners, shape = [NO_TRIANGLES], [np.zeros(0, np.intp)]
    geometry = shapes.geometry[numbers]
    for number in np.unique(geometry).tolist():
        local = _triangulate(shapes.geometries[number])
        found = numbers[geometry == number]
        placed = transform_points(shapes.poses[found, None, None], local)
        corners.append(placed.reshape(-1, 3, 3))
        shape.append(np.repeat(found, len(local)))
    return np.concatenate(corners), np.concatenate(shape)


def _triangulate(geometry: ShapeGeometry) -> FloatArray:
    """Make triangles (f, 3, 3) of a box or a mesh in its own frame."""
    if geometry.shape.kind == "box":
        return np.asarray((UNIT_CUBE * np.array(geometry.shape.size))[CUBE_FACES])
    return geometry.triangles
