"""Body states read from Bullet, converted between centre-of-mass frames and root link frames."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.se3 import conjugate, multiply, rotate
from zensim.sim_server.physics.blueprint import RigidPart
from zensim.sim_server.physics.engine import FloatArray

Vector3Tuple = tuple[float, float, float]
QuaternionTuple = tuple[float, float, float, float]
ReadBasePose = Callable[[int, int], tuple[Vector3Tuple, QuaternionTuple]]
ReadBaseVelocity = Callable[[int, int], tuple[Vector3Tuple, Vector3Tuple]]
ReadJointStates = Callable[
    [int, Sequence[int], int], Iterable[tuple[float, float, Sequence[float], float]]
]


def read_base_states(
    bodies: Iterable[int], client: int, read_pose: ReadBasePose, read_velocity: ReadBaseVelocity
) -> FloatArray:
    """Read (n, 13): position, quaternion xyzw, linear and angular velocity."""
    # One flat list and positional arguments: nested lists and keywords take a third more time.
    numbers: list[float] = []
    for body in bodies:
        position, orientation = read_pose(body, client)
        linear, angular = read_velocity(body, client)
        numbers += position
        numbers += orientation
        numbers += linear
        numbers += angular
    return np.array(numbers, dtype=np.float64).reshape(-1, 13)


def read_joint_states(
    bodies: Iterable[tuple[int, Sequence[int]]], client: int, read_joints: ReadJointStates
) -> tuple[FloatArray, FloatArray]:
    """Read positions (k,) and velocities (k,) of joints, body by body."""
    positions: list[float] = []
    velocities: list[float] = []
    for body, joints in bodies:
        for position, velocity, _, _ in read_joints(body, joints, client):
            positions.append(position)
            velocities.append(velocity)
    return np.array(positions, dtype=np.float64), np.array(velocities, dtype=np.float64)


CYCLIC_AXES = np.array([0, 1, 2, 0, 1])
"""Extends vectors (3, n) to (5, n), so that cross products are products of slices."""


@dataclass(frozen=True)
class _ComOffsets:
    """Centres of mass (5, n), extended by `CYCLIC_AXES`, and principal axes of some bodies."""

    com_in_root: FloatArray
    root_from_com: FloatArray
    has_rotation: bool
    has_translation: bool


class ComFrames:
    """Centre of mass and principal axes of each body, in its root link."""

    def __init__(self) -> None:
        self._com_in_root: FloatArray = np.zeros((64, 3))
        self._root_from_com: FloatArray = np.tile([0.0, 0.0, 0.0, 1.0], (64, 1))
        self._cached: tuple[Sequence[int], _ComOffsets] | None = None

    def add(self, body: int, root: RigidPart) -> None:
        """Add a body by its root part."""
        while body >= len(self._com_in_root):
            self._com_in_root = np.concatenate([self._com_in_root, self._com_in_root * 0.0])
            self._root_from_com = np.concatenate([self._root_from_com, self._root_from_com])
        self._com_in_root[body] = root.com
        self._root_from_com[body] = conjugate(np.array(root.principal))
        self._cached = None

    def to_com_state(self, body: int, base: FloatArray) -> FloatArray:
        """Find the state (13,) of the centre of mass of a root link at `base` (13,)."""
        arm = rotate(base[3:7], self._com_in_root[body])
        orientation = multiply(base[3:7], conjugate(self._root_from_com[body]))
        (ax, ay, az), (wx, wy, wz) = arm.tolist(), base[10:13].tolist()
        tangential = np.array([wy * az - wz * ay, wz * ax - wx * az, wx * ay - wy * ax])
        return np.concatenate([base[:3] + arm, orientation, base[7:10] + tangential, base[10:13]])

    def orientations_and_arms(
        self, bodies: Sequence[int], com: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Find root link orientations (n, 4), and vectors (n, 3) from there to the centres."""
        offsets = self._offsets(bodies)
        orientations = com[:, 3:7]
        if offsets.has_rotation:
            orientations = multiply(orientations, offsets.root_from_com)
        return orientations, _rotate_columns(orientations, offsets.com_in_root).T

    def states(self, bodies: Sequence[int], com: FloatArray) -> FloatArray:
        """Convert states (n, 13) of centres of mass to root links, in place."""
        offsets = self._offsets(bodies)
        if offsets.has_rotation:
            com[:, 3:7] = multiply(com[:, 3:7], offsets.root_from_com)
        if offsets.has_translation:
            arms = _rotate_columns(com[:, 3:7], offsets.com_in_root)
            com[:, :3] -= arms.T
            com[:, 7:10] -= _cross_columns(
                com.T[10:13].take(CYCLIC_AXES, axis=0), arms.take(CYCLIC_AXES, axis=0)
            ).T
        return com

    def _offsets(self, bodies: Sequence[int]) -> _ComOffsets:
        """Collect the offsets of bodies; cached for the last tuple."""
        if self._cached is not None and self._cached[0] is bodies:
            return self._cached[1]
        rows = np.asarray(bodies, dtype=np.intp)
        coms, rotations = self._com_in_root[rows], self._root_from_com[rows]
        found = _ComOffsets(
            coms.T.take(CYCLIC_AXES, axis=0),
            rotations,
            has_rotation=bool(rotations[:, :3].any()),
            has_translation=bool(coms.any()),
        )
        if isinstance(bodies, tuple):
            self._cached = bodies, found
        return found


def _rotate_columns(rotations: FloatArray, vectors: FloatArray) -> FloatArray:
    """Rotate vectors (5, n) by quaternions (n, 4), into (3, n)."""
    axes = rotations.T[:3].take(CYCLIC_AXES, axis=0)
    twice = 2.0 * _cross_columns(axes, vectors)
    return np.asarray(
        vectors[:3] + rotations.T[3] * twice + _cross_columns(axes, twice.take(CYCLIC_AXES, axis=0))
    )


def _cross_columns(left: FloatArray, right: FloatArray) -> FloatArray:
    """Find the cross products (3, n) of vectors (5, n)."""
    return np.asarray(left[1:4] * right[2:5] - left[2:5] * right[1:4])
