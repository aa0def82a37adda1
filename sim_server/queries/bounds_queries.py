"""Parses bounds, finds the entities that overlap them, and computes the bounds of entities."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.proto.forward_kinematics import compute_link_poses
from zensim.proto.messages.entity_messages import Bounds, BoundsType
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import Vector3
from zensim.proto.se3 import IDENTITY_POSE, FloatArray
from zensim.sim_server.errors import SimError
from zensim.sim_server.physics.engine import BodyStates
from zensim.sim_server.scene.convex_shapes import (
    UNIT_CUBE,
    ConvexShape,
    MeshVertices,
    are_overlapping,
    find_bounding_radius,
    find_extreme_points,
    place_collision_shapes,
)
from zensim.sim_server.world.entity import Entity, EntityIndex

BoolArray = npt.NDArray[np.bool_]

MAX_BOUNDS_POINTS = 1000
MAX_BOUNDS_COORDINATE_M = 1e6
MIN_HULL_POINTS = 3
COLLINEAR_RATIO = 1e-9
"""Second singular value over the first, below which points are on one line."""
ENTITIES_PER_TURN = 32
"""Entities of one model that are tested in one turn."""


class BoundsRefused(SimError):
    """Bounds that are not valid."""

    slug = "filter.bounds"


class BoundsUnsupported(BoundsRefused):
    """Bounds of a type that is not known."""

    code = ResultCode.FEATURE_UNSUPPORTED


@dataclass(frozen=True)
class Region:
    """A convex region of the world.

    Attributes:
        low: Lowest coordinates (3,).
        high: Highest coordinates (3,).
        is_box: Whether it is the whole box between them.
    """

    shape: ConvexShape
    low: FloatArray
    high: FloatArray
    is_box: bool


def parse_bounds(bounds: Bounds) -> Region | None:
    """Convert bounds in the world frame to a region; None if they are empty.

    Raises:
        BoundsRefused: The points do not fit the type.
        BoundsUnsupported: The type is not known.
    """
    if bounds.type == BoundsType.EMPTY:
        return None
    if bounds.type not in set(BoundsType):
        raise BoundsUnsupported(f"type {bounds.type} is not known; use 0 to {max(BoundsType)}")
    points = _parse_points(bounds)
    if bounds.type == BoundsType.SPHERE:
        radius = float(points[1, 0])
        if radius < 0.0:
            raise BoundsRefused(f"radius {radius:g} is negative; use metres as x of point 2")
        shape = ConvexShape(points[:1], radius)
        return Region(shape, points[0] - radius, points[0] + radius, False)  # noqa: FBT003
    low, high = points.min(axis=0), points.max(axis=0)
    if bounds.type == BoundsType.BOX:
        points = (low + high) / 2.0 + UNIT_CUBE * (high - low)
    return Region(ConvexShape(points), low, high, bounds.type == BoundsType.BOX)


def _parse_points(bounds: Bounds) -> FloatArray:
    is_hull, count = bounds.type == BoundsType.CONVEX_HULL, len(bounds.points)
    fits = MIN_HULL_POINTS <= count <= MAX_BOUNDS_POINTS if is_hull else count == 2  # noqa: PLR2004
    if not fits:
        wanted = f"{MIN_HULL_POINTS} to {MAX_BOUNDS_POINTS}" if is_hull else "2"
        raise BoundsRefused(
            f"{count} points do not make bounds of type {bounds.type}; use {wanted}"
        )
    points = np.array([(point.x, point.y, point.z) for point in bounds.points])
    if not np.isfinite(points).all() or np.abs(points).max() > MAX_BOUNDS_COORDINATE_M:
        raise BoundsRefused(
            f"a point is not finite or beyond {MAX_BOUNDS_COORDINATE_M:g} m; use metres"
        )
    if is_hull:
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if spread[1] <= COLLINEAR_RATIO * spread[0]:
            raise BoundsRefused("all points are on one line; use 3 that are not, or more")
    return points


@dataclass(frozen=True)
class PoseSnapshot:
    """States of all entities at one step; later steps do not change them."""

    index: EntityIndex
    states: BodyStates
    find_mesh_vertices: MeshVertices

    def links(self, model: Model, names: list[str]) -> dict[str, FloatArray]:
        """Compute the poses (n, 7) of links, by name, for entities of one model."""
        rows = [self.index.row[name] for name in names]
        joints = [self.states.joint_positions[self.index.joints_of(name)] for name in names]
        return compute_link_poses(model, self.states.base[rows, :7], np.array(joints))

    def links_in_base(self, model: Model, name: str) -> dict[str, FloatArray]:
        """Compute the poses (1, 7) of links, by name, in the root link of an entity."""
        positions = self.states.joint_positions[self.index.joints_of(name)]
        return compute_link_poses(model, IDENTITY_POSE[None], positions[None])


def find_link_poses_at_zero(model: Model) -> dict[str, FloatArray]:
    """Compute the poses (1, 7) of links, by name, in the root link with all joints at zero."""
    return compute_link_poses(model, IDENTITY_POSE[None], np.zeros((1, len(model.joints))))


def find_overlapping(
    snapshot: PoseSnapshot, entities: list[Entity], region: Region
) -> Iterator[list[str]]:
    """Name the entities that overlap a region, a few in each item.

    An entity without collision shapes counts as a point at its root link.
    """
    # By identity: comparing models by value is slow.
    groups: dict[int, list[Entity]] = {}
    for entity in entities:
        groups.setdefault(id(entity.model), []).append(entity)
    for group in groups.values():
        names = _find_near(snapshot, group, region)
        for at in range(0, len(names), ENTITIES_PER_TURN):
            yield from _find_overlapping_of_model(
                snapshot, group[0].model, names[at : at + ENTITIES_PER_TURN], region
            )


def _find_near(snapshot: PoseSnapshot, group: list[Entity], region: Region) -> list[str]:
    """Name the entities of one model whose bounding spheres overlap the box around a region."""
    radius = find_bounding_radius(group[0].model, snapshot.find_mesh_vertices)
    rows = [snapshot.index.row[entity.name] for entity in group]
    roots = snapshot.states.base[rows, :3]
    gap = np.maximum(np.maximum(region.low - roots, roots - region.high), 0.0)
    is_near = (gap * gap).sum(axis=1) <= radius * radius
    return [entity.name for entity, near in zip(group, is_near, strict=True) if near]


def _find_overlapping_of_model(
    snapshot: PoseSnapshot, model: Model, names: list[str], region: Region
) -> Iterator[list[str]]:
    poses = snapshot.links(model, names)
    shapes = list(place_collision_shapes(model, poses, snapshot.find_mesh_vertices))
    if not shapes:
        shapes = [(ConvexShape(np.zeros((1, 3))), poses[model.links[0].name])]
    is_overlapping: BoolArray = np.zeros(len(names), dtype=np.bool_)
    tested = []
    for shape, shape_poses in shapes:
        low, high = shape.bounds_at(shape_poses)
        is_near = _all_of_row((low <= region.high) & (high >= region.low))
        is_overlapping |= is_near & _is_within(region, low, high)
        tested.append((shape, shape_poses, is_near))
    yield [name for name, overlaps in zip(names, is_overlapping, strict=True) if overlaps]
    for row in np.flatnonzero(~is_overlapping):
        near = [shape.transformed_by(at[row]) for shape, at, is_near in tested if is_near[row]]
        if near:
            yield [names[row]] if any(are_overlapping(one, region.shape) for one in near) else []


def _is_within(region: Region, low: FloatArray, high: FloatArray) -> BoolArray:
    """Test quickly whether boxes are inside a region; False may also mean undecided."""
    if region.is_box:
        return _all_of_row((low >= region.low) & (high <= region.high))
    if region.shape.sphere_radius_m:
        centre = region.shape.points[0]
        far = np.maximum(np.abs(low - centre), np.abs(high - centre))
        return np.asarray((far * far).sum(axis=1) <= region.shape.sphere_radius_m**2)
    return np.zeros(len(low), dtype=np.bool_)


def _all_of_row(tests: BoolArray) -> BoolArray:
    """Reduce each row (n, 3) to whether all its values are true."""
    return np.asarray(tests.all(axis=1), dtype=np.bool_)


def make_bounds(shapes: list[tuple[ConvexShape, FloatArray]], wanted: BoundsType) -> Bounds:
    """Bound shapes, each with its pose (1, 7), by an axis-aligned box, a hull or a sphere."""
    if not shapes or wanted == BoundsType.EMPTY:
        return Bounds()
    boxes = [shape.bounds_at(pose) for shape, pose in shapes]
    low = np.min([box[0][0] for box in boxes], axis=0)
    high = np.max([box[1][0] for box in boxes], axis=0)
    if wanted == BoundsType.BOX:
        return Bounds(wanted, (_to_vector(high), _to_vector(low)))
    if wanted == BoundsType.SPHERE:
        radius = float(np.linalg.norm(high - low)) / 2.0
        return Bounds(wanted, (_to_vector((low + high) / 2.0), Vector3(radius)))
    return Bounds(wanted, _make_hull(shapes))


def _make_hull(shapes: list[tuple[ConvexShape, FloatArray]]) -> tuple[Vector3, ...]:
    points = np.vstack([shape.transformed_by(pose[0]).vertices() for shape, pose in shapes])
    return tuple(_to_vector(point) for point in find_extreme_points(points))


def _to_vector(point: FloatArray) -> Vector3:
    return Vector3(*point.tolist())
