"""What never moves, seen from above: edges with heights that nobody may drive through. Pure."""

from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.rotation import rotate
from zensim.sim_server.description.model_geometry import find_link_poses
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.tiers.footprint import Corners, Piece, piece_of, ring

LARGE_M = 0.3
"""What is round and larger is taken as a polygon."""
MANY = 32
"""Corners of such a polygon."""


@dataclass(frozen=True)
class Edges:
    """Line segments on the ground, thickened by discs.

    Attributes:
        ends: (n, 4): x and y of both ends.
        thick: (n,) radius [m] about them.
        heights: (n, 2) from where to where [m] they stand.
    """

    ends: FloatArray
    thick: FloatArray
    heights: FloatArray

    def __len__(self) -> int:
        return len(self.thick)


NO_EDGES = Edges(np.zeros((0, 4)), np.zeros(0), np.zeros((0, 2)))


def joined(parts: list[Edges]) -> Edges:
    """Put edges together."""
    if not parts:
        return NO_EDGES
    return Edges(
        np.concatenate([part.ends for part in parts]),
        np.concatenate([part.thick for part in parts]),
        np.concatenate([part.heights for part in parts]),
    )


def outline_of(model: Model, base: FloatArray, corners: Corners) -> Edges:
    """Find the outlines of a model that never moves.

    A mesh is its triangles, hollows and all; everything else is convex. What leans is taken as
    wide as it is anywhere.

    Args:
        model: Of what stands there; its joints are at zero.
        base: State row (7,) or longer of its root link.
        corners: Finds those of a mesh.
    """
    poses = find_link_poses(model.links[0].name, model.joints)
    found = []
    for link in model.links:
        for shape in link.collisions:
            if shape.kind == "plane":
                continue
            piece = piece_of(shape, poses[link.name], corners)
            points = base[:3] + rotate(base[3:7], piece.points)
            moved = Piece(points, piece.ball_m)
            found.append(_triangles(moved) if shape.kind == "mesh" else _convex(moved))
    return joined(found)


def _convex(piece: Piece) -> Edges:
    flat, thick = piece.points[:, :2], piece.ball_m
    if thick > LARGE_M:
        flat = (flat[:, None, :] + ring(thick, MANY)).reshape(-1, 2)
        thick = 0.0
    ends = hull_edges(flat)
    count = len(ends)
    return Edges(
        ends, np.full(count, thick), np.tile(np.array([[piece.low, piece.high]]), (count, 1))
    )


def hull_edges(points: FloatArray) -> FloatArray:
    """Find the edges (k, 4) of the hull of points (n, 2); of those on one line, that line.

    Source: Andrew, 'Another efficient algorithm for convex hulls in two dimensions', 1979.
    """
    ordered = [(x, y) for x, y in np.unique(points, axis=0).tolist()]
    corners = np.array(_chain(ordered)[:-1] + _chain(ordered[::-1])[:-1] or ordered)
    return np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1)


def _chain(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Go from the first of ordered points to the last, always around their right."""
    found: list[tuple[float, float]] = []
    for x, y in points:
        while len(found) > 1 and _turn(found[-2], found[-1], (x, y)) <= 0.0:
            found.pop()
        found.append((x, y))
    return found


def _turn(
    first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]
) -> float:
    (ax, ay), (bx, by), (cx, cy) = first, second, third
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _triangles(piece: Piece) -> Edges:
    triangles = piece.points.reshape(-1, 3, 3)
    low, high = triangles[:, :, 2].min(axis=1), triangles[:, :, 2].max(axis=1)
    starts = triangles[:, :, :2]
    ends = np.concatenate([starts, np.roll(starts, -1, axis=1)], axis=2).reshape(-1, 4)
    heights = np.repeat(np.stack([low, high], axis=1), 3, axis=0)
    return Edges(ends, np.zeros(len(ends)), heights)
