"""Law that drives robots to points, on arrays, and its use for one robot; no clock, no network."""

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from zensim.proto.se3 import FloatArray, wrap_angle

REACHED_M: Final = 0.05
"""Distance from a point at which it counts as reached."""
TURN_GAIN: Final = 2.0
"""Angular velocity per heading error [1/s]."""
MAX_TURN: Final = 1.5
"""Greatest angular velocity of `steer` [rad/s]."""
SLOW_DOWN_S: Final = 1.0
"""Time constant of the approach to a point at which a robot stops."""


def find_turn(error: FloatArray, most: float | FloatArray = MAX_TURN) -> FloatArray:
    """Find angular velocities [rad/s], up to the most, that undo errors of headings [rad]."""
    return np.asarray(np.clip(TURN_GAIN * error, -most, most))


def steer(headings: FloatArray, offsets: FloatArray, speeds: FloatArray) -> FloatArray:
    """Command robots to points: turn towards them, ahead as far as they face them.

    Args:
        headings: [rad], (m,).
        offsets: To the points, in the world [m], (m, 2).
        speeds: Largest [m/s], (m,); a robot of speed 0 does not turn.

    Returns:
        Forward [m/s] and angular velocity [rad/s], (m, 2).
    """
    error = wrap_angle(np.arctan2(offsets[:, 1], offsets[:, 0]) - headings)
    ahead = speeds * np.maximum(0.0, np.cos(error))
    return np.column_stack([ahead, np.where(speeds > 0.0, find_turn(error), 0.0)])


class PathController:
    """Drives to each point in turn."""

    def __init__(self, points: Iterable[tuple[float, float]], speed: float) -> None:
        """Start before the first point.

        Args:
            points: x and y in the world [m].
            speed: Most [m/s], > 0; less while the heading is wrong, and near the last point.
        """
        self._left = [(float(x), float(y)) for x, y in points]
        self._speed = speed

    def aim(self, x: float, y: float) -> tuple[float, float, float] | None:
        """Find the offset to the next point and the greatest speed there, for `steer`.

        Args:
            x: In the world [m].
            y: In the world [m].

        Returns:
            Offset x and y in the world [m], and speed [m/s]; None = the path is over.
        """
        left = self._left
        while left and math.hypot(left[0][0] - x, left[0][1] - y) < REACHED_M:
            left.pop(0)
        if not left:
            return None
        to_x, to_y = left[0][0] - x, left[0][1] - y
        # A last point is approached ever more slowly, so that the robot does not pass it.
        slow = math.hypot(to_x, to_y) / SLOW_DOWN_S
        return to_x, to_y, min(self._speed, slow) if len(left) == 1 else self._speed

    def control(self, x: float, y: float, yaw: float) -> tuple[float, float] | None:
        """Find forward [m/s] and angular velocity [rad/s] at a pose [m, rad]; None = over."""
        if (aimed := self.aim(x, y)) is None:
            return None
        forward, turn = steer_each(np.array([yaw]), [aimed])[0]
        return float(forward), float(turn)


def steer_each(headings: FloatArray, aims: Sequence[tuple[float, float, float]]) -> FloatArray:
    """Steer robots with headings [rad] (m,) to what `PathController.aim` found; (m, 2)."""
    table = np.array(aims)
    return steer(headings, table[:, :2], table[:, 2])
