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
"""Entities of one model that are looked at at once."""


class BoundsRefused(SimError):
    """Bounds that are none."""

    slug = "filter.bounds"


class BoundsUnsupported(BoundsRefused):
    """Bounds of a type that is not known."""

    code = ResultCode.FEATURE_UNSUPPORTED


@dataclass(frozen=True)
class Region:
    """A convex part of the world.

    Attributes:
        low: Lowest coordinates (3,).
        high: Highest coordinates (3,).
        is_box: Whether all between them is inside.
    """

    solid: ConvexShape
    low: FloatArray
    high: FloatArray
    is_box: bool


def parse_bounds(bounds: Bounds) -> Region | None:
    """Read bounds that are given in the world; None when they are empty.

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
    """Where all entities are at one step: arrays that stay as they are while the world goes on."""

    roster: EntityIndex
    reading: BodyStates
    corners: MeshVertices

    def links(self, model: Model, names: list[str]) -> dict[str, FloatArray]:
        """Find where the links of entities of one model are; poses (n, 7) by name of the link."""
        rows = [self.roster.row[name] for name in names]
        joints = [self.reading.joint_positions[self.roster.joints_of(name)] for name in names]
        return compute_link_poses(model, self.reading.base[rows, :7], np.array(joints))

    def links_in_base(self, model: Model, name: str) -> dict[str, FloatArray]:
        """Find where the links of an entity are in its root link; poses (1, 7) by name."""
        positions = self.reading.joint_positions[self.roster.joints_of(name)]
        return compute_link_poses(model, IDENTITY_POSE[None], positions[None])


def find_link_poses_at_zero(model: Model) -> dict[str, FloatArray]:
    """Find where links are in the root link, all joints at zero; poses (1, 7) by name."""
    return compute_link_poses(model, IDENTITY_POSE[None], np.zeros((1, len(model.joints))))


def find_overlapping(
    sight: PoseSnapshot, entities: list[Entity], region: Region
) -> Iterator[list[str]]:
    """Name the entities that overlap a region, a few at each turn.

    An entity that collides with nothing counts as a point, at its root.
    """
    # By identity: to compare models in full takes long.
    groups: dict[int, list[Entity]] = {}
    for entity in entities:
        groups.setdefault(id(entity.model), []).append(entity)
    for group in groups.values():
        names = _within_reach(sight, group, region)
        for at in range(0, len(names), ENTITIES_PER_TURN):
            yield from _find_overlapping_of_model(
                sight, group[0].model, names[at : at + ENTITIES_PER_TURN], region
            )


def _within_reach(sight: PoseSnapshot, group: list[Entity], region: Region) -> list[str]:
    """Name the entities of one model whose root is so near that they may reach into a region."""
    reach = find_bounding_radius(group[0].model, sight.corners)
    rows = [sight.roster.row[entity.name] for entity in group]
    roots = sight.reading.base[rows, :3]
    gap = np.maximum(np.maximum(region.low - roots, roots - region.high), 0.0)
    is_near = (gap * gap).sum(axis=1) <= reach * reach
    return [entity.name for entity, near in zip(group, is_near, strict=True) if near]


def _find_overlapping_of_model(
    sight: PoseSnapshot, model: Model, names: list[str], region: Region
) -> Iterator[list[str]]:
    poses = sight.links(model, names)
    solids = list(place_collision_shapes(model, poses, sight.corners))
    if not solids:
        solids = [(ConvexShape(np.zeros((1, 3))), poses[model.links[0].name])]
    is_in: BoolArray = np.zeros(len(names), dtype=np.bool_)
    doubts = []
    for solid, places in solids:
        low, high = solid.bounds_at(places)
        is_near = _all_of_row((low <= region.high) & (high >= region.low))
        is_in |= is_near & _is_within(region, low, high)
        doubts.append((solid, places, is_near))
    yield [name for name, known in zip(names, is_in, strict=True) if known]
    for row in np.flatnonzero(~is_in):
        near = [
            solid.transformed_by(places[row]) for solid, places, is_near in doubts if is_near[row]
        ]
        if near:
            yield [names[row]] if any(are_overlapping(one, region.solid) for one in near) else []


def _is_within(region: Region, low: FloatArray, high: FloatArray) -> BoolArray:
    """Whether boxes are wholly inside a region; False where that is not easily told."""
    if region.is_box:
        return _all_of_row((low >= region.low) & (high <= region.high))
    if region.solid.sphere_radius_m:
        centre = region.solid.points[0]
        far = np.maximum(np.abs(low - centre), np.abs(high - centre))
        return np.asarray((far * far).sum(axis=1) <= region.solid.sphere_radius_m**2)
    return np.zeros(len(low), dtype=np.bool_)


def _all_of_row(tests: BoolArray) -> BoolArray:
    """Whether all of each row (n, 3) hold."""
    return np.asarray(tests.all(axis=1), dtype=np.bool_)


def make_bounds(solids: list[tuple[ConvexShape, FloatArray]], wanted: BoundsType) -> Bounds:
    """Wrap solids, each with its pose (1, 7), in a box along the axes, a hull or a sphere."""
    if not solids or wanted == BoundsType.EMPTY:
        return Bounds()
    reaches = [solid.bounds_at(pose) for solid, pose in solids]
    low = np.min([reach[0][0] for reach in reaches], axis=0)
    high = np.max([reach[1][0] for reach in reaches], axis=0)
    if wanted == BoundsType.BOX:
        return Bounds(wanted, (_to_vector(high), _to_vector(low)))
    if wanted == BoundsType.SPHERE:
        radius = float(np.linalg.norm(high - low)) / 2.0
        return Bounds(wanted, (_to_vector((low + high) / 2.0), Vector3(radius)))
    return Bounds(wanted, _make_hull(solids))


def _make_hull(solids: list[tuple[ConvexShape, FloatArray]]) -> tuple[Vector3, ...]:
    points = np.vstack([solid.transformed_by(pose[0]).vertices() for solid, pose in solids])
    return tuple(_to_vector(point) for point in find_extreme_points(points))


def _to_vector(point: FloatArray) -> Vector3:
    return Vector3(*point.tolist())
