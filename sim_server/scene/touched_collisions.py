"""Which collision of a link a point of contact is on: engines report links only."""

import numpy as np

from zensim.proto.messages.model_messages import Link, Shape
from zensim.proto.se3 import FloatArray, from_origin, invert, transform_points
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.convex_shapes import MeshVertices


def find_touched_collisions(link: Link, points: FloatArray, meshes: MeshVertices) -> IntArray:
    """Find the collisions (n,) of a link whose surfaces are nearest to points.

    Args:
        link: Has at least one collision.
        points: (n, 3) in the link.
        meshes: Of its collisions; a mesh counts as its bounding box.
    """
    if len(link.collisions) == 1:
        return np.zeros(len(points), dtype=np.intp)
    distances = [_find_distances(shape, points, meshes) for shape in link.collisions]
    return np.asarray(np.argmin(np.abs(distances), axis=0))


def _find_distances(shape: Shape, points: FloatArray, meshes: MeshVertices) -> FloatArray:
    """Find the distances (n,) of points from the surface of a shape, negative inside."""
    local = transform_points(invert(from_origin(shape.origin)), points)
    across, along = np.hypot(local[:, 0], local[:, 1]), local[:, 2]
    first, second, _ = shape.size
    match shape.kind:
        case "sphere":
            return np.asarray(np.linalg.norm(local, axis=1) - first)
        case "capsule":
            beyond = np.maximum(np.abs(along) - second / 2.0, 0.0)
            return np.asarray(np.hypot(across, beyond) - first)
        case "cylinder":
            return _find_box_distances(np.stack([across, along], axis=1), [first, second / 2.0])
        case "plane":
            return np.asarray(along)
        case "mesh":
            vertices = meshes(shape.mesh) * np.array(shape.size)
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            return _find_box_distances(local - (low + high) / 2.0, (high - low) / 2.0)
    return _find_box_distances(local, np.array(shape.size) / 2.0)


def _find_box_distances(points: FloatArray, halves: FloatArray | list[float]) -> FloatArray:
    beyond = np.abs(points) - halves
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))
