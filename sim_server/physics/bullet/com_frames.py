"""Frames of centres of mass, in which Bullet has poses and velocities."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto import rigid_transforms
from zensim.proto.se3 import conjugate, multiply
from zensim.sim_server.physics.blueprint import RigidPart
from zensim.sim_server.physics.engine import FloatArray

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
        # In floats, which are ten times faster than arrays of one.
        x, y, z, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz = base.tolist()
        cx, cy, cz = self._com_in_root[body].tolist()
        px, py, pz, pw = self._root_from_com[body].tolist()
        arm = rigid_transforms.rotate((qx, qy, qz, qw), (cx, cy, cz))
        turned = rigid_transforms.multiply((qx, qy, qz, qw), (-px, -py, -pz, pw))
        tangential = rigid_transforms.cross((wx, wy, wz), arm)
        position = rigid_transforms.add((x, y, z), arm)
        linear = rigid_transforms.add((vx, vy, vz), tangential)
        return np.array([*position, *turned, *linear, wx, wy, wz])

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
