"""Convex pieces of meshes: MuJoCo collides convex hulls only."""

import heapq
import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Shape, Vec3
from zensim.proto.rigid_transforms import add, cross, normalize, scale
from zensim.proto.stl import read_corners

HullPoints = npt.NDArray[np.float64]

SHEET_THICKNESS_M = 0.01
"""Thickness that a single triangle of a static mesh gets behind its front."""
MIN_THICKNESS_SHARE = 1e-4
"""Least thickness of a hull, as a share of its extent."""
CONVEXITY_TOLERANCE = 1e-3
"""Largest distance of a corner in front of a face of a convex mesh, as a share of its extent."""
MAX_CONVEXITY_FACES = 2000
"""Number of faces up to which convexity is tested."""
PLATE_TOLERANCE_M, PLATE_TOLERANCE_SHARE = 0.003, 0.005
"""Largest distance of a plate's hull from its triangles: at most, and as a share of the mesh."""
LEAST_TOLERANCE_M = 0.002
"""The same at least: a tenth of the thickness."""
MAX_PLATES = 128
"""Plates of a component from which it gets a coarser tolerance: each takes time to compile."""
COARSE_TOLERANCE_M, COARSE_TOLERANCE_SHARE = 0.02, 0.02
"""The coarsest one: at most, and as a share of the mesh."""
PLATE_BEND_COS = 0.8
"""Least share of the areas of two plates that the area of both has along their mean normal."""
MAX_ROUNDING_M = 1e-6
"""Heights up to which corners are coplanar."""


def split_into_convex_pieces(corners: HullPoints, *, is_static: bool) -> list[HullPoints]:
    """Split triangles (3 f, 3) into the corners of convex pieces.

    A moving mesh becomes its hull. A static mesh is split into connected components; convex ones
    stay whole, the others become thin plates of neighbouring triangles that are nearly coplanar.
    """
    if not is_static:
        return [thicken(np.unique(corners, axis=0))]
    extent = float(np.ptp(corners, axis=0).max(initial=0.0)) if len(corners) else 0.0
    components = _find_components(corners)
    return [piece for part in components for piece in _split_component(part, extent)]


def thicken(points: HullPoints) -> HullPoints:
    """Thicken coplanar, collinear or coincident points, so that they have a hull."""
    middle = points.mean(axis=0)
    spread, axes = np.linalg.eigh((points - middle).T @ (points - middle) / len(points))
    extent = max(float(np.sqrt(max(spread[-1], 0.0))), SHEET_THICKNESS_M * MIN_THICKNESS_SHARE)
    for moment, axis in zip(spread, axes.T, strict=True):
        if np.sqrt(max(moment, 0.0)) < MIN_THICKNESS_SHARE * extent:
            shift = axis * max(SHEET_THICKNESS_M / 2.0, MIN_THICKNESS_SHARE * extent)
            points = np.concatenate([points - shift, points + shift])
    return points


def _split_component(triangles: HullPoints, extent_m: float) -> Iterator[HullPoints]:
    corners = triangles.reshape(-1, 3)
    # Plates would fill what is smaller.
    is_filled = float(np.ptp(corners, axis=0).max()) <= 2.0 * SHEET_THICKNESS_M
    if is_filled or (len(triangles) <= MAX_CONVEXITY_FACES and _is_convex(triangles)):
        yield thicken(np.unique(corners, axis=0))
        return
    tolerance_m = min(PLATE_TOLERANCE_M, PLATE_TOLERANCE_SHARE * extent_m)
    tolerance_m = max(tolerance_m, LEAST_TOLERANCE_M)
    coarsest_m = min(COARSE_TOLERANCE_M, COARSE_TOLERANCE_SHARE * extent_m)
    merger = PlateMerger(join_close_corners(triangles, tolerance_m), tolerance_m)
    plates = merger.merge()
    while len(plates) > MAX_PLATES and tolerance_m < coarsest_m:
        tolerance_m = min(2.0 * tolerance_m, coarsest_m)
        plates = merger.merge(tolerance_m)
    for front, normal in plates:
        yield np.concatenate([front, front - SHEET_THICKNESS_M * normal])


def join_close_corners(triangles: HullPoints, distance_m: float) -> HullPoints:
    """Let corners within a cube whose diagonal is a distance be the first of them.

    Small triangles that lose a corner are left out. Long ones stay: they may be a wire.
    """
    corners = triangles.reshape(-1, 3)
    cells = np.floor(corners * (math.sqrt(3.0) / distance_m)).astype(np.int64)
    _, first, owner = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    owners = owner.reshape(-1, 3)
    has_area = (owners != np.roll(owners, 1, axis=1)).all(axis=1)
    is_long = np.ptp(triangles, axis=1).max(axis=1) > SHEET_THICKNESS_M
    joined = corners[first][owners[has_area]]
    return np.concatenate([joined, triangles[is_long & ~has_area]])


def _face_normals(triangles: HullPoints) -> HullPoints:
    """Find unit normals (f, 3); 0 for triangles without area."""
    crossed = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(crossed, axis=1, keepdims=True)
    return np.asarray(np.divide(crossed, lengths, out=np.zeros_like(crossed), where=lengths > 0.0))


def _is_convex(triangles: HullPoints) -> bool:
    points = np.unique(triangles.reshape(-1, 3), axis=0)
    tolerance = CONVEXITY_TOLERANCE * float(np.ptp(points, axis=0).max())
    normals = _face_normals(triangles)
    heights = normals @ points.T - np.einsum("ij,ij->i", normals, triangles[:, 0])[:, None]
    is_flat = bool((np.abs(heights) <= tolerance).all())
    # A flat sheet may have a hole or a notch: only a single triangle is surely convex.
    return len(triangles) == 1 if is_flat else bool((heights <= tolerance).all())


Point2 = tuple[float, float]


class Plate(NamedTuple):
    """Neighbouring triangles that are nearly coplanar.

    Attributes:
        corners: Numbers of those of its hull.
        area: Vector area [m^2]: that of its projection, along the mean normal.
        low, high: Of its bounding box [m].
    """

    corners: frozenset[int]
    area: Vec3
    low: Vec3
    high: Vec3


def _join_boxes(one: Plate, other: Plate) -> tuple[Vec3, Vec3]:
    (a, b, c), (d, e, f) = one.low, other.low
    (p, q, r), (s, t, u) = one.high, other.high
    return (min(a, d), min(b, e), min(c, f)), (max(p, s), max(q, t), max(r, u))


class PlateMerger:
    """Merges neighbouring triangles into plates whose hulls keep to the surface, small ones first.

    Two plates become one if the hull of both is flat, and as large as both: it fills no notch.
    """

    def __init__(self, triangles: HullPoints, tolerance_m: float) -> None:
        self._tolerance_m = tolerance_m
        edges = triangles[:, 1:] - triangles[:, :1]
        areas = np.cross(edges[:, 0], edges[:, 1]) / 2.0
        has_area = areas.any(axis=1)
        corners = triangles[has_area].reshape(-1, 3)
        _, first, numbers = np.unique(
            np.round(corners, 6), axis=0, return_index=True, return_inverse=True
        )
        self._points: list[Vec3] = corners[first].tolist()
        faces = numbers.reshape(-1, 3).tolist()
        lows, highs = (find(corners.reshape(-1, 3, 3), axis=1) for find in (np.min, np.max))
        columns = zip(faces, areas[has_area].tolist(), lows.tolist(), highs.tolist(), strict=True)
        self._plates = {
            number: Plate(frozenset(face), area, low, high)
            for number, (face, area, low, high) in enumerate(columns)
        }
        self._neighbours = find_face_neighbours(faces)

    def merge(self, tolerance_m: float | None = None) -> list[tuple[HullPoints, HullPoints]]:
        """Merge what can be merged, on request with another tolerance than before.

        Returns:
            The corners (n, 3) and the unit normal of each plate.
        """
        self._tolerance_m = tolerance_m or self._tolerance_m
        neighbours = self._neighbours
        pairs = [(self._measure(i, j), i, j) for i in neighbours for j in neighbours[i] if i < j]
        heapq.heapify(pairs)
        for number in count(max(self._plates, default=0) + 1):
            if (found := self._merge_next(pairs)) is None:
                break
            i, j, self._plates[number] = found
            around = neighbours[number] = (neighbours.pop(i) | neighbours.pop(j)) - {i, j}
            for other in sorted(around):
                neighbours[other] -= {i, j}
                neighbours[other].add(number)
                heapq.heappush(pairs, (self._measure(other, number), other, number))
        return [
            (
                np.array([self._points[corner] for corner in sorted(plate.corners)]),
                np.array(plate.area) / math.hypot(*plate.area),
            )
            for plate in self._plates.values()
        ]

    def _merge_next(self, pairs: list[tuple[float, int, int]]) -> tuple[int, int, Plate] | None:
        """Merge the smallest pair that can be; remove it from the plates."""
        while pairs:
            diameter_m, i, j = heapq.heappop(pairs)
            if i in self._plates and j in self._plates:
                plate = self._unite(self._plates[i], self._plates[j], diameter_m)
                if plate is not None:
                    del self._plates[i], self._plates[j]
                    return i, j, plate
        return None

    def _measure(self, one: int, other: int) -> float:
        """Measure the diagonal [m] of the box around two plates."""
        return math.dist(*_join_boxes(self._plates[one], self._plates[other]))

    def _unite(self, one: Plate, other: Plate, diameter_m: float) -> Plate | None:
        """Make one plate of two; None if its hull would not keep to the surface."""
        area = add(one.area, other.area)
        size = math.hypot(*area)
        if size < PLATE_BEND_COS * (math.hypot(*one.area) + math.hypot(*other.area)):
            return None
        normal = scale(area, 1.0 / size)
        corners = one.corners | other.corners
        heights = [_dot(normal, self._points[corner]) for corner in corners]
        if (spread := max(heights) - min(heights)) > self._tolerance_m:
            return None
        flat = self._flatten(corners, normal)
        hull = find_hull(flat)
        # A notch of this area is shallow, or narrow.
        if abs(find_polygon_area(hull) - size) > 0.5 * self._tolerance_m * diameter_m:
            return None
        if spread < MAX_ROUNDING_M:
            corners = frozenset(flat[point] for point in hull)
        return Plate(corners, area, *_join_boxes(one, other))

    def _flatten(self, corners: Iterable[int], normal: Vec3) -> dict[Point2, int]:
        """Project corners along a normal; the corner at each place."""
        first, second = find_plane_axes(normal)
        points = self._points
        return {(_dot(first, points[i]), _dot(second, points[i])): i for i in corners}


def find_face_neighbours(faces: Sequence[Sequence[int]]) -> dict[int, set[int]]:
    """Find the neighbours of each face: those that run through an edge in the other sense."""
    by_edge: dict[tuple[int, int], list[int]] = {}
    for face, corners in enumerate(faces):
        for i in range(len(corners)):
            by_edge.setdefault((corners[i - 1], corners[i]), []).append(face)
    found: dict[int, set[int]] = {face: set() for face in range(len(faces))}
    for (start, end), owners in by_edge.items():
        others = by_edge.get((end, start), ())
        for owner in owners:
            found[owner].update(others)
            found[owner].discard(owner)
    return found


def find_hull(points: Iterable[Point2]) -> list[Point2]:
    """Find the convex hull of different points, counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted(points)
    return _find_half_hull(ordered)[:-1] + _find_half_hull(ordered[::-1])[:-1]


def _find_half_hull(ordered: Iterable[Point2]) -> list[Point2]:
    half: list[Point2] = []
    for x, y in ordered:
        while len(half) > 1:
            (x0, y0), (x1, y1) = half[-2:]
            if (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) > 0.0:
                break
            half.pop()
        half.append((x, y))
    return half


def find_polygon_area(corners: Sequence[Point2]) -> float:
    """Find the area [m^2] of a counter-clockwise polygon."""
    edges = zip(corners, [*corners[1:], *corners[:1]], strict=True)
    return sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in edges) / 2.0


def find_plane_axes(normal: Vec3) -> tuple[Vec3, Vec3]:
    """Find two axes that are at right angles to each other and to a normal."""
    x, y, z = normal
    # Not along the greatest component, which may be all of the normal.
    first = normalize((0.0, z, -y) if abs(x) < max(abs(y), abs(z)) else (-z, 0.0, x))
    return first, cross(normal, first)


def _dot(one: Vec3, other: Vec3) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _find_components(corners: HullPoints) -> list[HullPoints]:
    """Group triangles (f, 3, 3) that share corners, directly or by others."""
    _, corner_ids = np.unique(np.round(corners, 6), axis=0, return_inverse=True)
    faces = corner_ids.reshape(-1, 3)
    groups = np.arange(int(faces.max(initial=-1)) + 1)
    while True:
        lowest = groups[faces].min(axis=1)
        merged = groups.copy()
        np.minimum.at(merged, faces, lowest[:, None])
        merged = merged[merged]
        if np.array_equal(merged, groups):
            break
        groups = merged
    owner, triangles = groups[faces[:, 0]], corners.reshape(-1, 3, 3)
    return [triangles[owner == group] for group in np.unique(owner)]


def load_convex_pieces(
    folder: str,
    shape: Shape,
    is_static: bool,  # noqa: FBT001
) -> tuple[HullPoints, ...]:
    """Load the mesh of a shape, scaled, as convex pieces."""
    return _load_mesh_pieces(Path(folder, f"{shape.mesh}.stl"), shape.size, is_static=is_static)


@cache
def _load_mesh_pieces(file: Path, scale: Vec3, *, is_static: bool) -> tuple[HullPoints, ...]:
    corners = read_corners(file.read_bytes()) * np.array(scale)
    return tuple(split_into_convex_pieces(corners, is_static=is_static))
