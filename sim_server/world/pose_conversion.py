"""Checked conversion of poses and twists between messages and state rows (13,) in world."""

import math

import numpy as np

from zensim.proto.messages.standard_messages import Point, Pose, Quaternion, Twist, Vector3
from zensim.proto.se3 import rotate
from zensim.sim_server.errors import PoseRefused
from zensim.sim_server.physics.engine import FloatArray

MAX_POSITION_M = 1e5
MAX_SPEED = 1e4
MIN_QUATERNION_NORM, MAX_QUATERNION_NORM = 1e-6, 1e6
"""Accepted norms; outside of them the direction is lost to rounding."""
WORLD_FRAMES = frozenset({"", "world", "map", "/map", "/world"})


def is_zero_quaternion(orientation: Quaternion) -> bool:
    """Whether all four numbers are 0: the message default, sent by clients that do not set it."""
    return orientation.x == orientation.y == orientation.z == orientation.w == 0.0


def pose_to_row(pose: Pose) -> FloatArray:
    """Convert a pose to (7,): position, unit quaternion; an all-zero quaternion becomes identity.

    Raises:
        PoseRefused: A number is not finite, the position is out of range, or the quaternion has
            no direction.
    """
    p, q = pose.position, pose.orientation
    row = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    if not np.isfinite(row).all():
        raise PoseRefused(
            "pose has a number that is not finite; use finite metres and a quaternion"
        )
    if np.abs(row[:3]).max() > MAX_POSITION_M:
        raise PoseRefused(
            f"position ({p.x:g}, {p.y:g}, {p.z:g}) is out of range; "
            f"use at most {MAX_POSITION_M:g} m from the origin"
        )
    if is_zero_quaternion(q):
        row[6] = 1.0
    length = math.hypot(*row[3:])
    if not MIN_QUATERNION_NORM < length < MAX_QUATERNION_NORM:
        raise PoseRefused(f"quaternion of length {length:g} has no direction; use length 1")
    row[3:] /= length
    return row


def twist_to_row(twist: Twist) -> FloatArray:
    """Convert a twist to (6,): linear, angular.

    Raises:
        PoseRefused: A number is not finite or out of range.
    """
    v, w = twist.linear, twist.angular
    row = np.array([v.x, v.y, v.z, w.x, w.y, w.z])
    if not np.isfinite(row).all() or np.abs(row).max() > MAX_SPEED:
        raise PoseRefused(
            f"twist has a number that is not finite or above {MAX_SPEED:g}; use m/s and rad/s"
        )
    return row


def rotate_twist(frame: FloatArray, twist: FloatArray) -> FloatArray:
    """Express a twist (6,) with the axes of `frame` (7,) with those of the world."""
    return rotate(frame[3:7], twist.reshape(2, 3)).ravel()


def pose_from_row(row: FloatArray) -> Pose:
    """Extract the pose of a state row."""
    x, y, z, qx, qy, qz, qw = row[:7].tolist()
    return Pose(Point(x, y, z), Quaternion(qx, qy, qz, qw))


def twist_from_row(row: FloatArray) -> Twist:
    """Extract the twist of a state row."""
    vx, vy, vz, wx, wy, wz = row[7:13].tolist()
    return Twist(Vector3(vx, vy, vz), Vector3(wx, wy, wz))
