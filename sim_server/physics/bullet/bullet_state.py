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
    bodies: Iterable[int], client: int, place_of: ReadBasePose, velocity_of: ReadBaseVelocity
) -> FloatArray:
    """Read (n, 13): position, quaternion xyzw, linear and angular velocity of each."""
    # One long list: rows of their own, and arguments by name, cost a third more.
    numbers: list[float] = []
    for body in bodies:
        place, turn = place_of(body, client)
        linear, angular = velocity_of(body, client)
        numbers += place
        numbers += turn
        numbers += linear
        numbers += angular
    return np.array(numbers, dtype=np.float64).reshape(-1, 13)


def read_joint_states(
    bodies: Iterable[tuple[int, Sequence[int]]], client: int, joints_of: ReadJointStates
) -> tuple[FloatArray, FloatArray]:
    """Read positions (k,) and velocities (k,) of all joints named, body by body."""
    positions: list[float] = []
    velocities: list[float] = []
    for body, joints in bodies:
        for position, velocity, _, _ in joints_of(body, joints, client):
            positions.append(position)
            velocities.append(velocity)
    return np.array(positions, dtype=np.float64), np.array(velocities, dtype=np.float64)


CYCLIC_AXES = np.array([0, 1, 2, 0, 1])
"""Rows of vectors as columns (3, n), written on so that cross products are products of slices."""


@dataclass(frozen=True)
class _ComOffsets:
    """Of some bodies: where their centres are, (5, n) as `CYCLIC_AXES` says, and how they are turned."""

    com_in_root: FloatArray
    root_from_com: FloatArray
    is_turned: bool
    is_off: bool


class ComFrames:
    """Where each body's root link has its centre of mass and its principal axes."""

    def __init__(self) -> None:
        self._com_in_root: FloatArray = np.zeros((64, 3))
        self._root_from_com: FloatArray = np.tile([0.0, 0.0, 0.0, 1.0], (64, 1))
        self._known: tuple[Sequence[int], _ComOffsets] | None = None

    def add(self, body: int, root: RigidPart) -> None:
        """Take the root of a new body."""
        while body >= len(self._com_in_root):
            self._com_in_root = np.concatenate([self._com_in_root, self._com_in_root * 0.0])
            self._root_from_com = np.concatenate([self._root_from_com, self._root_from_com])
        self._com_in_root[body] = root.com
        self._root_from_com[body] = conjugate(np.array(root.principal))
        self._known = None

    def to_com_state(self, body: int, base: FloatArray) -> FloatArray:
        """Find the state (13,) of the centre of mass of a root link at `base` (13,)."""
        arm = rotate(base[3:7], self._com_in_root[body])
        turn = multiply(base[3:7], conjugate(self._root_from_com[body]))
        (ax, ay, az), (wx, wy, wz) = arm.tolist(), base[10:13].tolist()
        swing = np.array([wy * az - wz * ay, wz * ax - wx * az, wx * ay - wy * ax])
        return np.concatenate([base[:3] + arm, turn, base[7:10] + swing, base[10:13]])

    def turns_and_arms(
        self, bodies: Sequence[int], com: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Find orientations (n, 4) of the root links, and from them to their centres (n, 3)."""
        offsets = self._offsets(bodies)
        turns = multiply(com[:, 3:7], offsets.root_from_com) if offsets.is_turned else com[:, 3:7]
        return turns, _rotate_columns(turns, offsets.com_in_root).T

    def states(self, bodies: Sequence[int], com: FloatArray) -> FloatArray:
        """Find the states (n, 13) of root links whose centres have the states `com` (n, 13).

        `com` becomes them.
        """
        offsets = self._offsets(bodies)
        if offsets.is_turned:
            com[:, 3:7] = multiply(com[:, 3:7], offsets.root_from_com)
        if offsets.is_off:
            arms = _rotate_columns(com[:, 3:7], offsets.com_in_root)
            com[:, :3] -= arms.T
            com[:, 7:10] -= _cross_columns(
                com.T[10:13].take(CYCLIC_AXES, axis=0), arms.take(CYCLIC_AXES, axis=0)
            ).T
        return com

    def _offsets(self, bodies: Sequence[int]) -> _ComOffsets:
        """Look the offsets of bodies up: those of the same tuple are at hand."""
        if self._known is not None and self._known[0] is bodies:
            return self._known[1]
        rows = np.asarray(bodies, dtype=np.intp)
        coms, turns = self._com_in_root[rows], self._root_from_com[rows]
        found = _ComOffsets(
            coms.T.take(CYCLIC_AXES, axis=0), turns, bool(turns[:, :3].any()), bool(coms.any())
        )
        if isinstance(bodies, tuple):
            self._known = bodies, found
        return found


def _rotate_columns(turns: FloatArray, vectors: FloatArray) -> FloatArray:
    """Rotate vectors (5, n) by quaternions (n, 4), into (3, n)."""
    axes = turns.T[:3].take(CYCLIC_AXES, axis=0)
    twice = 2.0 * _cross_columns(axes, vectors)
    return np.asarray(
        vectors[:3] + turns.T[3] * twice + _cross_columns(axes, twice.take(CYCLIC_AXES, axis=0))
    )


def _cross_columns(left: FloatArray, right: FloatArray) -> FloatArray:
    """Find the cross products (3, n) of vectors (5, n)."""
    return np.asarray(left[1:4] * right[2:5] - left[2:5] * right[1:4])
