"""Controller that drives a robot along points; no clock, no network."""

import math
from typing import Final

from zensim.api.entity_values import RobotPose
from zensim.api.world_state import FloatArray

REACHED_M: Final = 0.05
"""Distance from a point at which it counts as reached."""
TURN_GAIN: Final = 2.0
"""Angular velocity per heading error [1/s]."""
MAX_TURN: Final = 1.5
"""[rad/s]."""
SLOW_DOWN_S: Final = 1.0
"""Time constant of the approach to the last point."""


class PathController:
    """Drives to each point in turn."""

    def __init__(self, points: FloatArray, speed: float) -> None:
        """Start before the first point.

        Args:
            points: x and y in the world [m], (n, 2).
            speed: Most [m/s]; less while the heading is wrong, and near the last point.
        """
        self._left = [(float(x), float(y)) for x, y in points]
        self._speed = speed

    def control(self, pose: RobotPose) -> tuple[float, float] | None:
        """Find forward and angular velocity at a pose; None = over."""
        left = self._left
        while left and pose.distance_to(*left[0]) < REACHED_M:
            left.pop(0)
        if not left:
            return None
        x, y = left[0]
        distance = pose.distance_to(x, y)
        error = _wrap(math.atan2(y - pose.y, x - pose.x) - pose.yaw)
        # A last point is approached ever more slowly, so that the robot does not pass it.
        most = min(self._speed, distance / SLOW_DOWN_S) if len(left) == 1 else self._speed
        turn = max(-MAX_TURN, min(MAX_TURN, TURN_GAIN * error))
        return max(0.0, most * math.cos(error)), turn


def _wrap(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))
