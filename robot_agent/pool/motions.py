"""Motions of many robots, as `robot_agent.odometry` finds them: (n, 10) arrays.

Columns: position x y z and orientation x y z w of the base in the odometry frame; then, in the
base, linear x and y [m/s] and angular z [rad/s].
"""

import numpy as np

from zensim.proto.messages.drive_messages import WheelPair
from zensim.proto.messages.model_messages import IDENTITY, Origin
from zensim.proto.rotation import multiply, rotate, to_yaw
from zensim.robot_agent.pool.rows import BoolArray, FloatArray, IntArray, carried, carried_flags

MOTION_COLUMNS = 10
AT_REST = np.array([0.0, 0.0, 0.0, *IDENTITY, 0.0, 0.0, 0.0])


def world_motions(base: FloatArray, base_in_root: Origin) -> FloatArray:
    """Read true motions: poses are in the world, velocities turned by their yaw.

    Args:
        base: States of root links, (n, STATE_COLUMNS).
        base_in_root: Where the bases are fixed on the root links.
    """
    root = base[:, 3:7]
    arm = rotate(root, np.array(base_in_root.position))
    orientation = multiply(root, np.array(base_in_root.orientation))
    # A point that is off the root link moves also because the link turns.
    vx = base[:, 7] + (base[:, 11] * arm[:, 2] - base[:, 12] * arm[:, 1])
    vy = base[:, 8] + (base[:, 12] * arm[:, 0] - base[:, 10] * arm[:, 2])
    yaw = to_yaw(orientation)
    cos, sin = np.cos(yaw), np.sin(yaw)
    found = np.empty((len(base), MOTION_COLUMNS))
    found[:, :3] = base[:, :3] + arm
    found[:, 3:7] = orientation
    found[:, 7] = cos * vx + sin * vy
    found[:, 8] = cos * vy - sin * vx
    found[:, 9] = base[:, 12]
    return found


class EncoderOdometries:
    """See `zensim.robot_agent.odometry.EncoderOdometry`; a row a robot."""

    def __init__(self, pair: WheelPair, *, is_speed_unsigned: bool) -> None:
        self._pair = pair
        self._is_speed_unsigned = is_speed_unsigned
        self._has_before = np.zeros(0, dtype=np.bool_)
        self._before = np.zeros((0, 2))
        self._before_ns = np.zeros(0)
        self._pose = np.zeros((0, 3))
        self.motions = np.zeros((0, MOTION_COLUMNS))

    def recut(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self._has_before = carried_flags(self._has_before, before)
        self._before = carried(self._before, before)
        self._before_ns = carried(self._before_ns, before)
        self._pose = carried(self._pose, before)
        self.motions = carried(self.motions, before)
        self.motions[before < 0] = AT_REST

    def reset(self) -> None:
        """Start at 0 again."""
        self._has_before[:] = False
        self._pose[:] = 0.0
        self.motions[:] = AT_REST

    def update(self, wheels_rad: FloatArray, time_ns: int) -> None:
        """Take the wheel joints' positions, left and right (n, 2), at a moment of time."""
        is_next = self._has_before & (self._before_ns < time_ns)
        elapsed_s = np.where(is_next, (time_ns - self._before_ns) * 1e-9, 1.0)
        rolled_m = (wheels_rad - self._before) * (self._pair.diameter_m / 2.0)
        self._has_before[:] = True
        self._before[:] = wheels_rad
        self._before_ns[:] = time_ns
        if is_next.any():
            self._advance(is_next, rolled_m[is_next], elapsed_s[is_next])

    def _advance(self, is_next: BoolArray, rolled_m: FloatArray, elapsed_s: FloatArray) -> None:
        distance_m = (rolled_m[:, 0] + rolled_m[:, 1]) / 2.0
        turned_rad = (rolled_m[:, 1] - rolled_m[:, 0]) / self._pair.separation_m
        pose = self._pose[is_next]
        middle = pose[:, 2] + turned_rad / 2.0
        pose[:, 0] += distance_m * np.cos(middle)
        pose[:, 1] += distance_m * np.sin(middle)
        pose[:, 2] += turned_rad
        self._pose[is_next] = pose
        speed = distance_m / elapsed_s
        motions = np.zeros((len(pose), MOTION_COLUMNS))
        motions[:, :2] = pose[:, :2]
        motions[:, 5], motions[:, 6] = np.sin(pose[:, 2] / 2.0), np.cos(pose[:, 2] / 2.0)
        motions[:, 7] = np.abs(speed) if self._is_speed_unsigned else speed
        motions[:, 9] = turned_rad / elapsed_s
        self.motions[is_next] = motions
