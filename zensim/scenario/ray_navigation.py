"""Driving to points around what rays hit, as a lidar at 10 Hz sees it; on arrays, no network."""

from collections.abc import Callable, Sequence

import numpy as np

from zensim.proto.path_following import find_turn
from zensim.proto.se3 import FloatArray, wrap_angle

CastRays = Callable[[FloatArray, FloatArray, float], FloatArray]
"""Ranges (k,) [m] of rays from origins (k, 3) along directions (k, 3) up to a range."""
PERIOD_S = 0.1
ANGLES = np.radians(np.arange(-120.0, 121.0, 8.0))
"""Angles of the rays of a robot, about its heading [rad]."""
RANGE_MAX = 1.6
RAY_HEIGHT = 0.1
"""Height above the floor [m]."""
CORRIDOR = 0.34
"""Half of the width that a robot needs [m]."""
BODY = 0.27
"""Rays begin at this distance from the robot's origin, outside of it [m]."""
STOP_AT = 0.5
"""Distance of the nearest obstacle ahead at which a robot stops [m]."""
FREE_FROM = 0.8
"""Distance that makes a direction worth turning to [m]."""
MAX_TURN = 1.2


def find_ranges(cast: CastRays, poses: FloatArray) -> FloatArray:
    """Measure around robots at poses x, y, heading (n, 3): ranges (n, rays) from their origins."""
    headings = poses[:, 2:] + ANGLES
    along = np.stack([np.cos(headings), np.sin(headings), np.zeros_like(headings)], axis=2)
    starts = np.zeros_like(along)
    starts[:, :, :2] = poses[:, None, :2] + BODY * along[:, :, :2]
    starts[:, :, 2] = RAY_HEIGHT
    found = cast(starts.reshape(-1, 3), along.reshape(-1, 3), RANGE_MAX)
    return np.asarray(found.reshape(len(poses), -1) + BODY)


def find_clearances(ranges: FloatArray) -> FloatArray:
    """Find how far a robot could drive in the direction of each ray [m], (n, rays)."""
    between = ANGLES[:, None] - ANGLES[None, :]
    finite = np.where(np.isfinite(ranges), ranges, 1e6)
    ahead = finite[:, None, :] * np.cos(between)
    aside = np.abs(finite[:, None, :] * np.sin(between))
    is_in_the_way = (aside < CORRIDOR) & (ahead > 0.0)
    return np.asarray(np.where(is_in_the_way, ahead, np.inf).min(axis=2))


def steer_around(
    ranges: FloatArray, bearings: FloatArray, speeds: Sequence[float] | FloatArray
) -> FloatArray:
    """Command robots towards bearings, by the free direction that is nearest to each.

    Args:
        ranges: Of `find_ranges`, (n, rays).
        bearings: Of the goals, about the headings [rad], (n,).
        speeds: Largest [m/s], (n,).

    Returns:
        Speed [m/s] and turn [rad/s], (n, 2).
    """
    clear = find_clearances(ranges)
    wanted = np.clip(bearings, ANGLES[0], ANGLES[-1])
    cost = np.abs(ANGLES - wanted[:, None]) + np.where(clear < FREE_FROM, 10.0 - clear, 0.0)
    chosen = ANGLES[np.argmin(cost, axis=1)]
    straight = clear[:, len(ANGLES) // 2]
    # Where the goal itself is in sight, its exact bearing is better than a ray's.
    is_near = np.abs(chosen - wanted) < ANGLES[1] - ANGLES[0]
    turn_to = np.where(is_near, bearings, chosen)
    room = np.clip(straight - STOP_AT, 0.0, None)
    ahead = np.minimum(speeds, room) * np.maximum(0.0, np.cos(turn_to))
    return np.column_stack([ahead, find_turn(turn_to, MAX_TURN)])


def find_bearings(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Find the bearings of points (n, 2) about the headings of robots [rad], (n,)."""
    offset = points - poses[:, :2]
    return wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - poses[:, 2])
