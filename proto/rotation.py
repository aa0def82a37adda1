"""Quaternion arithmetic on arrays (..., 4), in the order x y z w."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def multiply(left: FloatArray, right: FloatArray) -> FloatArray:
    """Compose rotations: `right` first, then `left`."""
    lx, ly, lz, lw = np.moveaxis(left, -1, 0)
    rx, ry, rz, rw = np.moveaxis(right, -1, 0)
    return np.stack(
        [
            lw * rx + lx * rw + ly * rz - lz * ry,
            lw * ry - lx * rz + ly * rw + lz * rx,
            lw * rz + lx * ry - ly * rx + lz * rw,
            lw * rw - lx * rx - ly * ry - lz * rz,
        ],
        axis=-1,
    )


def conjugate(turn: FloatArray) -> FloatArray:
    """Invert rotations."""
    return np.asarray(turn * np.array([-1.0, -1.0, -1.0, 1.0]))


def rotate(turn: FloatArray, vector: FloatArray) -> FloatArray:
    """Rotate vectors (..., 3)."""
    axis, w = turn[..., :3], turn[..., 3:]
    twice = 2.0 * _cross(axis, vector)
    return np.asarray(vector + w * twice + _cross(axis, twice))


def _cross(left: FloatArray, right: FloatArray) -> FloatArray:
    # As numpy's, which takes thrice as long for few vectors.
    lx, ly, lz = left[..., 0], left[..., 1], left[..., 2]
    rx, ry, rz = right[..., 0], right[..., 1], right[..., 2]
    first = ly * rz - lz * ry
    found = np.empty((*first.shape, 3))
    found[..., 0] = first
    found[..., 1] = lz * rx - lx * rz
    found[..., 2] = lx * ry - ly * rx
    return found


def from_matrix(matrix: FloatArray) -> FloatArray:
    """Turn one proper rotation matrix (3, 3) into a quaternion."""
    # The eigenvector of the largest eigenvalue is exact for every angle, half turns too.
    m = matrix
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0.0, 0.0, 0.0],
            [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], 0.0, 0.0],
            [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], 0.0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], np.trace(m)],
        ]
    )
    turn = np.linalg.eigh(k)[1][:, 3]
    return np.asarray(turn if turn[3] >= 0 else -turn)


def from_rpy(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Turn fixed-axis roll, pitch, yaw [rad] into a quaternion. Source: URDF, REP-103."""
    halves = np.array([roll, pitch, yaw]) / 2.0
    (sr, sp, sy), (cr, cp, cy) = np.sin(halves), np.cos(halves)
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def to_yaw(turn: FloatArray) -> FloatArray:
    """Find the heading [rad] about z."""
    x, y, z, w = np.moveaxis(turn, -1, 0)
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
