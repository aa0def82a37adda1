"""Meshes as convex pieces, as MuJoCo collides convex hulls only."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Shape
from zensim.proto.stl import read_corners

HullPoints = npt.NDArray[np.float64]

SHEET_THICKNESS_M = 0.01
"""How thick a single triangle of a static mesh is made, away from its front."""
MIN_THICKNESS_SHARE = 1e-4
"""Share of its extent that a hull is at least thick: thinner ones have no hull."""
CONVEXITY_TOLERANCE = 1e-3
"""Share of its extent by which a corner may be before a face of what counts as its own hull."""
MAX_CONVEXITY_FACES = 2000
"""Faces of a piece that is still asked whether it is its own hull."""


def split_into_convex_pieces(corners: HullPoints, *, is_static: bool) -> list[HullPoints]:
    """Divide triangles (3 f, 3) into the corners of convex pieces.

    What moves is its hull. What is static is divided into what hangs together; of that, what is its
    own hull stays whole, and the rest is a thin piece a triangle.
    """
    if not is_static:
        return [thicken(np.unique(corners, axis=0))]
    return [piece for part in _find_components(corners) for piece in _split_component(part)]


def thicken(points: HullPoints) -> HullPoints:
    """Thicken points that lie in a plane, in a line or in one place, so that they have a hull."""
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
    """Find unit normals (f, 3); 0 for what has no area."""
    crossed = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(crossed, axis=1, keepdims=True)
    return np.asarray(np.divide(crossed, lengths, out=np.zeros_like(crossed), where=lengths > 0.0))


def _is_convex(triangles: HullPoints) -> bool:
    points = np.unique(triangles.reshape(-1, 3), axis=0)
    allowed = CONVEXITY_TOLERANCE * float(np.ptp(points, axis=0).max())
    normals = _face_normals(triangles)
    heights = normals @ points.T - np.einsum("ij,ij->i", normals, triangles[:, 0])[:, None]
    is_flat = bool((np.abs(heights) <= allowed).all())
    # A sheet that bends nowhere may still have a hole or a notch in it: then one triangle is all.
    return len(triangles) == 1 if is_flat else bool((heights <= allowed).all())


def _find_components(corners: HullPoints) -> list[HullPoints]:
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


@cache
def load_convex_pieces(folder: str, shape: Shape, is_static: bool) -> tuple[HullPoints, ...]:  # noqa: FBT001
    """Cut the mesh of a shape, scaled as it is."""
    corners = read_corners(Path(folder, f"{shape.mesh}.stl").read_bytes()) * np.array(shape.size)
    return tuple(split_into_convex_pieces(corners, is_static=is_static))
