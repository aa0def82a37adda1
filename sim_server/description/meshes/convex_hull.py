"""Convex hulls of a few hundred points, by quickhull in arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Points = NDArray[np.float64]
    Corners = NDArray[np.int64]

TOLERANCE = 1e-7
"""Height over a face up to which a point is part of it, as a share of the extent of the points.
Meshes are stored with this precision."""
MAX_DISPLACEMENTS = 5
DISPLACEMENT = 1e-6
"""Of points whose hull is ambiguous by rounding; each further attempt has ten times as much."""


class HullNotFound(ValueError):
    """Points are equal or not finite, or rounding leaves no closed hull."""


class _Faces(NamedTuple):
    """Triangles of a hull that grows."""

    corners: Corners
    """(f, 3), seen from outside against the clock."""
    normals: Points
    """(f, 3), outwards."""
    offsets: NDArray[np.float64]
    """(f,): of the planes along their normals."""
    farthest: Corners
    """(f,): the point that is highest over each face."""
    heights: NDArray[np.float64]
    """(f,): of those points."""


def find_hull_faces(points: Points) -> Corners:
    """Find the triangles (f, 3) of the convex hull of points (n, 3), wound outwards.

    Points less than `TOLERANCE` of the extent in front of the hull may be left out. Points on a
    plane get the hull of points near them.

    Source: Barber, Dobkin, Huhdanpaa, 'The quickhull algorithm for convex hulls', 1996; its rule
    for degenerate points, to displace all of them a little, is applied if a hull is not closed.

    Raises:
        HullNotFound: The points are equal or not finite.
    """
    if not (np.isfinite(points).all() and len(points) and np.ptp(points, axis=0).max() > 0.0):
        raise HullNotFound(f"{len(points)} points without extent have no hull")
    extent = float(np.ptp(points, axis=0).max())
    tolerance = TOLERANCE * extent
    found = _grow_hull(points, tolerance)
    for attempt in range(MAX_DISPLACEMENTS):
        if found is not None and _is_closed(found):
            return found
        reach = DISPLACEMENT * 10.0**attempt * extent
        found = _grow_hull(points + reach * _make_moves(len(points)), tolerance)
    raise HullNotFound(f"no closed hull of {len(points)} points is found")


def _make_moves(count: int) -> Points:
    """Make uneven moves (n, 3) from -1 to 1; the sandbox of the parser has no random numbers."""
    moves = np.outer(np.arange(1, count + 1), np.sqrt([2.0, 3.0, 5.0])) % 1.0
    return np.asarray(2.0 * moves - 1.0)


def _grow_hull(points: Points, tolerance: float) -> Corners | None:
    """Add the highest points over faces until none is outside; None if that does not end."""
    first = _find_tetrahedron(points, tolerance)
    if first is None:
        return None
    faces = _measure_faces(points, first)
    for _ in range(2 * len(points)):
        if float(faces.heights.max()) <= tolerance:
            return faces.corners
        neighbours = _find_neighbours(faces.corners, len(points))
        chosen = _choose_points(points, faces, neighbours, tolerance)
        added = _measure_faces(points, _cover_rims(faces.corners, neighbours, chosen))
        is_kept = chosen < 0
        faces = _Faces(
            *(np.concatenate([old[is_kept], new]) for old, new in zip(faces, added, strict=True))
        )
    return None


def _choose_points(points: Points, faces: _Faces, neighbours: Corners, tolerance: float) -> Corners:
    """Choose points to add at once; return the one (f,) that sees each face, or -1.

    Their visible faces have no common edge: then none sees a face that covers the rim of another,
    which is between the two faces at that rim.
    """
    is_candidate = np.zeros(len(points), bool)
    is_candidate[faces.farthest[faces.heights > tolerance]] = True
    candidates = np.flatnonzero(is_candidate)
    over = points[candidates] @ faces.normals.T - faces.offsets
    is_visible = over > tolerance
    is_near = is_visible | is_visible[:, neighbours].any(axis=2)
    is_excluded = is_visible.astype(np.float32) @ is_near.T.astype(np.float32) > 0.0
    chosen = np.full(len(faces.corners), -1)
    is_free = np.ones(len(candidates), bool)
    for one in np.argsort(-over.max(axis=1), kind="stable").tolist():
        if is_free[one]:
            chosen[is_visible[one]] = candidates[one]
            is_free &= ~is_excluded[:, one]
    return chosen


def _find_tetrahedron(points: Points, tolerance: float) -> Corners | None:
    """Find four faces (4, 3) of a large tetrahedron; None if the points are on a plane."""
    axis = int(np.argmax(np.ptp(points, axis=0)))
    one, two = int(np.argmin(points[:, axis])), int(np.argmax(points[:, axis]))
    from_line = np.linalg.norm(np.cross(points - points[one], points[two] - points[one]), axis=1)
    three = int(np.argmax(from_line))
    normal = np.cross(points[two] - points[one], points[three] - points[one])
    length = float(np.linalg.norm(normal))
    if length <= tolerance * float(np.linalg.norm(points[two] - points[one])):
        return None
    heights = (points - points[one]) @ (normal / length)
    four = int(np.argmax(np.abs(heights)))
    if abs(heights[four]) <= tolerance:
        return None
    if heights[four] > 0.0:
        two, three = three, two
    return np.array([[one, two, three], [two, one, four], [three, two, four], [one, three, four]])


def _measure_faces(points: Points, corners: Corners) -> _Faces:
    first, second, third = (points[corners[:, i]] for i in range(3))
    a, b = second - first, third - first
    normals = np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )
    normals /= np.maximum(np.sqrt((normals * normals).sum(axis=1)), np.finfo(float).tiny)[:, None]
    offsets = (normals * first).sum(axis=1)
    over = normals @ points.T - offsets[:, None]
    farthest = over.argmax(axis=1)
    return _Faces(corners, normals, offsets, farthest, over[np.arange(len(over)), farthest])


def _find_neighbours(corners: Corners, count: int) -> Corners:
    """Find the face (f, 3) beyond each edge, which starts at the corner in the same place."""
    ends = corners[:, [1, 2, 0]]
    face_of = np.zeros(count * count, np.int64)
    face_of[corners * count + ends] = np.arange(len(corners))[:, None]
    return np.asarray(face_of[ends * count + corners])


def _cover_rims(corners: Corners, neighbours: Corners, chosen: Corners) -> Corners:
    """Make a face from each rim between visible and other faces to the point that sees them."""
    is_rim = (chosen >= 0)[:, None] & (chosen[neighbours] < 0)
    tops = np.broadcast_to(chosen[:, None], corners.shape)
    return np.stack([corners[is_rim], corners[:, [1, 2, 0]][is_rim], tops[is_rim]], axis=1)


def _is_closed(corners: Corners) -> bool:
    """Whether triangles are the surface of one body: each edge belongs to two of them."""
    starts, ends = corners.reshape(-1), corners[:, [1, 2, 0]].reshape(-1)
    count = int(corners.max()) + 1
    edges = np.unique(starts * count + ends)
    used = len(np.unique(corners))
    is_paired = len(edges) == len(starts) and bool(np.isin(ends * count + starts, edges).all())
    return is_paired and len(corners) == 2 * used - 4
