"""Convex collision shapes: vertices, bounds, reach, and GJK overlap tests."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Model, Shape
from zensim.proto.se3 import FloatArray, from_origin, rotate, transform_points

MeshVertices = Callable[[str], npt.NDArray[np.floating]]
"""Corners (n, 3) of the mesh of a `Shape.mesh`, unscaled."""
Z_AXIS = np.array([0.0, 0.0, 1.0])
MAX_GJK_ITERATIONS = 64
TOUCH_TOLERANCE_M = 1e-6
"""Solids that are this near overlap."""
UNIT_CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
SPHERE_DIRECTIONS = 512
RING_VERTICES = 24
"""Corners of a circle where one has to have corners."""


@dataclass(frozen=True)
class ConvexShape:
    """The hull of points, thickened by a ball, or across an axis by a disc.

    Attributes:
        points: (m, 3), m > 0.
        ball_m: Radius of the ball; 0 = none.
        disc_m: Radius of the disc; 0 = none.
        axis: Unit vector (3,) that the disc is square to.
    """

    points: FloatArray
    sphere_radius_m: float = 0.0
    disc_radius_m: float = 0.0
    axis: FloatArray = field(default_factory=lambda: Z_AXIS)

    def transformed_by(self, pose: FloatArray) -> "ConvexShape":
        """Move it by a pose (7,)."""
        points = transform_points(pose, self.points)
        return replace(self, points=points, axis=rotate(pose[3:], self.axis))

    @property
    def radius_from_origin(self) -> float:
        """How far [m] it reaches from the origin, at most."""
        return (
            float(np.linalg.norm(self.points, axis=1).max())
            + self.sphere_radius_m
            + self.disc_radius_m
        )

    def support_point(self, direction: FloatArray) -> FloatArray:
        """Find the point (3,) that lies farthest in a direction (3,)."""
        point = self.points[int(np.argmax(self.points @ direction))]
        if self.sphere_radius_m:
            point = point + direction * (self.sphere_radius_m / max(_norm(direction), 1e-12))
        if self.disc_radius_m:
            across = direction - float(direction @ self.axis) * self.axis
            point = point + across * (self.disc_radius_m / max(_norm(across), 1e-12))
        return np.asarray(point)

    def bounds_at(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find the lowest and the highest coordinates (n, 3) when moved by poses (n, 7)."""
        points = transform_points(poses[:, None], self.points)
        reach = np.full((len(poses), 3), self.sphere_radius_m)
        if self.disc_radius_m:
            along = rotate(poses[:, 3:], self.axis)
            reach = reach + self.disc_radius_m * np.sqrt(np.maximum(1.0 - along * along, 0.0))
        return points.min(axis=1) - reach, points.max(axis=1) + reach

    def vertices(self) -> FloatArray:
        """Find points (k, 3) whose hull it is; of what is round, `RING_VERTICES` on each circle."""
        if self.disc_radius_m:
            return (self.points[:, None, :] + self.disc_radius_m * _unit_ring(self.axis)).reshape(
                -1, 3
            )
        if self.sphere_radius_m:
            return (
                self.points[:, None, :] + self.sphere_radius_m * _unit_sphere(4 * RING_VERTICES)
            ).reshape(-1, 3)
        return self.points


def list_collision_shapes(model: Model, corners: MeshVertices) -> Iterator[tuple[str, ConvexShape]]:
    """List the collisions of a model, each with its link, in the link's frame; planes are none."""
    for link in model.links:
        for shape in link.collisions:
            if shape.kind != "plane":
                yield (
                    link.name,
                    _to_convex_shape(shape, corners).transformed_by(from_origin(shape.origin)),
                )


def place_collision_shapes(
    model: Model, poses: dict[str, FloatArray], corners: MeshVertices
) -> Iterator[tuple[ConvexShape, FloatArray]]:
    """List the collisions of a model with the poses (n, 7) of their links."""
    for link, solid in list_collision_shapes(model, corners):
        yield solid, poses[link]


def find_bounding_radius(model: Model, corners: MeshVertices) -> float:
    """Find how far [m] the collisions of a model can be from its root, however its joints stand."""
    links = {model.links[0].name: 0.0}
    for joint in model.joints:
        slide = max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0
        links[joint.child] = links[joint.parent] + math.hypot(*joint.origin.position) + slide
        if joint.kind not in ("revolute", "continuous", "fixed") and not slide:
            links[joint.child] = math.inf
    return max(
        (
            links[link] + solid.radius_from_origin
            for link, solid in list_collision_shapes(model, corners)
        ),
        default=0.0,
    )


def _to_convex_shape(shape: Shape, corners: MeshVertices) -> ConvexShape:
    first, second, _ = shape.size
    ends = np.array([-0.5, 0.5])[:, None] * Z_AXIS * second
    if shape.kind == "box":
        return ConvexShape(UNIT_CUBE * np.array(shape.size))
    if shape.kind == "sphere":
        return ConvexShape(np.zeros((1, 3)), sphere_radius_m=first)
    if shape.kind == "capsule":
        return ConvexShape(ends, sphere_radius_m=first)
    if shape.kind == "cylinder":
        return ConvexShape(ends, disc_radius_m=first)
    return ConvexShape(np.asarray(corners(shape.mesh), dtype=np.float64) * np.array(shape.size))


def find_extreme_points(points: FloatArray) -> FloatArray:
    """Keep the points (n, 3) that lie farthest in directions spread over a sphere."""
    reach = points @ _unit_sphere(SPHERE_DIRECTIONS).T
    return np.asarray(points[np.unique(np.argmax(reach, axis=0))])


def are_overlapping(one: ConvexShape, other: ConvexShape) -> bool:
    """Whether two solids overlap or touch.

    Source: Gilbert, Johnson, Keerthi, 'A fast procedure for computing the distance between complex
    objects in three-dimensional space', 1988.
    """
    nearest = one.points[0] - other.points[0]
    corners = nearest[None]
    for _ in range(MAX_GJK_ITERATIONS):
        if _norm(nearest) <= TOUCH_TOLERANCE_M:
            return True
        newest = one.support_point(-nearest) - other.support_point(nearest)
        if float(newest @ nearest) > TOUCH_TOLERANCE_M * _norm(nearest):
            return False
        if (corners == newest).all(axis=1).any():
            return _norm(nearest) <= TOUCH_TOLERANCE_M
        corners, nearest = _find_nearest_on_simplex(np.vstack([corners, newest]))
    # So slow only where two round solids all but touch.
    return True


def _find_nearest_on_simplex(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the point of a simplex next to the origin, and the corners of the face that it is in.

    The last corner is the newest, and one of that face.
    """
    newest, others = corners[-1], corners[:-1]
    best, face = newest, corners[-1:]
    for count in range(1, len(others) + 1):
        for chosen in combinations(range(len(others)), count):
            edges = others[list(chosen)] - newest
            shares = np.linalg.lstsq(edges.T, -newest, rcond=None)[0]
            if (shares <= 0.0).any() or shares.sum() >= 1.0:
                continue
            point = newest + shares @ edges
            if float(point @ point) < float(best @ best):
                best, face = point, np.vstack([others[list(chosen)], newest])
    return face, best


def _norm(vector: FloatArray) -> float:
    return float(np.sqrt(vector @ vector))


def _unit_ring(axis: FloatArray) -> FloatArray:
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= _norm(side)
    turns = np.arange(RING_VERTICES)[:, None] * (2.0 * np.pi / RING_VERTICES)
    return np.asarray(np.cos(turns) * side + np.sin(turns) * np.cross(axis, side))


def _unit_sphere(count: int) -> FloatArray:
    """Spread directions (count, 3) evenly; the axes are among them."""
    turns = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    ring = np.sqrt(1.0 - z * z)
    spiral = np.stack([ring * np.cos(turns), ring * np.sin(turns), z], axis=1)
    return np.vstack([np.eye(3), -np.eye(3), spiral])
