"""Parse the bounds of requests, and compute the bounds of entities."""

import numpy as np

from zensim.proto.messages.entity_messages import Bounds, BoundsType
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import Vector3
from zensim.proto.se3 import FloatArray
from zensim.sim_server.errors import SimError
from zensim.sim_server.scene.convex_shapes import UNIT_CUBE, ConvexShape, find_extreme_points
from zensim.sim_server.scene.scene import Region, make_region

MAX_BOUNDS_POINTS = 1000
MAX_BOUNDS_COORDINATE_M = 1e6
MIN_HULL_POINTS = 3
COLLINEAR_RATIO = 1e-9
"""Second singular value over the first, below which points are on one line."""


class BoundsRefused(SimError):
    """Bounds that are not valid."""

    slug = "filter.bounds"


class BoundsUnsupported(BoundsRefused):
    """Bounds of a type that is not known."""

    code = ResultCode.FEATURE_UNSUPPORTED


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
        return make_region(shape)
    low, high = points.min(axis=0), points.max(axis=0)
    if bounds.type == BoundsType.BOX:
        points = (low + high) / 2.0 + UNIT_CUBE * (high - low)
    return Region(ConvexShape(points), low, high, is_box=bounds.type == BoundsType.BOX)


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
