"""Convex pieces of meshes: MuJoCo collides convex hulls only."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Shape
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


def split_into_convex_pieces(corners: HullPoints, *, is_static: bool) -> list[HullPoints]:
    """Split triangles (3 f, 3) into the corners of convex pieces.

    A moving mesh becomes its hull. A static mesh is split into connected components; convex ones
    stay whole, the others become a thin piece for each triangle.
    """
    if not is_static:
        return [thicken(np.unique(corners, axis=0))]
    return [piece for part in _find_components(corners) for piece in _split_component(part)]


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


def _split_component(triangles: HullPoints) -> Iterator[HullPoints]:
    if len(triangles) <= MAX_CONVEXITY_FACES and _is_convex(triangles):
        yield thicken(np.unique(triangles.reshape(-1, 3), axis=0))
        return
    normals = _face_normals(triangles)
    for corners, normal in zip(triangles, normals, strict=True):
        if normal.any():
            yield np.concatenate([corners, corners - SHEET_THICKNESS_M * normal])


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


@cache
def load_convex_pieces(
    folder: str,
    shape: Shape,
    is_static: bool,  # noqa: FBT001
) -> tuple[HullPoints, ...]:
    """Load the mesh of a shape, scaled, as convex pieces."""
    corners = read_corners(Path(folder, f"{shape.mesh}.stl").read_bytes()) * np.array(shape.size)
    return tuple(split_into_convex_pieces(corners, is_static=is_static))
