"""Root links and their centres of mass: the world speaks of the ones, Bullet of the others."""

from collections.abc import Sequence

import numpy as np

from proto.rotation import conjugate, multiply, rotate
from sim_server.physics.blueprint import Part
from sim_server.physics.engine import FloatArray


class Roots:
    """Where each body's root link has its centre of mass and its principal axes."""

    def __init__(self) -> None:
        self._com_in_root: FloatArray = np.zeros((64, 3))
        self._root_from_com: FloatArray = np.tile([0.0, 0.0, 0.0, 1.0], (64, 1))

    def remember(self, body: int, root: Part) -> None:
        """Take the root of a new body."""
        while body >= len(self._com_in_root):
            self._com_in_root = np.concatenate([self._com_in_root, self._com_in_root * 0.0])
            self._root_from_com = np.concatenate([self._root_from_com, self._root_from_com])
        self._com_in_root[body] = root.com
        self._root_from_com[body] = conjugate(np.array(root.principal))

    def com_state(self, body: int, base: FloatArray) -> FloatArray:
        """Find the state (13,) of the centre of mass of a root link at `base` (13,)."""
        arm = rotate(base[3:7], self._com_in_root[body])
        turn = multiply(base[3:7], conjugate(self._root_from_com[body]))
        linear = base[7:10] + np.cross(base[10:13], arm)
        return np.concatenate([base[:3] + arm, turn, linear, base[10:13]])

    def turns_and_arms(
        self, bodies: Sequence[int], com: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Find orientations (n, 4) of the root links, and from them to their centres (n, 3)."""
        rows = np.asarray(bodies, dtype=np.intp)
        turns = multiply(com[:, 3:7], self._root_from_com[rows])
        return turns, rotate(turns, self._com_in_root[rows])

    def states(self, bodies: Sequence[int], com: FloatArray) -> FloatArray:
        """Find the states (n, 13) of root links whose centres have the states `com` (n, 13)."""
        turns, arms = self.turns_and_arms(bodies, com)
        linear = com[:, 7:10] - np.cross(com[:, 10:13], arms)
        return np.concatenate([com[:, :3] - arms, turns, linear, com[:, 10:13]], axis=1)
