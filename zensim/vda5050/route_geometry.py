"""Routes as lines with a speed limit at each point: curves, lengths, corners."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from zensim.proto.se3 import FloatArray, wrap_angle
from zensim.vda5050.vda_messages import CurvedEdge, Edge, Node

SPACING_M: Final = 0.2
"""Distance of the points of a curve."""
MAX_SAMPLES: Final = 200
SHARP_RAD: Final = 0.35
"""Corner at which a vehicle drives to the point before it turns."""
CORNER_M_S: Final = 0.1
"""Speed at such a corner."""
LATERAL_M_S2: Final = 0.6
"""Acceleration to the side in curves."""


@dataclass(frozen=True)
class Route:
    """A line of k points, k >= 2.

    Attributes:
        points: x, y in the map [m], (k, 2).
        s: Way from the first point to each [m], (k,).
        speed: Most at each point [m/s], so that the vehicle can brake for what follows, (k,).
        limit: Most on the segment after each point [m/s], (k,).
        sharp_s: Way to the next sharp corner after each point, or to the end [m], (k,).
        turn: Angle from the direction of travel to the heading on the segment after each point
            [rad], (k,).
        heading: The same in the map for vehicles that move sideways; NaN = not given, (k,).
        node_s: Way to each node after the first [m], (nodes,).
    """

    points: FloatArray
    s: FloatArray
    speed: FloatArray
    limit: FloatArray
    sharp_s: FloatArray
    turn: FloatArray
    heading: FloatArray
    node_s: FloatArray


def sample_nurbs(curve: CurvedEdge) -> FloatArray:
    """Find points of a curve from its start to its end, (n, 2)."""
    points = np.array([(one.x, one.y) for one in curve.control_points])
    weights = np.array([one.weight for one in curve.control_points])
    degree, count = curve.degree, len(points)
    knots = np.array(curve.knot_vector or _make_knots(count, degree))
    length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    samples = min(MAX_SAMPLES, max(2, math.ceil(length / SPACING_M) + 1))
    at = np.linspace(knots[degree], knots[count], samples)
    basis = _find_basis(at, knots, degree, count) * weights
    return np.asarray(basis @ points / basis.sum(axis=1, keepdims=True))


def _make_knots(count: int, degree: int) -> list[float]:
    inner: list[float] = np.linspace(0.0, 1.0, count - degree + 1).tolist()
    return [0.0] * degree + inner + [1.0] * degree


def _find_basis(at: FloatArray, knots: FloatArray, degree: int, count: int) -> FloatArray:
    """Find the basis functions by the recursion of Cox and de Boor, (samples, count)."""
    column = at[:, None]
    basis = ((knots[:-1] <= column) & (column < knots[1:])).astype(float)
    last = int(np.flatnonzero(knots[:-1] < knots[1:])[-1])
    basis[at >= knots[count], :] = 0.0
    basis[at >= knots[count], min(last, count - 1)] = 1.0
    for order in range(1, degree + 1):
        left, right = knots[: -order - 1], knots[order + 1 :]
        rise = _divide(column - left, knots[order:-1] - left)
        fall = _divide(right - column, right - knots[1:-order])
        basis = rise * basis[:, :-1] + fall * basis[:, 1:]
    return basis[:, :count]


def _divide(upper: FloatArray, lower: FloatArray) -> FloatArray:
    wide = np.broadcast_to(lower, upper.shape)
    return np.divide(upper, wide, out=np.zeros_like(upper), where=wide > 0.0)


def make_route(
    origin: tuple[float, float],
    nodes: Sequence[Node],
    edges: Sequence[Edge],
    *,
    max_speed: float,
    deceleration: float,
) -> Route:
    """Make the route of edges that lead to nodes with positions.

    Args:
        origin: Where it begins [m].
        nodes: End node of each edge.
        edges: At least one.
        max_speed: Of the vehicle [m/s].
        deceleration: Of the vehicle before corners [m/s^2].
    """
    points, edge_of, ends = [np.array([origin])], [0], list[int]()
    for number, (edge, node) in enumerate(zip(edges, nodes, strict=True)):
        line = _make_line(points[-1][-1], edge, node)
        points.append(line)
        edge_of += [number] * len(line)
        ends.append(len(edge_of) - 1)
    whole = np.concatenate(points)
    lengths = np.hypot(*np.diff(whole, axis=0).T)
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    owner = np.array([*edge_of[1:], edge_of[-1]])
    limits = np.array([min(max_speed, edge.speed_limit or max_speed) for edge in edges])[owner]
    corner, is_sharp = _find_corners(whole, lengths, max_speed)
    turn, heading = _find_headings(edges)
    return Route(
        points=whole,
        s=s,
        speed=_slow_down(np.minimum(corner, limits), lengths, deceleration),
        limit=limits,
        sharp_s=_find_sharp(is_sharp, s),
        turn=turn[owner],
        heading=heading[owner],
        node_s=s[ends],
    )


def _make_line(start: FloatArray, edge: Edge, node: Node) -> FloatArray:
    place = node.node_position
    end = np.array([[place.x, place.y]]) if place is not None else np.zeros((0, 2))
    if edge.trajectory is None:
        return end
    line = np.concatenate([sample_nurbs(edge.trajectory), end])
    steps = np.hypot(*np.diff(np.concatenate([start[None], line]), axis=0).T)
    kept = steps > 1e-3  # noqa: PLR2004  points on one another have no direction
    return np.asarray(line[kept] if kept.any() else line[-1:])


def _find_corners(
    points: FloatArray, lengths: FloatArray, max_speed: float
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Find the speed at each point by the turn there, and which corners are sharp."""
    speed, sharp = np.full(len(points), max_speed), np.zeros(len(points), dtype=bool)
    if len(points) > 2:  # noqa: PLR2004
        direction = np.arctan2(*np.diff(points, axis=0).T[::-1])
        bend = np.abs(wrap_angle(np.diff(direction)))
        bend[(lengths[1:] < 1e-9) | (lengths[:-1] < 1e-9)] = 0.0  # noqa: PLR2004
        radius = (lengths[1:] + lengths[:-1]) / 2.0 / np.maximum(bend, 1e-6)
        sharp[1:-1] = bend > SHARP_RAD
        curve = np.sqrt(LATERAL_M_S2 * radius)
        speed[1:-1] = np.where(sharp[1:-1], CORNER_M_S, np.minimum(curve, max_speed))
    return speed, sharp


def _find_sharp(is_sharp: npt.NDArray[np.bool_], s: FloatArray) -> FloatArray:
    """Find the way to the next sharp corner after each point, or to the end."""
    sharp = np.where(is_sharp, s, np.inf)
    sharp[-1] = s[-1]
    following = np.minimum.accumulate(sharp[::-1])[::-1]
    return np.append(following[1:], s[-1])


def _slow_down(speed: FloatArray, lengths: FloatArray, deceleration: float) -> FloatArray:
    """Lower the speed at points so that it can be reached by braking from the one before."""
    found: FloatArray = speed.copy()
    for at in range(len(found) - 2, -1, -1):
        most = math.sqrt(found[at + 1] ** 2 + 2.0 * deceleration * lengths[at])
        found[at] = min(found[at], most)
    return found


def _find_headings(edges: Sequence[Edge]) -> tuple[FloatArray, FloatArray]:
    """Find for each edge: angle to the direction of travel, and the heading in the map."""
    turn, heading = np.zeros(len(edges)), np.full(len(edges), np.nan)
    for at, edge in enumerate(edges):
        if edge.orientation is not None:
            if (edge.orientation_type or "TANGENTIAL") == "GLOBAL":
                heading[at] = edge.orientation
            else:
                turn[at] = edge.orientation
    return turn, heading
