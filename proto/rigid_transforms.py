"""Rigid transforms in columns: of one body in floats, or of many in arrays.

`se3` applies these formulas to arrays of whole poses. They are here because agents must start
without numpy (0.1 s), and because floats are ten times faster than arrays of one.
"""

import math
from typing import TypeAlias

from zensim.proto.drives.column_math import FLOAT_MATH, Column, ColumnMath
from zensim.proto.messages.model_messages import Origin, Quat, Vec3

Vector: TypeAlias = tuple[Column, Column, Column]
Rotation: TypeAlias = tuple[Column, Column, Column, Column]
"""Unit quaternion x y z w."""

MIN_HALF_COSINE = 1e-9
"""1 + cosine of the angle between directions that count as opposite."""
GIMBAL_LOCK_SINE = 1.0 - 1e-12
OPTICAL_AXES = Origin(orientation=(-0.5, 0.5, -0.5, 0.5))
"""Axes of images (x right, y down, z forward) in those of a camera. Source: REP-103."""


def rotate(
    orientation: Rotation[Column], vector: tuple[Column | float, Column | float, Column | float]
) -> Vector[Column]:
    """Rotate a vector."""
    x, y, z, w = orientation
    vx, vy, vz = vector
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def multiply(
    first: Rotation[Column],
    second: tuple[Column | float, Column | float, Column | float, Column | float],
) -> Rotation[Column]:
    """Compose two rotations; `second` is given in the frame that `first` rotates to."""
    ax, ay, az, aw = first
    bx, by, bz, bw = second
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def add(first: Vector[Column], second: Vector[Column]) -> Vector[Column]:
    """Add two vectors."""
    return (first[0] + second[0], first[1] + second[1], first[2] + second[2])


def scale(vector: Vector[Column], factor: float) -> Vector[Column]:
    """Multiply a vector by a number."""
    return (vector[0] * factor, vector[1] * factor, vector[2] * factor)


def cross(first: Vector[Column], second: Vector[Column]) -> Vector[Column]:
    """Find the vector product."""
    ax, ay, az = first
    bx, by, bz = second
    return (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def compose(outer: Origin, inner: Origin) -> Origin:
    """Express `inner`, given in the frame at `outer`, where `outer` is given."""
    return Origin(
        transform_point(outer, inner.position), multiply(outer.orientation, inner.orientation)
    )


def transform_point(origin: Origin, point: Vec3) -> Vec3:
    """Express a point, given in the frame at `origin`, where `origin` is given."""
    return add(origin.position, rotate(origin.orientation, point))


def conjugate(orientation: Rotation[Column]) -> Rotation[Column]:
    """Invert a rotation."""
    x, y, z, w = orientation
    return (-x, -y, -z, w)


def invert(origin: Origin) -> Origin:
    """Express the frame in which `origin` is given in the frame at `origin`."""
    back = conjugate(origin.orientation)
    px, py, pz = rotate(back, origin.position)
    return Origin((0.0 - px, 0.0 - py, 0.0 - pz), back)


def from_axis_angle(axis: Vec3, angle_rad: float) -> Quat:
    """Make the rotation about a unit axis."""
    return rotate_about(axis, angle_rad, FLOAT_MATH)


def rotate_about(
    axis: tuple[Column | float, Column | float, Column | float],
    angle_rad: Column,
    xp: ColumnMath[Column],
) -> Rotation[Column]:
    """Make rotations about unit axes."""
    half = angle_rad / 2.0
    sine = xp.sin(half)
    return (axis[0] * sine, axis[1] * sine, axis[2] * sine, xp.cos(half))


def from_directions(start: Vec3, end: Vec3) -> Quat:
    """Make the shortest rotation from one unit vector to another."""
    x, y, z = cross(start, end)
    w = 1.0 + start[0] * end[0] + start[1] * end[1] + start[2] * end[2]
    if w < MIN_HALF_COSINE:
        x, y, z = normalize((-start[1], start[0], 0.0))
        return (x, y, z, 0.0)
    length = math.hypot(x, y, z, w)
    return (x / length, y / length, z / length, w / length)


def from_rpy(roll: float, pitch: float, yaw: float) -> Quat:
    """Make the rotation of fixed-axis roll, pitch, yaw [rad]. Source: URDF, REP-103."""
    sr, cr = math.sin(roll / 2.0), math.cos(roll / 2.0)
    sp, cp = math.sin(pitch / 2.0), math.cos(pitch / 2.0)
    sy, cy = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def to_rpy(orientation: Quat) -> Vec3:
    """Find fixed-axis roll, pitch, yaw [rad] of any quaternion; roll is 0 at pitch +-pi/2."""
    x, y, z, w = orientation
    sine = 2.0 * (w * y - z * x) / max(x * x + y * y + z * z + w * w, 1e-300)
    if abs(sine) >= GIMBAL_LOCK_SINE:
        return 0.0, math.copysign(math.pi / 2.0, sine), 2.0 * math.atan2(z, w)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, math.asin(sine), find_yaw(orientation, FLOAT_MATH)


def normalize(vector: Vec3) -> Vec3:
    """Scale a vector to length 1; the zero vector becomes x."""
    length = math.hypot(*vector)
    if length == 0.0:
        return (1.0, 0.0, 0.0)
    return (vector[0] / length, vector[1] / length, vector[2] / length)


def find_yaw(orientation: Rotation[Column], xp: ColumnMath[Column]) -> Column:
    """Find the heading [rad] about z."""
    x, y, z, w = orientation
    return xp.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
