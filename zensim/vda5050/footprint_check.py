"""Free way of vehicles before what is in the world, by boxes; arrays over all pairs."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.entity_messages import Bounds, BoundsType
from zensim.proto.se3 import FloatArray

MARGIN_M: Final = 0.05
"""Added on each side of a vehicle."""
CLEARANCE_M: Final = 0.3
"""Distance from an obstacle at which a vehicle stops."""
LARGE_M: Final = 2.0
"""Half diagonal of boxes that are compared with every vehicle."""
LOW_M: Final = 0.03
"""Height of what is driven over."""


class Box(NamedTuple):
    """Box of an entity in the frame of its base [m]."""

    x: float = 0.0
    y: float = 0.0
    half_length: float = 0.25
    half_width: float = 0.25
    bottom: float = 0.0
    top: float = 0.5


def make_box(bounds: Bounds) -> Box | None:
    """Make the box of bounds; None if they are unbounded, as a plane."""
    points = bounds.points
    if bounds.type == BoundsType.EMPTY or not points:
        return None
    if bounds.type == BoundsType.SPHERE:
        centre, radius = points[0], points[1].x
        return Box(centre.x, centre.y, radius, radius, centre.z - radius, centre.z + radius)
    x, y, z = ([getattr(one, axis) for one in points] for axis in "xyz")
    halves = (max(x) - min(x)) / 2.0, (max(y) - min(y)) / 2.0
    return Box(min(x) + halves[0], min(y) + halves[1], *halves, min(z), max(z))


def find_free_way(
    places: FloatArray, boxes: FloatArray, movers: npt.NDArray[np.intp], travel: FloatArray
) -> FloatArray:
    """Find how far each of some entities can move before its box meets that of another.

    Args:
        places: x, y, z [m] and heading [rad] of all entities, (m, 4).
        boxes: Fields of `Box` of each; NaN = it has none, (m, 6).
        movers: Rows of the entities that move, (k,).
        travel: Direction in the map [rad], and how far to look [m], (k, 2).

    Returns:
        Way [m], infinite without an obstacle, (k,).
    """
    free = np.full(len(movers), np.inf)
    first, second = _list_pairs(places, boxes, movers, travel[:, 1])
    at = movers[first]
    is_there = (at != second) & ~np.isnan(boxes[second, 0])
    bottom = places[second, 2] + boxes[second, 4] - places[at, 2]
    top = places[second, 2] + boxes[second, 5] - places[at, 2]
    is_there &= (top > LOW_M) & (bottom < boxes[at, 5])
    first, second, at = first[is_there], second[is_there], at[is_there]
    meets, gap = _compare(places, boxes, at, second, travel[first])
    np.minimum.at(free, first[meets], gap[meets])
    return free


def _list_pairs(
    places: FloatArray, boxes: FloatArray, movers: npt.NDArray[np.intp], reach: FloatArray
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """List pairs of a mover and an entity that may be near: by x, and all large ones."""
    radius = np.nan_to_num(np.hypot(boxes[:, 2], boxes[:, 3]) + np.hypot(boxes[:, 0], boxes[:, 1]))
    large = np.flatnonzero(radius > LARGE_M)
    small = np.flatnonzero(radius <= LARGE_M)
    order = small[np.argsort(places[small, 0], kind="stable")]
    wide = reach + radius[movers] + LARGE_M
    x, sorted_x = places[movers, 0], places[order, 0]
    start = np.searchsorted(sorted_x, x - wide)
    count = np.searchsorted(sorted_x, x + wide) - start
    first = np.repeat(np.arange(len(movers)), count)
    within = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
    second = order[np.repeat(start, count) + within]
    is_near = np.abs(places[second, 1] - places[movers[first], 1]) < wide[first]
    all_first = np.repeat(np.arange(len(movers)), len(large))
    all_second = np.tile(large, len(movers))
    return (
        np.concatenate([first[is_near], all_first]),
        np.concatenate([second[is_near], all_second]),
    )


def _compare(
    places: FloatArray,
    boxes: FloatArray,
    at: npt.NDArray[np.intp],
    other: npt.NDArray[np.intp],
    travel: FloatArray,
) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    """Compare the lane before each vehicle with a box, on the axes of both."""
    direction, reach = travel[:, 0], travel[:, 1]
    aside = places[at, 3] - direction
    half = _project(boxes[at, 2], boxes[at, 3], aside)
    width = _project(boxes[at, 3], boxes[at, 2], aside) + MARGIN_M
    ox, oy = _rotate(boxes[other, 0], boxes[other, 1], places[other, 3])
    ax, ay = _rotate(boxes[at, 0], boxes[at, 1], places[at, 3])
    dx, dy = places[other, 0] + ox - places[at, 0] - ax, places[other, 1] + oy - places[at, 1] - ay
    x, y = _rotate(dx, dy, -direction)
    turn = places[other, 3] - direction
    long, across = boxes[other, 2], boxes[other, 3]
    far, wide = _project(long, across, turn), _project(across, long, turn)
    meets = (np.abs(y) < wide + width) & (x + far > half) & (x - far < half + reach)
    # The lane in the frame of the box: its middle, and its extent on both axes.
    mx, my = _rotate(x - half - reach / 2.0, y, -turn)
    meets &= np.abs(mx) < long + _project(reach / 2.0, width, turn)
    meets &= np.abs(my) < across + _project(width, reach / 2.0, turn)
    inside = (np.abs(x) < far - half) & (np.abs(y) < wide - width) & (far > LARGE_M)
    return meets & ~inside, np.maximum(x - far - half, 0.0)


def _project(along: FloatArray, across: FloatArray, angle: FloatArray) -> FloatArray:
    return np.asarray(along * np.abs(np.cos(angle)) + across * np.abs(np.sin(angle)))


def _rotate(x: FloatArray, y: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    cosine, sine = np.cos(angle), np.sin(angle)
    return x * cosine - y * sine, x * sine + y * cosine
