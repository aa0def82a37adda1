"""Rigid transforms, SE(3), on numpy arrays: one or many; leading axes broadcast.

Quaternions (..., 4) are x y z w, of unit length. Poses (..., 7) are position [m], quaternion. A
pose gives a child frame in its parent frame. The formulas are those of `rigid_transforms`.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from zensim.proto import rigid_transforms
from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.messages.model_messages import Origin

FloatArray = npt.NDArray[np.float64]

NEXT_AXES, LAST_AXES = np.array([1, 2, 0]), np.array([2, 0, 1])
"""The axes after and before x, y and z."""
MAX_FEW_NUMBERS = 600
"""Numbers of an array up to which the count of array operations decides the time."""
IDENTITY_POSE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def multiply(left: FloatArray, right: FloatArray) -> FloatArray:
    """Compose rotations: `right` is applied first."""
    return _join(rigid_transforms.multiply(_split(left), _split(right)))


def conjugate(turn: FloatArray) -> FloatArray:
    """Invert rotations."""
    return np.asarray(turn * np.array([-1.0, -1.0, -1.0, 1.0]))


def rotate(turn: FloatArray, vector: FloatArray) -> FloatArray:
    """Rotate vectors (..., 3)."""
    # Fewer array operations than the expanded form, which is faster for floats.
    axis, w = turn[..., :3], turn[..., 3:]
    twice = 2.0 * cross(axis, vector)
    return np.asarray(vector + w * twice + cross(axis, twice))


def rotate_all(turn: FloatArray, vectors: FloatArray) -> FloatArray:
    """Rotate many vectors (n, 3) by each of few rotations (..., 4): (..., n, 3)."""
    matrix, (x, y, z) = to_matrix(turn)[..., None], vectors.T
    turned = np.empty((*turn.shape[:-1], *vectors.shape))
    for row in range(3):
        turned[..., row] = (
            matrix[..., row, 0, :] * x + matrix[..., row, 1, :] * y + matrix[..., row, 2, :] * z
        )
    return turned


def cross(left: FloatArray, right: FloatArray) -> FloatArray:
    """Compute vector products (..., 3), many times as fast as numpy for few vectors."""
    if left.size > MAX_FEW_NUMBERS:
        return _join(rigid_transforms.cross(_split(left), _split(right)))
    # The same numbers by fewer array operations, which decide the time for few vectors.
    first = left.take(NEXT_AXES, axis=-1) * right.take(LAST_AXES, axis=-1)
    return np.asarray(first - left.take(LAST_AXES, axis=-1) * right.take(NEXT_AXES, axis=-1))


def compose(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Compose poses: `inner` is given in the frames at `outer`."""
    position = transform_points(outer, inner[..., :3])
    return np.concatenate([position, multiply(outer[..., 3:], inner[..., 3:])], axis=-1)


def invert(pose: FloatArray) -> FloatArray:
    """Invert poses: parent frames in child frames."""
    back = conjugate(pose[..., 3:])
    return np.concatenate([-rotate(back, pose[..., :3]), back], axis=-1)


def transform_points(pose: FloatArray, points: FloatArray) -> FloatArray:
    """Express points (..., 3), given in the frames at `pose`, in the parent frames."""
    return np.asarray(pose[..., :3] + rotate(pose[..., 3:], points))


def from_origin(origin: Origin) -> FloatArray:
    """Make a pose (7,) of a fixed origin."""
    return np.array([*origin.position, *origin.orientation])


def from_axis_angle(axis: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Make rotations about unit axes (..., 3) by angles (...)."""
    x, y, z = np.moveaxis(axis, -1, 0)
    return _join(rigid_transforms.rotate_about((x, y, z), angle_rad, ARRAY_MATH))


def from_matrix(matrix: FloatArray) -> FloatArray:
    """Make a quaternion (4,), w >= 0, of one proper rotation matrix (3, 3)."""
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


def to_matrix(turn: FloatArray) -> FloatArray:
    """Make rotation matrices (..., 3, 3)."""
    return np.swapaxes(rotate(turn[..., None, :], np.eye(3)), -1, -2)


def from_rpy(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Make a quaternion (4,) of fixed-axis roll, pitch, yaw [rad]."""
    return np.array(rigid_transforms.from_rpy(roll, pitch, yaw))


def wrap_angle(angle: FloatArray) -> FloatArray:
    """Bring angles to -pi to pi [rad]."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def to_yaw(turn: FloatArray) -> FloatArray:
    """Find headings (...) [rad] about z."""
    return np.asarray(rigid_transforms.find_yaw(_split(turn), ARRAY_MATH))


def _split(array: FloatArray) -> Any:  # noqa: ANN401 - stands for a tuple of floats
    """Split the last axis into a sequence of arrays."""
    # As np.moveaxis, which takes four times as long for few vectors.
    return [array[..., column] for column in range(array.shape[-1])]


def _join(parts: Any) -> FloatArray:  # noqa: ANN401 - stands for a tuple of floats
    # As np.stack, which takes three times as long for few vectors.
    joined = np.empty((*parts[0].shape, len(parts)))
    for column, part in enumerate(parts):
        joined[..., column] = part
    return joined
