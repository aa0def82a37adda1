"""Planar footprints of models: bounding discs, heights, outlines of what is static."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Model, Origin, Shape
from zensim.proto.rigid_transforms import compose
from zensim.proto.se3 import FloatArray, from_origin, transform_points
from zensim.sim_server.description.model_geometry import (
    find_link_poses,
    links_in_contact,
)

MeshTriangles = Callable[[str], FloatArray]
"""Corners (3 f, 3) of the triangles of the mesh of a `Shape.mesh`, unscaled."""
UNIT_CUBE_CORNERS = np.array(
    [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
)
CIRCLE_VERTICES = 16
"""Corners of the polygon about a circle."""
CONTACT_HEIGHT_M = 0.01
"""What reaches this near to the lowest point stands on the ground."""


@dataclass(frozen=True)
class RoundedHull:
    """One collision: the hull of points (m, 3), thickened by a ball [m]."""

    points: FloatArray
    sphere_radius_m: float

    @property
    def low(self) -> float:
        """Its lowest height."""
        return float(self.points[:, 2].min()) - self.sphere_radius_m

    @property
    def high(self) -> float:
        """Its greatest height."""
        return float(self.points[:, 2].max()) + self.sphere_radius_m


@dataclass(frozen=True)
class Footprint:
    """A disc about a point of the root link, and heights against it, joints at zero [m].

    Attributes:
        feet: (m, 2) where it stands on the ground.
    """

    centre: tuple[float, float]
    radius_m: float
    low: float
    high: float
    feet: FloatArray


def make_circumscribed_polygon(radius_m: float, corners: int = CIRCLE_VERTICES) -> FloatArray:
    """Find the corners (k, 2) of a polygon that a circle about the origin fits into."""
    turns = np.arange(corners) * (2.0 * math.pi / corners)
    reach = radius_m / math.cos(math.pi / corners)
    return np.stack([np.cos(turns), np.sin(turns)], axis=1) * reach


def make_rounded_hull(shape: Shape, pose: Origin, corners: MeshTriangles) -> RoundedHull:
    """Lay out a collision that is not a plane.

    Args:
        shape: The collision.
        pose: Of the frame that `Shape.origin` is in.
        corners: Finds those of a mesh.
    """
    points, ball_m = _shape_points(shape, corners)
    place = from_origin(compose(pose, shape.origin))
    return RoundedHull(transform_points(place, points), ball_m)


def list_rounded_hulls(model: Model, corners: MeshTriangles) -> Iterator[RoundedHull]:
    """Lay out the collisions of a model in its root link, joints at zero; planes are left out."""
    poses = find_link_poses(model.links[0].name, model.joints)
    for link in links_in_contact(model):
        for shape in link.collisions:
            if shape.kind != "plane":
                yield make_rounded_hull(shape, poses[link.name], corners)


def measure_footprint(
    model: Model, corners: MeshTriangles, pivot: tuple[float, float] | None = None
) -> Footprint:
    """Find the room that a model takes which keeps its joints and only turns about z.

    Args:
        model: Of what stands upright.
        corners: Finds those of a mesh.
        pivot: What the disc is about; None = the middle of all collisions.
    """
    pieces = list(list_rounded_hulls(model, corners)) or [RoundedHull(np.zeros((1, 3)), 0.0)]
    low = min(piece.low for piece in pieces)
    if pivot is None:
        least = np.min([p.points[:, :2].min(axis=0) - p.sphere_radius_m for p in pieces], axis=0)
        most = np.max([p.points[:, :2].max(axis=0) + p.sphere_radius_m for p in pieces], axis=0)
        x, y = ((least + most) / 2.0).tolist()
        pivot = (x, y)
    radius = max(_planar_radius(piece, np.array(pivot)) for piece in pieces)
    feet = [_contact_points(piece) for piece in pieces if piece.low <= low + CONTACT_HEIGHT_M]
    high = max(piece.high for piece in pieces)
    return Footprint(pivot, radius, low, high, np.concatenate(feet))


def find_max_reach(model: Model, corners: MeshTriangles) -> float:
    """Find how far [m] a model may reach from its root, however its joints stand."""
    links = {model.links[0].name: 0.0}
    for joint in model.joints:
        slide = max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0
        links[joint.child] = links[joint.parent] + math.hypot(*joint.origin.position) + slide
    return max(
        (
            links[link.name] + _spatial_radius(make_rounded_hull(shape, Origin(), corners))
            for link in model.links
            for shape in link.collisions
            if shape.kind != "plane"
        ),
        default=0.0,
    )


def _planar_radius(piece: RoundedHull, pivot: FloatArray) -> float:
    arms = piece.points[:, :2] - pivot
    return float(np.hypot(arms[:, 0], arms[:, 1]).max()) + piece.sphere_radius_m


def _spatial_radius(piece: RoundedHull) -> float:
    return float(np.linalg.norm(piece.points, axis=1).max()) + piece.sphere_radius_m


def _contact_points(piece: RoundedHull) -> FloatArray:
    lowest = piece.points[:, 2] <= piece.points[:, 2].min() + CONTACT_HEIGHT_M
    return piece.points[lowest, :2]


def _shape_points(shape: Shape, corners: MeshTriangles) -> tuple[FloatArray, float]:
    first, second, _ = shape.size
    if shape.kind == "box":
        return UNIT_CUBE_CORNERS * np.array(shape.size), 0.0
    if shape.kind == "sphere":
        return np.zeros((1, 3)), first
    ends = np.array([[0.0, 0.0, -second / 2.0], [0.0, 0.0, second / 2.0]])
    if shape.kind == "capsule":
        return ends, first
    if shape.kind == "cylinder":
        rim = np.concatenate(
            [make_circumscribed_polygon(first), np.zeros((CIRCLE_VERTICES, 1))], axis=1
        )
        return (ends[:, None, :] + rim).reshape(-1, 3), 0.0
    return corners(shape.mesh) * np.array(shape.size), 0.0


LARGE_ROUND_M = 0.3
"""What is round and larger is taken as a polygon."""
LARGE_CIRCLE_VERTICES = 32
"""Corners of such a polygon."""


@dataclass(frozen=True)
class StaticEdges:
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


NO_EDGES = StaticEdges(np.zeros((0, 4)), np.zeros(0), np.zeros((0, 2)))


def concatenate_edges(parts: list[StaticEdges]) -> StaticEdges:
    """Put edges together."""
    if not parts:
        return NO_EDGES
    return StaticEdges(
        np.concatenate([part.ends for part in parts]),
        np.concatenate([part.thick for part in parts]),
        np.concatenate([part.heights for part in parts]),
    )


def find_outline(model: Model, base: FloatArray, corners: MeshTriangles) -> StaticEdges:
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
            piece = make_rounded_hull(shape, poses[link.name], corners)
            points = transform_points(base[:7], piece.points)
            moved = RoundedHull(points, piece.sphere_radius_m)
            found.append(_triangle_edges(moved) if shape.kind == "mesh" else _convex_edges(moved))
    return concatenate_edges(found)


def _convex_edges(piece: RoundedHull) -> StaticEdges:
    flat, thick = piece.points[:, :2], piece.sphere_radius_m
    if thick > LARGE_ROUND_M:
        flat = (
            flat[:, None, :] + make_circumscribed_polygon(thick, LARGE_CIRCLE_VERTICES)
        ).reshape(-1, 2)
        thick = 0.0
    ends = find_hull_edges(flat)
    count = len(ends)
    return StaticEdges(
        ends, np.full(count, thick), np.tile(np.array([[piece.low, piece.high]]), (count, 1))
    )


def find_hull_edges(points: FloatArray) -> FloatArray:
    """Find the edges (k, 4) of the hull of points (n, 2); of those on one line, that line.

    Source: Andrew, 'Another efficient algorithm for convex hulls in two dimensions', 1979.
    """
    ordered = [(x, y) for x, y in np.unique(points, axis=0).tolist()]
    corners = np.array(_half_hull(ordered)[:-1] + _half_hull(ordered[::-1])[:-1] or ordered)
    return np.concatenate([corners, np.roll(corners, -1, axis=0)], axis=1)


def _half_hull(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Go from the first of ordered points to the last, always around their right."""
    found: list[tuple[float, float]] = []
    for x, y in points:
        while len(found) > 1 and _cross_product(found[-2], found[-1], (x, y)) <= 0.0:
            found.pop()
        found.append((x, y))
    return found


def _cross_product(
    first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]
) -> float:
    (ax, ay), (bx, by), (cx, cy) = first, second, third
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _triangle_edges(piece: RoundedHull) -> StaticEdges:
    triangles = piece.points.reshape(-1, 3, 3)
    low, high = triangles[:, :, 2].min(axis=1), triangles[:, :, 2].max(axis=1)
    starts = triangles[:, :, :2]
    ends = np.concatenate([starts, np.roll(starts, -1, axis=1)], axis=2).reshape(-1, 4)
    heights = np.repeat(np.stack([low, high], axis=1), 3, axis=0)
    return StaticEdges(ends, np.zeros(len(ends)), heights)
