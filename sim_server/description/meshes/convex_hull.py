"""Convex hulls of points, by manifold3d: exact, or with the corners that matter most."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

Points = NDArray[np.float64]
Indices = NDArray[np.int64]

MAX_HULL_CORNERS = 96
"""Corners of a reduced hull."""
FIRST_CORNERS = 48
"""Extreme points that a hull begins with."""
MAX_ADDED_CORNERS = 16
"""Corners added at once: each of them changes which point is farthest from the hull."""
TOLERANCE = 1e-6
"""Height over a hull up to which a point is part of it, as a share of the extent of the points.
Meshes are stored with a tenth of it."""
MAX_POINTS = 100_000
"""Points that are all used; of more, the farthest in `DIRECTIONS_OF_MANY` directions."""
DIRECTIONS_OF_MANY = 512
RIM_POINTS = 32
"""Points of the rim of a wheel; even."""
ROUND_SHARE = 0.96
"""Least width over the largest of a round outline; a regular polygon of 12 sides has 0.966."""
POINTS_PER_CHUNK = 1 << 9
"""Products of fewer points are computed in one thread, which takes a twentieth of the CPU time."""
FLAT_RATIO = 1e-4
"""Thickness over width below which points are flat."""
SLIVER_RATIO = 1e-9
"""Area over the squared extent; the direction of a smaller triangle is left to rounding."""


class HullNotFound(ValueError):
    """There are no points, they are equal, or a coordinate is not finite."""


class Hull(NamedTuple):
    """Corners (v, 3) and triangles (f, 3) of a hull, wound outwards."""

    corners: Points
    faces: Indices


def find_hull(points: Points) -> Hull:
    """Find the convex hull of points (n, 3) with at most `MAX_HULL_CORNERS` corners.

    A hull with fewer corners is exact. Of others, corners are added where points are farthest
    outside. Points on a plane or line get a thickness.

    Raises:
        HullNotFound: There are no points, or a coordinate is not finite.
    """
    _check_points(points)
    if len(points) > MAX_POINTS:
        points = points[_find_extreme_points(points, DIRECTIONS_OF_MANY)]
    points = _thicken(points)
    chosen = np.union1d(_find_tetrahedron(points), _find_extreme_points(points, FIRST_CORNERS))
    hull = find_exact_hull(points[chosen])
    while room := MAX_HULL_CORNERS - len(chosen):
        outside = _find_outside_points(points, hull)
        added = outside[~np.isin(outside, chosen)][: min(room, MAX_ADDED_CORNERS)]
        if not len(added):
            break
        chosen = np.union1d(chosen, added)
        hull = find_exact_hull(points[chosen])
    return hull


def find_exact_hull(points: Points) -> Hull:
    """Find the convex hull of at most 256 points (n, 3) with all its corners.

    Hulls of some 600 corners are computed in threads: the sandbox of the parser refuses them, and
    the order of triangles depends on them. Points are scaled to the same extent on each axis,
    because manifold3d merges points closer than 1e-7 of the largest coordinate.

    Raises:
        HullNotFound: The points are on a plane, or a coordinate is not finite.
    """
    _check_points(points)
    points = np.unique(points, axis=0)
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    if not extent.all():
        raise HullNotFound(f"{len(points)} different points on a plane have no hull")
    scaled = 2.0 * (points - low) / extent - 1.0
    found = Manifold.hull_points(scaled).to_mesh64()
    number = {place: index for index, place in enumerate(map(tuple, scaled.tolist()))}
    corner_of = np.array([number[tuple(place)] for place in found.vert_properties.tolist()])
    used, places = np.unique(corner_of[found.tri_verts], return_inverse=True)
    return Hull(points[used], _sort_faces(places.reshape(-1, 3)))


def _check_points(points: Points) -> None:
    if not len(points) or not np.isfinite(points).all():
        raise HullNotFound(f"{len(points)} points, or some that are not finite, have no hull")


def _sort_faces(faces: Indices) -> Indices:
    """Order triangles, each from its least index, so that equal hulls have equal bytes."""
    first = faces.argmin(axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    ordered: Indices = turned[np.lexsort(turned.T[::-1])]
    return ordered


def _find_outside_points(points: Points, hull: Hull) -> Indices:
    """Find the point farthest outside each face of a hull, the farthest of all first."""
    first, second, third = (hull.corners[hull.faces[:, side]] for side in range(3))
    normals = np.cross(second - first, third - first)
    areas, extent = np.linalg.norm(normals, axis=1), float(np.ptp(hull.corners, axis=0).max())
    is_wide = areas > SLIVER_RATIO * extent**2
    normals = normals[is_wide] / areas[is_wide, None]
    farthest = _find_farthest(points, normals)
    heights = ((points[farthest] - first[is_wide]) * normals).sum(axis=1)
    order = np.argsort(-heights, kind="stable")
    outside = farthest[order][heights[order] > TOLERANCE * extent]
    found: Indices = outside[np.sort(np.unique(outside, return_index=True)[1])]
    return found


def _find_tetrahedron(points: Points) -> Indices:
    """Find four points that are far from each other, and not on a plane if others are not."""
    axis = int(np.argmax(np.ptp(points, axis=0)))
    one, two = int(np.argmin(points[:, axis])), int(np.argmax(points[:, axis]))
    across = np.cross(points - points[one], points[two] - points[one])
    three = int(np.argmax((across * across).sum(axis=1)))
    heights = (points - points[one]) @ across[three]
    return np.array([one, two, three, int(np.argmax(np.abs(heights)))])


def _thicken(points: Points) -> Points:
    """Extend flat points, which have no hull, by a thousandth of their size on all sides."""
    spread = points - points.mean(axis=0)
    thinnest, _, widest = np.sqrt(np.maximum(np.linalg.eigvalsh(spread.T @ spread), 0.0)).tolist()
    if thinnest > FLAT_RATIO * widest:
        return points
    reach = max(float(np.abs(spread).max()), 1e-6) * 1e-3
    corners = np.array(np.meshgrid(*[[-reach, reach]] * 3)).T.reshape(-1, 3)
    thick: Points = (points[:, None, :] + corners[None, :, :]).reshape(-1, 3)
    return thick


def _find_extreme_points(points: Points, count: int) -> Indices:
    """Find the farthest points in directions on a Fibonacci sphere, and the rim of a wheel."""
    rim = _find_round_rim(points)
    even = points / np.maximum(np.ptp(points, axis=0), 1e-9)
    return np.union1d(_find_farthest(even, _make_directions(count - len(rim))), rim)


def _make_directions(count: int) -> Points:
    """Make directions (count, 3) on a Fibonacci sphere."""
    turns = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    ring = np.sqrt(1.0 - z * z)
    directions: Points = np.stack([ring * np.cos(turns), ring * np.sin(turns), z], axis=1)
    return directions


def _find_round_rim(points: Points) -> Indices:
    """Find the farthest points in the plane in which a wheel is round; none of other shapes.

    A curved tread has too few of the points that are farthest in even directions.
    """
    rims = [rim for axis in range(3) if len(rim := _find_rim(points, axis))]
    # A ball is round about each axis.
    return rims[0] if len(rims) == 1 else np.zeros(0, np.int64)


def _find_rim(points: Points, axis: int) -> Indices:
    """Find the farthest points about a coordinate axis; none if the outline is not round."""
    across = [one for one in range(3) if one != axis]
    least, most = sorted(np.ptp(points[:, across], axis=0).tolist())
    if least >= ROUND_SHARE * most:
        turns = np.arange(RIM_POINTS) * (2.0 * np.pi / RIM_POINTS)
        directions = np.zeros((RIM_POINTS, 3))
        directions[:, across] = np.stack([np.cos(turns), np.sin(turns)], axis=1)
        rim = _find_farthest(points, directions)
        reach = (points[rim] * directions).sum(axis=1)
        widths = reach + np.roll(reach, RIM_POINTS // 2)
        if widths.min() >= ROUND_SHARE * widths.max():
            return rim
    return np.zeros(0, np.int64)


def _find_farthest(points: Points, directions: Points) -> Indices:
    """Find the index of the farthest of points (n, 3) in each direction (m, 3)."""
    centred = points - points.mean(axis=0)
    size = max(float(np.abs(centred).max()), 1e-30)
    columns = (centred / size).astype(np.float32).T.copy()
    wanted, rows = directions.astype(np.float32), np.arange(len(directions))
    farthest = np.full(len(directions), -np.inf, np.float32)
    chosen = np.zeros(len(directions), np.int64)
    for start in range(0, len(points), POINTS_PER_CHUNK):
        products = wanted @ columns[:, start : start + POINTS_PER_CHUNK]
        best = np.argmax(products, axis=1)
        distances = products[rows, best]
        chosen = np.where(distances > farthest, best + start, chosen)
        farthest = np.maximum(distances, farthest)
    return chosen
