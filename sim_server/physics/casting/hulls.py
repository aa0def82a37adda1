"""Meshes as MuJoCo can take them, as hulls: what has dents is given in pieces that have none."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]

SHEET_M = 0.01
"""How thick a single triangle of a static mesh is made, away from its front."""
FLAT = 1e-4
"""Share of its extent that a hull is at least thick: thinner ones have no hull."""
BULGE = 1e-3
"""Share of its extent by which a corner may be before a face of what counts as its own hull."""
MAX_CHECKED = 2000
"""Faces of a piece that is still asked whether it is its own hull."""


def pieces_of(corners: Points, *, is_static: bool) -> list[Points]:
    """Divide triangles (3 f, 3) into the corners of convex pieces.

    What moves is its hull. What is static is divided into what hangs together; of that, what is its
    own hull stays whole, and the rest is a thin piece a triangle.
    """
    if not is_static:
        return [solid(np.unique(corners, axis=0))]
    return [piece for part in _connected(corners) for piece in _pieces(part)]


def solid(points: Points) -> Points:
    """Thicken points that lie in a plane, in a line or in one place, so that they have a hull."""
    middle = points.mean(axis=0)
    spread, axes = np.linalg.eigh((points - middle).T @ (points - middle) / len(points))
    extent = max(float(np.sqrt(max(spread[-1], 0.0))), SHEET_M * FLAT)
    for moment, axis in zip(spread, axes.T, strict=True):
        if np.sqrt(max(moment, 0.0)) < FLAT * extent:
            shift = axis * max(SHEET_M / 2.0, FLAT * extent)
            points = np.concatenate([points - shift, points + shift])
    return points


def _pieces(triangles: Points) -> Iterator[Points]:
    if len(triangles) <= MAX_CHECKED and _is_own_hull(triangles):
        yield solid(np.unique(triangles.reshape(-1, 3), axis=0))
        return
    normals = _normals(triangles)
    for corners, normal in zip(triangles, normals, strict=True):
        if normal.any():
            yield np.concatenate([corners, corners - SHEET_M * normal])


def _normals(triangles: Points) -> Points:
    """Find unit normals (f, 3); 0 for what has no area."""
    crossed = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(crossed, axis=1, keepdims=True)
    return np.asarray(np.divide(crossed, lengths, out=np.zeros_like(crossed), where=lengths > 0.0))


def _is_own_hull(triangles: Points) -> bool:
    points = np.unique(triangles.reshape(-1, 3), axis=0)
    allowed = BULGE * float(np.ptp(points, axis=0).max())
    normals = _normals(triangles)
    heights = normals @ points.T - np.einsum("ij,ij->i", normals, triangles[:, 0])[:, None]
    is_flat = bool((np.abs(heights) <= allowed).all())
    # A sheet that bends nowhere may still have a hole or a notch in it: then one triangle is all.
    return len(triangles) == 1 if is_flat else bool((heights <= allowed).all())


def _connected(corners: Points) -> list[Points]:
    """Group triangles (f, 3, 3) that share corners."""
    _, names = np.unique(np.round(corners, 6), axis=0, return_inverse=True)
    faces = names.reshape(-1, 3)
    groups = np.arange(int(faces.max(initial=-1)) + 1)
    while True:
        least = groups[faces].min(axis=1)
        found = groups.copy()
        np.minimum.at(found, faces, least[:, None])
        found = found[found]
        if np.array_equal(found, groups):
            break
        groups = found
    owner, triangles = groups[faces[:, 0]], corners.reshape(-1, 3, 3)
    return [triangles[owner == group] for group in np.unique(owner)]
