"""Controller that drives a robot along points; no clock, no network."""

import math
from collections.abc import Callable
from typing import Final

from zensim.api.entity_values import RobotPose
from zensim.api.world_state import FloatArray

PathController = Callable[[RobotPose, float], "tuple[float, float] | None"]
"""Takes the pose and the control period [s]; returns forward and angular velocity; None = over."""
REACHED_M: Final = 0.05
"""Distance from a point at which it counts as reached."""
TURN_GAIN: Final = 2.0
"""Angular velocity per heading error [1/s]."""
MAX_TURN: Final = 1.5
"""[rad/s]."""
SLOW_DOWN_S: Final = 1.0
"""Time constant of the approach to the last point."""


def make_path_controller(points: FloatArray, speed: float) -> PathController:
    """Make a controller that drives to each point in turn.

    Args:
        points: x and y in the world [m], (n, 2).
        speed: Most [m/s]; less while the heading is wrong, and near the last point.
    """
    left = [(float(x), float(y)) for x, y in points]

    def control(pose: RobotPose, _period: float) -> tuple[float, float] | None:
        while left and pose.distance_to(*left[0]) < REACHED_M:
            left.pop(0)
        if not left:
            return None
        x, y = left[0]
        distance = pose.distance_to(x, y)
        error = _wrap(math.atan2(y - pose.y, x - pose.x) - pose.yaw)
        # A last point is approached ever more slowly, so that the robot does not pass it.
        most = min(speed, distance / SLOW_DOWN_S) if len(left) == 1 else speed
        turn = max(-MAX_TURN, min(MAX_TURN, TURN_GAIN * error))
        return max(0.0, most * math.cos(error)), turn

    return control


def _wrap(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))
