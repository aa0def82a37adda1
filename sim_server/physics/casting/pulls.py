"""Loads of all bodies at once: what acts on links that weigh nothing, or that slow down."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.casting.wishes import Places
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.loads import Load


class Motions(Protocol):
    """What MuJoCo tells of how its bodies move."""

    cvel: FloatArray
    xipos: FloatArray
    ximat: FloatArray
    subtree_com: FloatArray
    xfrc_applied: FloatArray


@dataclass(frozen=True)
class Pulls:
    """Loads, by the numbers (n,) of MuJoCo's bodies; see `Load`."""

    bodies: Places
    lifts: FloatArray
    arms: FloatArray
    drags: FloatArray
    brakes: FloatArray

    def __len__(self) -> int:
        """How many there are."""
        return len(self.bodies)

    def act(self, data: Motions, roots: npt.NDArray[np.int32]) -> None:
        """Push what is pulled in the next step; `roots` (bodies,) of each body's robot."""
        bodies = self.bodies
        spins = data.cvel[bodies, :3]
        # MuJoCo's velocities are about the centre of mass of the whole robot.
        arms = data.xipos[bodies] - data.subtree_com[roots[bodies]]
        linear = data.cvel[bodies, 3:] + np.cross(spins, arms)
        turns = data.ximat[bodies].reshape(-1, 3, 3)
        data.xfrc_applied[bodies] += self.wrenches(turns, linear, spins)

    def wrenches(self, turns: FloatArray, linear: FloatArray, angular: FloatArray) -> FloatArray:
        """Find forces and torques (n, 6) at the centres of mass, in the world.

        Args:
            turns: (n, 3, 3) of the principal axes in the world.
            linear: (n, 3) of the centres of mass.
            angular: (n, 3).
        """
        arms = np.einsum("nij,nj->ni", turns, self.arms)
        spins = np.einsum("nji,nj->ni", turns, angular)
        brakes = np.einsum("nij,nj->ni", turns, self.brakes * spins)
        forces = self.lifts - self.drags[:, None] * linear
        return np.concatenate([forces, np.cross(arms, self.lifts) - brakes], axis=1)


def pulls_of(loads: Iterable[tuple[int, Load]]) -> Pulls:
    """Lay loads out, each with the number of its body."""
    found = list(loads)
    return Pulls(
        np.array([body for body, _ in found], np.intp),
        np.array([load.lift for _, load in found]).reshape(-1, 3),
        np.array([load.arm for _, load in found]).reshape(-1, 3),
        np.array([load.drag for _, load in found]),
        np.array([load.brake for _, load in found]).reshape(-1, 3),
    )
