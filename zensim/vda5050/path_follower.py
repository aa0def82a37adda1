"""Path following of a whole fleet in arrays; no network, no clock."""

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from zensim.proto.path_following import find_turn
from zensim.proto.se3 import FloatArray, wrap_angle
from zensim.vda5050.route_geometry import Route

BoolArray = npt.NDArray[np.bool_]
REACHED_M: Final = 0.02
"""Distance along the route at which a stop counts as reached."""
CORNER_REACHED_M: Final = 0.05
ALIGNED_RAD: Final = 0.05
LOOK_AHEAD_S: Final = 0.6
MIN_LOOK_AHEAD_M, MAX_LOOK_AHEAD_M = 0.3, 1.5
NEAR_POINTS: Final = 8
"""Points that are looked at beyond the present one."""
ADVANCES: Final = 3
"""Points that a vehicle can pass in one step."""
PIVOT_FROM_RAD, PIVOT_TO_RAD = 0.6, 0.1
"""Heading errors at which a turn on the spot begins and ends."""
REVERSE_RAD: Final = 2.0
"""Angle to the direction of travel beyond which a vehicle drives backward."""
BRAKING: Final = 0.7
"""Share of the deceleration that is planned: commands take effect later."""
APPROACH_HZ: Final = 3.0
"""Speed per distance close to a stop [1/s]."""
YAW_RATE, ACKERMANN, TRICYCLE = 0, 1, 2
"""What the third number of a twist is: yaw rate, or a steering angle."""


@dataclass(frozen=True)
class VehicleLimits:
    """What a vehicle can do.

    Attributes:
        speed: [m/s].
        turn: [rad/s].
        acceleration: [m/s^2].
        deceleration: [m/s^2].
        curvature: Most [1/m]; infinite = it turns on the spot.
        is_sideways: Whether it moves in any direction.
        steering: `YAW_RATE`, `ACKERMANN` or `TRICYCLE`.
        wheelbase: Distance of steered wheels from the base [m]; of the latter two.
    """

    speed: float = 1.0
    turn: float = 1.0
    acceleration: float = 0.5
    deceleration: float = 0.5
    curvature: float = math.inf
    is_sideways: bool = False
    steering: int = YAW_RATE
    wheelbase: float = 1.0


class Progress(NamedTuple):
    """Where vehicles are on their routes, (n,) each.

    Attributes:
        s: Way from the start of the route [m].
        off: Distance from the route [m].
        passed: Whether the next node is passed without a stop.
        arrived: Whether the next stop is reached, with its heading.
    """

    s: FloatArray
    off: FloatArray
    passed: BoolArray
    arrived: BoolArray


def _zeros(columns: int = 0) -> FloatArray:
    return np.zeros((0, columns)) if columns else np.zeros(0)


@dataclass
class RouteTable:
    """Routes and motion of all vehicles, a row each; a row without a route stands."""

    x: FloatArray = field(default_factory=lambda: _zeros(2))
    y: FloatArray = field(default_factory=lambda: _zeros(2))
    s: FloatArray = field(default_factory=lambda: _zeros(2))
    speed: FloatArray = field(default_factory=lambda: _zeros(2))
    limit: FloatArray = field(default_factory=lambda: _zeros(2))
    sharp_s: FloatArray = field(default_factory=lambda: _zeros(2))
    turn: FloatArray = field(default_factory=lambda: _zeros(2))
    heading: FloatArray = field(default_factory=lambda: _zeros(2))
    last: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Number of the last point; 0 = no route."""
    cursor: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Point before the vehicle."""
    stop_s: FloatArray = field(default_factory=_zeros)
    node_s: FloatArray = field(default_factory=_zeros)
    stop_heading: FloatArray = field(default_factory=_zeros)
    """Heading at the stop [rad]; NaN = any."""
    aligned: FloatArray = field(default_factory=_zeros)
    """Tolerance of it [rad]."""
    driven: FloatArray = field(default_factory=_zeros)
    """Speed of the last command [m/s]."""
    is_pivoting: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    limits: FloatArray = field(default_factory=lambda: _zeros(8))
    """Fields of `VehicleLimits`."""
    nodes: dict[int, FloatArray] = field(default_factory=dict)
    """Way to each node of the route [m], by row."""

    def resize(self, rows: int) -> None:
        """Add rows."""
        for name, array in vars(self).items():
            if name == "nodes":
                continue
            more = np.zeros((rows - len(array), *array.shape[1:]), dtype=array.dtype)
            setattr(self, name, np.concatenate([array, more]))

    def set_limits(self, row: int, limits: VehicleLimits) -> None:
        """Set what a vehicle can do."""
        self.limits[row] = list(vars(limits).values())

    def set_route(self, row: int, route: Route, position: tuple[float, float]) -> None:
        """Replace the route; the vehicle is at a position [m] before the first node."""
        count = len(route.s)
        self._widen(count)
        for array, values in (
            (self.x, route.points[:, 0]),
            (self.y, route.points[:, 1]),
            (self.s, route.s),
            (self.speed, route.speed),
            (self.limit, route.limit),
            (self.sharp_s, route.sharp_s),
            (self.turn, route.turn),
            (self.heading, route.heading),
        ):
            array[row, :count] = values
            array[row, count:] = values[-1]
        first = route.points[: max(1, int((route.s < route.node_s[0]).sum()))]
        distance = np.hypot(first[:, 0] - position[0], first[:, 1] - position[1])
        self.cursor[row] = max(0, int(distance.argmin()) - 1)
        self.last[row] = count - 1
        self.nodes[row] = route.node_s

    def clear_route(self, row: int) -> None:
        """Remove the route; the vehicle stops."""
        self.last[row] = self.cursor[row] = 0
        self.nodes.pop(row, None)

    def _widen(self, points: int) -> None:
        width = self.x.shape[1]
        if points > width:
            for name in ("x", "y", "s", "speed", "limit", "sharp_s", "turn", "heading"):
                old = getattr(self, name)
                wide = np.zeros((len(old), max(points, 2 * width)))
                wide[:, :width] = old
                wide[:, width:] = old[:, -1:]
                setattr(self, name, wide)


def follow(
    table: RouteTable, poses: FloatArray, dt_s: float, gate: FloatArray
) -> tuple[FloatArray, Progress]:
    """Find the twist of each vehicle, and where it is on its route.

    Args:
        table: Routes; cursor, speed and turning are updated.
        poses: x, y [m] and heading [rad] in the map, (n, 3).
        dt_s: Since the last call.
        gate: Most speed now [m/s]; 0 = stop at once, also turning, (n,).

    Returns:
        Twists as `cmd_vel` has them: forward, left [m/s], turn [rad/s] or angle [rad], (n, 3).
    """
    rows = np.arange(len(poses))
    t, length, off = _advance(table, rows, poses)
    c = table.cursor
    s = table.s[rows, c] + np.clip(t, 0.0, 1.0) * length
    left = np.maximum(table.stop_s - s, 0.0)
    alpha, distance = _aim(table, rows, poses, s)
    has_route = table.last > 0
    at_stop = has_route & (left < REACHED_M)
    missing = wrap_angle(table.stop_heading - poses[:, 2])
    can_turn = np.isinf(table.limits[:, 4])
    aligned = ~can_turn | np.isnan(missing) | (np.abs(missing) < table.aligned)
    speed = _limit_speed(table, rows, s, left, dt_s)
    moves = has_route & ~at_stop
    speed = np.where(moves, np.minimum(speed, gate), 0.0)
    turn_at_stop = np.where(at_stop & ~aligned, np.nan_to_num(missing), 0.0)
    twists = _steer(table, speed, alpha, distance, poses[:, 2])
    twists[~moves] = 0.0
    twists[:, 2] += find_turn(turn_at_stop, table.limits[:, 1])
    twists[gate <= 0.0] = 0.0
    table.driven = np.hypot(twists[:, 0], twists[:, 1])
    is_on_way = table.node_s < table.stop_s - REACHED_M
    passed = has_route & is_on_way & (s >= table.node_s - CORNER_REACHED_M)
    return twists, Progress(s, off, passed, at_stop & aligned)


def _advance(
    table: RouteTable, rows: npt.NDArray[np.intp], poses: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Move the cursor to the segment of the vehicle; return share, length and distance of it."""
    for _ in range(ADVANCES):
        c = table.cursor
        after = np.minimum(c + 1, table.x.shape[1] - 1)
        ax, ay = table.x[rows, c], table.y[rows, c]
        dx, dy = table.x[rows, after] - ax, table.y[rows, after] - ay
        length = np.hypot(dx, dy)
        px, py = poses[:, 0] - ax, poses[:, 1] - ay
        safe = np.maximum(length, 1e-9)
        t = np.where(length > 0.0, (px * dx + py * dy) / safe**2, 1.0)
        end = np.hypot(px - dx, py - dy)
        goes = (t >= 1.0) | (end < CORNER_REACHED_M)
        goes &= (c + 1 < table.last) & (table.s[rows, after] < table.stop_s - 1e-6)
        if not goes.any():
            break
        table.cursor = np.where(goes, c + 1, c)
    aside = np.abs(px * dy - py * dx) / safe
    off = np.where(t < 0.0, np.hypot(px, py), np.where(t > 1.0, end, aside))
    return t, length, np.where(length > 0.0, off, np.hypot(px, py))


def _aim(
    table: RouteTable, rows: npt.NDArray[np.intp], poses: FloatArray, s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Find direction in the map and distance of a point ahead on the route.

    No point is beyond the next sharp corner or stop: there the segment is drawn out instead.
    """
    c, width = table.cursor, table.x.shape[1]
    ahead = np.clip(LOOK_AHEAD_S * table.driven, MIN_LOOK_AHEAD_M, MAX_LOOK_AHEAD_M)
    to_s = np.minimum(np.minimum(s + ahead, table.sharp_s[rows, c]), table.stop_s)
    near = np.minimum(c[:, None] + 1 + np.arange(NEAR_POINTS), width - 1)
    beyond = (table.s[rows[:, None], near] < to_s[:, None] - 1e-9).sum(axis=1)
    a = np.minimum(c + beyond, np.maximum(table.last - 1, 0))
    b = np.minimum(a + 1, width - 1)
    dx, dy = table.x[rows, b] - table.x[rows, a], table.y[rows, b] - table.y[rows, a]
    length = np.maximum(np.hypot(dx, dy), 1e-9)
    way = np.minimum(to_s - table.s[rows, a], length) + np.maximum(s + ahead - to_s, 0.0)
    x = table.x[rows, a] + dx / length * way - poses[:, 0]
    y = table.y[rows, a] + dy / length * way - poses[:, 1]
    return np.arctan2(y, x), np.maximum(np.hypot(x, y), 1e-3)


def _limit_speed(
    table: RouteTable, rows: npt.NDArray[np.intp], s: FloatArray, left: FloatArray, dt_s: float
) -> FloatArray:
    c = table.cursor
    after = np.minimum(c + 1, table.x.shape[1] - 1)
    slowing = BRAKING * table.limits[:, 3]
    to_next = np.maximum(table.s[rows, after] - s, 0.0)
    at_next = np.sqrt(table.speed[rows, after] ** 2 + 2.0 * slowing * to_next)
    here = table.limit[rows, c]
    at_stop = np.minimum(np.sqrt(2.0 * slowing * left), APPROACH_HZ * left + 0.01)
    faster = table.driven + table.limits[:, 2] * dt_s
    most = np.minimum(table.limits[:, 0], np.minimum(here, np.minimum(at_next, at_stop)))
    return np.asarray(np.minimum(most, faster))


def _steer(
    table: RouteTable, speed: FloatArray, toward: FloatArray, distance: FloatArray, yaw: FloatArray
) -> FloatArray:
    """Find twists of a speed toward a point, by pure pursuit."""
    c = table.cursor
    rows = np.arange(len(c))
    most, curvature = table.limits[:, 1], table.limits[:, 4]
    turn, heading = table.turn[rows, c], table.heading[rows, c]
    is_sideways = table.limits[:, 5] > 0.0
    is_reverse = ~is_sideways & (np.abs(turn) > REVERSE_RAD)
    alpha = wrap_angle(toward - yaw - np.where(is_reverse, math.pi, 0.0))
    starts = np.abs(alpha) > np.where(table.is_pivoting, PIVOT_TO_RAD, PIVOT_FROM_RAD)
    table.is_pivoting = starts & np.isinf(curvature) & ~is_sideways
    bend = np.clip(2.0 * np.sin(alpha) / distance, -curvature, curvature)
    slow = np.minimum(speed * np.maximum(np.cos(alpha), 0.2), most / np.maximum(np.abs(bend), 1e-9))
    v = np.where(table.is_pivoting, 0.0, slow)
    w = np.where(table.is_pivoting, find_turn(alpha, most), v * bend)
    twists = np.stack([np.where(is_reverse, -v, v), np.zeros_like(v), w], axis=1)
    _set_steering(table, twists, np.where(is_reverse, -bend, bend))
    wanted = np.where(np.isnan(heading), toward + turn, heading)
    ahead = toward - yaw
    spin = find_turn(wrap_angle(wanted - yaw), most)
    sideways = np.stack([speed * np.cos(ahead), speed * np.sin(ahead), spin], axis=1)
    return np.asarray(np.where(is_sideways[:, None], sideways, twists))


def _set_steering(table: RouteTable, twists: FloatArray, bend: FloatArray) -> None:
    """Replace the yaw rate by a steering angle where drives take one."""
    kind, wheelbase = table.limits[:, 6], table.limits[:, 7]
    angle = np.arctan(bend * wheelbase)
    forward = np.where(twists[:, 0] < 0.0, -1.0, 1.0)
    twists[:, 2] = np.where(kind == ACKERMANN, angle * forward, twists[:, 2])
    twists[:, 2] = np.where(kind == TRICYCLE, angle, twists[:, 2])
    twists[:, 0] = np.where(kind == TRICYCLE, twists[:, 0] / np.cos(angle), twists[:, 0])
