"""What a step of MuJoCo gets: targets of motors, planar twists, forces and torques."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.actuation import impose_planar_twists
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.free_spin import can_precess, find_implicit_torques, find_spinning
from zensim.sim_server.physics.link_forces import LinkForce
from zensim.sim_server.physics.mujoco.body_selection import (
    MujocoBody,
    StateGather,
    make_state_gather,
)
from zensim.sim_server.physics.mujoco.slot_layout import IndexArray, SlotAddress
from zensim.sim_server.physics.mujoco.slot_state import POSITION_ERP, ActuatorTargets

STRONG_ACCELERATION = 3e4
"""Acceleration [m/s^2 or rad/s^2] by which a motor pushes a joint 5 mm or mrad beyond its stop."""


class MjBodyMotions(Protocol):
    """Arrays of `mujoco.MjData` about the motion of bodies."""

    cvel: FloatArray
    xipos: FloatArray
    ximat: FloatArray
    subtree_com: FloatArray
    xfrc_applied: FloatArray


@dataclass(frozen=True)
class LinkForceArrays:
    """`LinkForce` as arrays, by the index (n,) of MuJoCo's bodies."""

    bodies: IndexArray
    gravity_forces: FloatArray
    arms: FloatArray
    linear_dampings: FloatArray
    angular_dampings: FloatArray

    def __len__(self) -> int:
        """Number of links with forces."""
        return len(self.bodies)

    def apply(self, data: MjBodyMotions, roots: npt.NDArray[np.int32]) -> None:
        """Add the forces of the next step; `roots` (bodies,) is the root of each body."""
        bodies = self.bodies
        spins = data.cvel[bodies, :3]
        # MuJoCo's velocities refer to the centre of mass of the whole robot.
        arms = data.xipos[bodies] - data.subtree_com[roots[bodies]]
        linear = data.cvel[bodies, 3:] + np.cross(spins, arms)
        rotations = data.ximat[bodies].reshape(-1, 3, 3)
        data.xfrc_applied[bodies] += self.wrenches(rotations, linear, spins)

    def wrenches(
        self, rotations: FloatArray, linear: FloatArray, angular: FloatArray
    ) -> FloatArray:
        """Find forces and torques (n, 6) at the centres of mass, in the world.

        Args:
            rotations: (n, 3, 3) of the principal axes in the world.
            linear: (n, 3) of the centres of mass.
            angular: (n, 3).
        """
        arms = np.einsum("nij,nj->ni", rotations, self.arms)
        spins = np.einsum("nji,nj->ni", rotations, angular)
        damping = np.einsum("nij,nj->ni", rotations, self.angular_dampings * spins)
        forces = self.gravity_forces - self.linear_dampings[:, None] * linear
        return np.concatenate([forces, np.cross(arms, self.gravity_forces) - damping], axis=1)


def make_link_force_arrays(loads: Iterable[tuple[int, LinkForce]]) -> LinkForceArrays:
    """Make arrays of link forces, each with the index of its body."""
    found = list(loads)
    return LinkForceArrays(
        np.array([body for body, _ in found], np.intp),
        np.array([load.gravity_force for _, load in found]).reshape(-1, 3),
        np.array([load.arm for _, load in found]).reshape(-1, 3),
        np.array([load.linear_damping for _, load in found]),
        np.array([load.angular_damping for _, load in found]).reshape(-1, 3),
    )


@dataclass(frozen=True)
class SpinningBodies:
    """Loose bodies that can precess.

    Attributes:
        bodies: (n,) their indexes.
        moments: (n, 3) principal.
    """

    bodies: IndexArray
    moments: FloatArray

    def apply_torques(self, data: MjBodyMotions, dt_s: float) -> bool:
        """Add the torques of the next step; return whether there are any."""
        velocities = data.cvel[self.bodies, :3]
        found = np.flatnonzero(find_spinning(velocities, dt_s))
        if not len(found):
            return False
        bodies = self.bodies[found]
        rotations = data.ximat[bodies].reshape(-1, 3, 3)
        spins = _rotate_each(rotations.transpose(0, 2, 1), velocities[found])
        torques = find_implicit_torques(self.moments[found], spins, dt_s)
        data.xfrc_applied[bodies, 3:] += _rotate_each(rotations, torques)
        return True


def _rotate_each(rotations: FloatArray, vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T[:, :, None]
    return np.asarray(rotations[:, :, 0] * x + rotations[:, :, 1] * y + rotations[:, :, 2] * z)


@dataclass(frozen=True)
class StepInputs:
    """Indexes of all that a step has to set.

    Attributes:
        motors: Indexes in qvel of degrees of freedom with friction, in the order of MuJoCo's rows.
        position_motors, position_qpos: Which of them hold an angle, and their indexes in qpos.
        strong_motors, strong_qpos, bounds: Which could move far through a stop, and (2, n) stops.
        pushed: Indexes in qvel of controlled joints that get an effort.
        twisted_roots: Roots with a planar twist.
        link_forces: Gravity compensation and damping.
        spinning: Loose bodies that can precess.
    """

    motors: IndexArray
    position_motors: IndexArray
    position_qpos: IndexArray
    strong_motors: IndexArray
    strong_qpos: IndexArray
    bounds: FloatArray
    pushed: IndexArray
    twisted_roots: StateGather
    link_forces: LinkForceArrays
    spinning: SpinningBodies

    def speeds(self, targets: ActuatorTargets, qpos: FloatArray, dt_s: float) -> FloatArray:
        """Find the target speed of each motor in this step; 0 for joints with friction only."""
        speeds = targets.speeds[self.motors]
        if len(self.position_motors):
            held = self.motors[self.position_motors]
            wanted = POSITION_ERP / dt_s * (targets.angles[held] - qpos[self.position_qpos])
            most = targets.velocities[held]
            if most.any():
                most[most == 0.0] = np.inf
                wanted = np.clip(wanted, -most, most)
            speeds[self.position_motors] = wanted
        if len(self.strong_motors):
            nearest = (self.bounds - qpos[self.strong_qpos]) / dt_s
            speeds[self.strong_motors] = np.clip(speeds[self.strong_motors], *nearest)
        return speeds

    def impose_twists(self, targets: ActuatorTargets, qpos: FloatArray, qvel: FloatArray) -> None:
        """Set the planar velocity of roots in `qvel`."""
        rows = self.twisted_roots.read_bases(
            np.empty((len(self.twisted_roots.free), 13)), qpos, qvel
        )
        indexes = self.twisted_roots.twists
        twists = targets.twists[indexes[:, :3]]
        arms = np.zeros((len(rows), 3))
        velocities = impose_planar_twists(rows[:, 7:], rows[:, 3:7], arms, twists)
        qvel[indexes[:, :3]] = velocities[:, :3]
        qvel[indexes[:, 3:]] = rotate(conjugate(rows[:, 3:7]), velocities[:, 3:])


def make_step_inputs(
    bodies: Sequence[MujocoBody],
    targets: ActuatorTargets,
    friction: FloatArray,
    qpos_indexes: IndexArray,
    ranges: FloatArray,
    inertias: FloatArray,
) -> StepInputs:
    """Collect the inputs of the active bodies.

    Args:
        bodies: Active bodies.
        targets: Of all degrees of freedom.
        friction: Of each degree of freedom.
        qpos_indexes: Index in qpos of the joint of each degree of freedom.
        ranges: (n, 2) stops of that joint; equal where it has none.
        inertias: Of each degree of freedom [kg or kg m^2].
    """
    motors = np.flatnonzero(friction > 0.0)
    position_motors = np.flatnonzero(targets.is_position[motors])
    has_stops = ranges[motors, 0] < ranges[motors, 1]
    strong = np.flatnonzero(has_stops & (friction > STRONG_ACCELERATION * inertias)[motors])
    return StepInputs(
        motors,
        position_motors,
        qpos_indexes[motors[position_motors]],
        strong,
        qpos_indexes[motors[strong]],
        ranges[motors[strong]].T,
        np.flatnonzero(targets.kinds == JointTargetKind.EFFORT),
        make_state_gather(_list_twisted(bodies, targets)),
        make_link_force_arrays(
            (body.address.start.bodies + body.address.layout.bodies[load.part + 1], load)
            for body in bodies
            for load in body.loads
        ),
        _find_spinning_bodies(bodies),
    )


def _list_twisted(bodies: Iterable[MujocoBody], targets: ActuatorTargets) -> list[SlotAddress]:
    free = (body.address for body in bodies if body.address.is_free)
    return [one for one in free if targets.is_twist_imposed[one.start.velocities]]


def _find_spinning_bodies(bodies: Iterable[MujocoBody]) -> SpinningBodies:
    found = []
    for body in bodies:
        parts = body.archetype.link_parts
        moments = parts[0].moments
        if body.address.is_free and len(parts) == 1 and can_precess(moments):
            found.append((body.address.start.bodies, moments))
    return SpinningBodies(
        np.array([index for index, _ in found], np.intp),
        np.array([moments for _, moments in found]).reshape(-1, 3),
    )
