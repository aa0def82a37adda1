"""Convex collision shapes: vertices, bounds, reach, and GJK distances."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Model, Shape
from zensim.proto.se3 import FloatArray, from_origin, rotate, transform_points

MeshVertices = Callable[[str], npt.NDArray[np.floating]]
"""Finds the vertices (n, 3) of a `Shape.mesh`, unscaled."""
Z_AXIS = np.array([0.0, 0.0, 1.0])
MAX_GJK_ITERATIONS = 64
TOUCH_TOLERANCE_M = 1e-6
"""Shapes that are this near overlap."""
UNIT_CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
SPHERE_DIRECTIONS = 512
RING_VERTICES = 24
"""Vertices on a circle that is approximated by a polygon."""


@dataclass(frozen=True)
class ConvexShape:
    """The convex hull of points, swept by a sphere or by a disc.

    Attributes:
        points: (m, 3), m > 0.
        sphere_radius_m: 0 = no sphere.
        disc_radius_m: 0 = no disc.
        axis: Unit normal (3,) of the disc.
    """

    points: FloatArray
    sphere_radius_m: float = 0.0
    disc_radius_m: float = 0.0
    axis: FloatArray = field(default_factory=lambda: Z_AXIS)

    def transformed_by(self, pose: FloatArray) -> "ConvexShape":
        """Transform the shape by a pose (7,)."""
        points = transform_points(pose, self.points)
        return replace(self, points=points, axis=rotate(pose[3:], self.axis))

    @property
    def radius_from_origin(self) -> float:
        """Upper bound [m] of the distance of its points from the origin."""
        return (
            float(np.linalg.norm(self.points, axis=1).max())
            + self.sphere_radius_m
            + self.disc_radius_m
        )

    def support_point(self, direction: FloatArray) -> FloatArray:
        """Find the point (3,) farthest along a direction (3,)."""
        point = self.points[int(np.argmax(self.points @ direction))]
        if self.sphere_radius_m:
            point = point + direction * (self.sphere_radius_m / max(_norm(direction), 1e-12))
        if self.disc_radius_m:
            across = direction - float(direction @ self.axis) * self.axis
            point = point + across * (self.disc_radius_m / max(_norm(across), 1e-12))
        return np.asarray(point)

    def bounds_at(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find the lowest and highest coordinates (n, 3) after transformation by poses (n, 7)."""
        points = transform_points(poses[:, None], self.points)
        reach = np.full((len(poses), 3), self.sphere_radius_m)
        if self.disc_radius_m:
            along = rotate(poses[:, 3:], self.axis)
            reach = reach + self.disc_radius_m * np.sqrt(np.maximum(1.0 - along * along, 0.0))
        return points.min(axis=1) - reach, points.max(axis=1) + reach

    def vertices(self) -> FloatArray:
        """Find points (k, 3) whose hull it is; round shapes become polyhedra inside them."""
        if self.disc_radius_m:
            return (self.points[:, None, :] + self.disc_radius_m * _unit_ring(self.axis)).reshape(
                -1, 3
            )
        if self.sphere_radius_m:
            return (
                self.points[:, None, :] + self.sphere_radius_m * _unit_sphere(4 * RING_VERTICES)
            ).reshape(-1, 3)
        return self.points


def to_convex_shape(shape: Shape, meshes: MeshVertices) -> ConvexShape:
    """Make a collision that is not a plane, in its own frame; a mesh becomes its convex hull."""
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
    return ConvexShape(np.asarray(meshes(shape.mesh), dtype=np.float64) * np.array(shape.size))


def list_collision_shapes(model: Model, meshes: MeshVertices) -> Iterator[tuple[str, ConvexShape]]:
    """List the collisions of a model but planes: link name, and shape in the link's frame."""
    for link in model.links:
        for shape in link.collisions:
            if shape.kind != "plane":
                solid = to_convex_shape(shape, meshes)
                yield link.name, solid.transformed_by(from_origin(shape.origin))


def find_bounding_radius(
    model: Model, meshes: MeshVertices, *, unlimited_m: float = math.inf
) -> float:
    """Find a radius [m] about the root link that holds all collisions at any joint positions.

    Args:
        model: Whose collisions are measured; planes are left out.
        meshes: Vertices by name.
        unlimited_m: Allowance for a joint that translates without limits.
    """
    links = {model.links[0].name: 0.0}
    for joint in model.joints:
        slide = max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0
        if joint.kind not in ("revolute", "continuous", "fixed") and not slide:
            slide = unlimited_m
        links[joint.child] = links[joint.parent] + math.hypot(*joint.origin.position) + slide
    return max(
        (
            links[link] + solid.radius_from_origin
            for link, solid in list_collision_shapes(model, meshes)
        ),
        default=0.0,
    )


def find_extreme_points(points: FloatArray) -> FloatArray:
    """Keep those of points (n, 3) that are farthest along one of many directions."""
    reach = points @ _unit_sphere(SPHERE_DIRECTIONS).T
    return np.asarray(points[np.unique(np.argmax(reach, axis=0))])


def are_overlapping(one: ConvexShape, other: ConvexShape) -> bool:
    """Whether two shapes overlap or touch."""
    for upper, lower in _bound_distance(one, other):
        if upper <= TOUCH_TOLERANCE_M:
            return True
        if lower > TOUCH_TOLERANCE_M:
            return False
    # Not converged: only two round shapes that all but touch.
    return True


def find_distance(one: ConvexShape, other: ConvexShape) -> float:
    """Find the distance [m] between two shapes; 0 when they overlap."""
    upper = 0.0
    for upper, lower in _bound_distance(one, other):
        if upper <= TOUCH_TOLERANCE_M:
            return 0.0
        if upper - lower <= TOUCH_TOLERANCE_M:
            break
    return upper


def _bound_distance(one: ConvexShape, other: ConvexShape) -> Iterator[tuple[float, float]]:
    """Bound the distance [m] of two shapes from above and below, more tightly each time.

    Source: Gilbert, Johnson, Keerthi, 'A fast procedure for computing the distance between complex
    objects in three-dimensional space', 1988.
    """
    nearest = one.points[0] - other.points[0]
    corners = nearest[None]
    for _ in range(MAX_GJK_ITERATIONS):
        upper = _norm(nearest)
        if upper <= TOUCH_TOLERANCE_M:
            yield upper, 0.0
        newest = one.support_point(-nearest) - other.support_point(nearest)
        is_final = bool((corners == newest).all(axis=1).any())
        yield upper, upper if is_final else float(newest @ nearest) / upper
        corners, nearest = _find_nearest_on_simplex(np.vstack([corners, newest]))


def _find_nearest_on_simplex(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the face of a simplex that is nearest to the origin, and its nearest point.

    The last corner is the newest one, and belongs to that face.
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
    """Spread unit vectors evenly: `count` and the six along the axes."""
    turns = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    ring = np.sqrt(1.0 - z * z)
    spiral = np.stack([ring * np.cos(turns), ring * np.sin(turns), z], axis=1)
    return np.vstack([np.eye(3), -np.eye(3), spiral])
