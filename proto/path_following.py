"""Controller that drives a robot along points; no clock, no network."""

import math
from collections.abc import Iterable
from typing import Final

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

    def __init__(self, points: Iterable[tuple[float, float]], speed: float) -> None:
        """Start before the first point.

        Args:
            points: x and y in the world [m].
            speed: Most [m/s]; less while the heading is wrong, and near the last point.
        """
        self._left = [(float(x), float(y)) for x, y in points]
        self._speed = speed

    def control(self, x: float, y: float, yaw: float) -> tuple[float, float] | None:
        """Find forward [m/s] and angular velocity [rad/s] at a pose; None = over.

        Args:
            x: In the world [m].
            y: In the world [m].
            yaw: Heading [rad].
        """
        left = self._left
        while left and math.hypot(left[0][0] - x, left[0][1] - y) < REACHED_M:
            left.pop(0)
        if not left:
            return None
        to_x, to_y = left[0][0] - x, left[0][1] - y
        error = _wrap(math.atan2(to_y, to_x) - yaw)
        # A last point is approached ever more slowly, so that the robot does not pass it.
        slow = math.hypot(to_x, to_y) / SLOW_DOWN_S
        most = min(self._speed, slow) if len(left) == 1 else self._speed
        turn = max(-MAX_TURN, min(MAX_TURN, TURN_GAIN * error))
        return max(0.0, most * math.cos(error)), turn


def _wrap(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))
