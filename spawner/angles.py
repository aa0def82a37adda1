"""Angles of a rotation, as people write them."""

import math

from zensim.proto.messages.standard_messages import Quaternion


def roll_pitch_yaw(turn: Quaternion) -> tuple[float, float, float]:
    """Find the fixed-axis angles [rad] of a rotation; roll is 0 where pitch is a quarter turn."""
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    sine = 2.0 * (w * y - z * x) / max(x * x + y * y + z * z + w * w, 1e-300)
    if abs(sine) >= 1.0 - 1e-12:
        return 0.0, math.copysign(math.pi / 2.0, sine), 2.0 * math.atan2(z, w)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, math.asin(sine), yaw_of(turn)


def yaw_of(turn: Quaternion) -> float:
    """Find the angle about z [rad]."""
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
