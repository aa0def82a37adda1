"""Rigid transforms of one body in plain floats, without numpy."""

import math

from zensim.proto.messages.model_messages import Origin, Quat, Vec3


def rotate(orientation: Quat, vector: Vec3) -> Vec3:
    """Turn a vector by a unit quaternion (x, y, z, w)."""
    x, y, z, w = orientation
    vx, vy, vz = vector
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def multiply(first: Quat, second: Quat) -> Quat:
    """Compose two rotations: `second` is given in the frame that `first` turns to."""
    ax, ay, az, aw = first
    bx, by, bz, bw = second
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def add(first: Vec3, second: Vec3) -> Vec3:
    """Add two vectors."""
    return (first[0] + second[0], first[1] + second[1], first[2] + second[2])


def cross(first: Vec3, second: Vec3) -> Vec3:
    """Find the vector product."""
    ax, ay, az = first
    bx, by, bz = second
    return (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def compose(outer: Origin, inner: Origin) -> Origin:
    """Express `inner`, given in the frame at `outer`, where `outer` is given."""
    position = add(outer.position, rotate(outer.orientation, inner.position))
    return Origin(position, multiply(outer.orientation, inner.orientation))


def invert(origin: Origin) -> Origin:
    """Express the frame that `origin` is given in, in the frame at `origin`."""
    x, y, z, w = origin.orientation
    back = (-x, -y, -z, w)
    px, py, pz = rotate(back, origin.position)
    return Origin((0.0 - px, 0.0 - py, 0.0 - pz), back)


def from_axis_angle(axis: Vec3, angle_rad: float) -> Quat:
    """Make the rotation about a unit axis."""
    half = angle_rad / 2.0
    sine = math.sin(half)
    return (axis[0] * sine, axis[1] * sine, axis[2] * sine, math.cos(half))


def normalize(vector: Vec3) -> Vec3:
    """Scale a vector to length 1; one without a direction becomes x."""
    length = math.hypot(*vector)
    if length == 0.0:
        return (1.0, 0.0, 0.0)
    return (vector[0] / length, vector[1] / length, vector[2] / length)


def find_yaw(orientation: Quat) -> float:
    """Find the heading [rad] about z."""
    x, y, z, w = orientation
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
