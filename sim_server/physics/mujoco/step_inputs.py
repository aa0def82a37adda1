"""Inputs of a step beside the model: motor speeds, imposed twists and link forces of all active bodies."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.actuation import impose_planar_twists
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.link_forces import LinkForce
from zensim.sim_server.physics.mujoco.actuator_targets import POSITION_ERP, ActuatorTargets
from zensim.sim_server.physics.mujoco.body_selection import (
    MujocoBody,
    StateGather,
    make_state_gather,
)
from zensim.sim_server.physics.mujoco.slot_layout import IndexArray


class MjBodyMotions(Protocol):
    """What MuJoCo tells of how its bodies move."""

    cvel: FloatArray
    xipos: FloatArray
    ximat: FloatArray
    subtree_com: FloatArray
    xfrc_applied: FloatArray


@dataclass(frozen=True)
class LinkForceArrays:
    """Loads, by the numbers (n,) of MuJoCo's bodies; see `LinkForce`."""

    bodies: IndexArray
    lifts: FloatArray
    arms: FloatArray
    linear_dampings: FloatArray
    angular_dampings: FloatArray

    def __len__(self) -> int:
        """How many there are."""
        return len(self.bodies)

    def apply(self, data: MjBodyMotions, roots: npt.NDArray[np.int32]) -> None:
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
        brakes = np.einsum("nij,nj->ni", turns, self.angular_dampings * spins)
        forces = self.lifts - self.linear_dampings[:, None] * linear
        return np.concatenate([forces, np.cross(arms, self.lifts) - brakes], axis=1)


def make_link_force_arrays(loads: Iterable[tuple[int, LinkForce]]) -> LinkForceArrays:
    """Lay loads out, each with the number of its body."""
    found = list(loads)
    return LinkForceArrays(
        np.array([body for body, _ in found], np.intp),
        np.array([load.gravity_force for _, load in found]).reshape(-1, 3),
        np.array([load.arm for _, load in found]).reshape(-1, 3),
        np.array([load.linear_damping for _, load in found]),
        np.array([load.angular_damping for _, load in found]).reshape(-1, 3),
    )


@dataclass(frozen=True)
class StepInputs:
    """Who is driven, moved and pulled.

    Attributes:
        motors: Places in qvel of what has friction, in the order of MuJoCo's rows.
        holders, held: Which of them hold an angle, and their places in qpos.
        moved: Roots that a twist moves.
        pulls: What acts on links that are weightless, or slow down.
    """

    motors: IndexArray
    position_motors: IndexArray
    position_qpos: IndexArray
    twisted_roots: StateGather
    link_forces: LinkForceArrays

    def speeds(self, wishes: ActuatorTargets, qpos: FloatArray, dt_s: float) -> FloatArray:
        """Find the speed that each motor is to reach in this step; what only rubs has 0."""
        found = wishes.speeds[self.motors]
        if len(self.position_motors):
            errors = wishes.angles[self.motors[self.position_motors]] - qpos[self.position_qpos]
            found[self.position_motors] = POSITION_ERP / dt_s * errors
        return found

    def impose_twists(self, wishes: ActuatorTargets, qpos: FloatArray, qvel: FloatArray) -> None:
        """Let roots go in the plane as they are told; changes `qvel`."""
        rows = self.twisted_roots.read_bases(
            np.empty((len(self.twisted_roots.free), 13)), qpos, qvel
        )
        places = self.twisted_roots.twists
        twists = wishes.twists[places[:, :3]]
        found = impose_planar_twists(rows[:, 7:], rows[:, 3:7], np.zeros((len(rows), 3)), twists)
        qvel[places[:, :3]] = found[:, :3]
        qvel[places[:, 3:]] = rotate(conjugate(rows[:, 3:7]), found[:, 3:])


def make_step_inputs(
    bodies: Iterable[MujocoBody], wishes: ActuatorTargets, friction: FloatArray, places: IndexArray
) -> StepInputs:
    """Take stock of bodies.

    Args:
        bodies: None of which is broken.
        wishes: What they are told.
        friction: Of each degree of freedom.
        places: Where each begins in qpos.
    """
    bodies = list(bodies)
    motors = np.flatnonzero(friction > 0.0)
    holders = np.flatnonzero(wishes.holds[motors])
    free = [body.address for body in bodies if body.address.is_free]
    return StepInputs(
        motors,
        holders,
        places[motors[holders]],
        make_state_gather(
            [seat for seat in free if wishes.is_twist_imposed[seat.start.velocities]]
        ),
        make_link_force_arrays(
            (body.address.start.bodies + body.address.layout.bodies[load.part + 1], load)
            for body in bodies
            for load in body.loads
        ),
    )
