"""Targets, activation and sleep of slots in MuJoCo's arrays; inactive slots touch nothing."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.sim_server.physics.actuation import MAX_EFFORT, Actuation, JointMotor
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.mujoco.mjcf import ModelLayout
from zensim.sim_server.physics.mujoco.slot_layout import NO_INDEX, IndexArray, SlotAddress

POSITION_ERP = 0.1
"""Share of its error that a position motor corrects in a step; Bullet's default."""
MAX_STATE_VALUE = 1e9
"""Larger values count as diverged; MuJoCo fails from 1e10 on."""
MjInts = npt.NDArray[np.int32]
SLEEP_FLAG = 1 << 4
"""`mjtEnableBit`."""
AWAKE_TREE = -11
"""Value of `tree_asleep`: awake, and not still in any of the last ten steps."""
NEVER_SLEEPS, MAY_SLEEP = 3, 4
"""`mjtSleepPolicy`."""
STATIC_BODY, SLEEPING_BODY, AWAKE_BODY = -1, 0, 1
"""`mjtSleepState`."""


@dataclass(frozen=True)
class ActuatorTargets:
    """Targets, an entry for each degree of freedom.

    Attributes:
        speeds: Of a velocity motor [rad/s or m/s].
        angles: Of a position motor [rad or m].
        is_position: Whether it is a position motor.
        twists: vx, vy and wz at the first three of a root with a planar twist.
        is_twist_imposed: At the first of a root: whether its twist is imposed.
        kinds: `JointTargetKind` of a controlled joint; 0 of others.
        efforts: Of a controlled joint [N m or N].
        velocities: Greatest speed towards an angle; 0 = unlimited.
    """

    speeds: FloatArray
    angles: FloatArray
    is_position: npt.NDArray[np.bool_]
    twists: FloatArray
    is_twist_imposed: npt.NDArray[np.bool_]
    kinds: FloatArray
    efforts: FloatArray
    velocities: FloatArray

    def remap(self, old: IndexArray, new: IndexArray, count: int) -> "ActuatorTargets":
        """Copy entries to the indexes of another model with `count` degrees of freedom."""
        remapped = make_zero_targets(count)
        for field in fields(self):
            getattr(remapped, field.name)[new] = getattr(self, field.name)[old]
        return remapped

    def clear(self, indexes: IndexArray) -> None:
        """Reset entries to zero."""
        for field in fields(self):
            getattr(self, field.name)[indexes] = 0


def make_zero_targets(count: int) -> ActuatorTargets:
    """Make zero targets for `count` degrees of freedom."""
    return ActuatorTargets(
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, dtype=np.bool_),
        np.zeros(count),
        np.zeros(count, dtype=np.bool_),
        *(np.zeros(count) for _ in range(3)),
    )


class MjModelArrays(Protocol):
    """Arrays of `mujoco.MjModel` that activate a slot."""

    qpos0: FloatArray
    body_pos: FloatArray
    body_quat: FloatArray
    body_gravcomp: FloatArray
    body_contype: MjInts
    body_conaffinity: MjInts
    geom_contype: MjInts
    geom_conaffinity: MjInts
    dof_frictionloss: FloatArray
    dof_jntid: MjInts
    jnt_stiffness: FloatArray


class MjDataArrays(Protocol):
    """Arrays of `mujoco.MjData` with the state of slots."""

    qpos: FloatArray
    qvel: FloatArray
    qacc: FloatArray
    qfrc_applied: FloatArray
    xfrc_applied: FloatArray
    eq_active: npt.NDArray[np.uint8]


def activate_slot(
    model: MjModelArrays, data: MjDataArrays, full: MjModelArrays, address: SlotAddress
) -> None:
    """Enable collisions, gravity, friction, springs and equalities of a slot, as in `full`."""
    geometries, bodies = address.geometries, address.bodies
    model.geom_contype[geometries] = full.geom_contype[geometries]
    model.geom_conaffinity[geometries] = full.geom_conaffinity[geometries]
    model.body_contype[bodies] = full.body_contype[bodies]
    model.body_conaffinity[bodies] = full.body_conaffinity[bodies]
    model.body_gravcomp[bodies] = 0.0
    model.dof_frictionloss[address.velocities] = full.dof_frictionloss[address.velocities]
    joints = full.dof_jntid[address.velocities]
    model.jnt_stiffness[joints] = full.jnt_stiffness[joints]
    data.eq_active[address.equalities] = 1


def activate_motors(
    model: MjModelArrays, targets: ActuatorTargets, address: SlotAddress, actuation: Actuation
) -> None:
    """Enable the motors of a slot."""
    for motors, is_position in ((actuation.speeds, False), (actuation.angles, True)):
        for joint, effort in zip(motors.joints, motors.efforts, strict=True):
            if (index := address.joint_velocity(joint)) != NO_INDEX:
                model.dof_frictionloss[index] = min(effort, MAX_EFFORT)
                targets.is_position[index] = is_position


def set_joint_motor(
    model: MjModelArrays, targets: ActuatorTargets, index: int, motor: JointMotor, friction: float
) -> None:
    """Set the motor of a controlled joint as the kind of its target says.

    Args:
        model: Its friction is that of the motor.
        targets: With the kind.
        index: Of the degree of freedom.
        motor: Of the joint.
        friction: Of the joint.
    """
    kind = targets.kinds[index]
    is_moved = kind in (JointTargetKind.POSITION, JointTargetKind.VELOCITY)
    model.dof_frictionloss[index] = min(motor.effort, MAX_EFFORT) if is_moved else friction
    targets.is_position[index] = kind == JointTargetKind.POSITION
    targets.velocities[index] = motor.velocity


def deactivate_all_slots(model: MjModelArrays, data: MjDataArrays, layout: ModelLayout) -> None:
    """Deactivate all slots at once."""
    first = layout.first_slot
    model.geom_contype[first.geometries :] = model.geom_conaffinity[first.geometries :] = 0
    model.body_contype[first.bodies :] = model.body_conaffinity[first.bodies :] = 0
    model.body_gravcomp[first.bodies :] = 1.0
    model.dof_frictionloss[first.velocities :] = 0.0
    model.jnt_stiffness[:] = 0.0
    data.eq_active[:] = 0


def deactivate_slot(model: MjModelArrays, data: MjDataArrays, address: SlotAddress) -> None:
    """Freeze a slot at the origin.

    Not far away: MuJoCo sorts all bodies, also those that touch nothing, along the axis of their
    greatest spread, and tests the pairs whose extents overlap on it (ADR 100).
    """
    freeze_slot(model, data, address)
    data.qpos[address.positions] = model.qpos0[address.positions]


def freeze_slot(model: MjModelArrays, data: MjDataArrays, address: SlotAddress) -> None:
    """Disable collisions, gravity, friction and springs of a slot, and stop it where it is."""
    model.geom_contype[address.geometries] = model.geom_conaffinity[address.geometries] = 0
    model.body_contype[address.bodies] = model.body_conaffinity[address.bodies] = 0
    model.body_gravcomp[address.bodies] = 1.0
    model.dof_frictionloss[address.velocities] = 0.0
    model.jnt_stiffness[model.dof_jntid[address.velocities]] = 0.0
    data.eq_active[address.equalities] = 0
    data.qvel[address.velocities] = 0.0
    data.qacc[address.velocities] = 0.0


def is_within_limits(base: FloatArray) -> bool:
    """Whether MuJoCo can simulate a state (13,)."""
    return bool((np.abs(base) <= MAX_STATE_VALUE).all())


def copy_slot_states(
    old: tuple[MjModelArrays, MjDataArrays, Sequence[SlotAddress]],
    new: tuple[MjModelArrays, MjDataArrays, Sequence[SlotAddress]],
    targets: tuple[ActuatorTargets, int],
) -> ActuatorTargets:
    """Copy the states of bodies to their slots in another model, bit by bit.

    Args:
        old: Model, data, and the addresses of the bodies.
        new: Likewise, in the same order.
        targets: In the old model, and the degrees of freedom of the new one.

    Returns:
        Targets in the new model.
    """
    (model, data, _), (other_model, other_data, _) = old, new
    positions, velocities, bodies = (
        tuple(
            np.concatenate([np.zeros(0, np.intp), *(getattr(one, name) for one in addresses)])
            for addresses in (old[2], new[2])
        )
        for name in ("positions", "velocities", "bodies")
    )
    other_data.qpos[positions[1]] = data.qpos[positions[0]]
    other_data.qvel[velocities[1]] = data.qvel[velocities[0]]
    other_data.qacc[velocities[1]] = data.qacc[velocities[0]]
    other_data.qfrc_applied[velocities[1]] = data.qfrc_applied[velocities[0]]
    other_data.xfrc_applied[bodies[1]] = data.xfrc_applied[bodies[0]]
    other_model.body_pos[bodies[1]] = model.body_pos[bodies[0]]
    other_model.body_quat[bodies[1]] = model.body_quat[bodies[0]]
    return targets[0].remap(velocities[0], velocities[1], targets[1])


class MjTrees(Protocol):
    """Arrays of `mujoco.MjModel` about trees; a tree is what joints connect."""

    body_treeid: MjInts
    body_parentid: MjInts
    dof_bodyid: MjInts
    tree_sleep_policy: MjInts


class MjSleepStates(Protocol):
    """Entries of `mujoco.MjData` about sleep; of each list, the first `n..._awake` count."""

    tree_asleep: MjInts
    tree_awake: MjInts
    body_awake: MjInts
    body_awake_ind: MjInts
    parent_awake_ind: MjInts
    dof_awake_ind: MjInts
    ntree_awake: int
    nbody_awake: int
    nparent_awake: int
    nv_awake: int


def set_sleeping_trees(model: MjTrees, data: MjSleepStates, trees: IndexArray) -> None:
    """Let some trees sleep, each for itself, and all others be awake.

    MuJoCo neither moves a sleeping tree nor makes its contacts; it wakes one that an awake tree
    touches, or whose state or loads are set. Its own choice, ten steps below a speed, also freezes
    a body where it turns back.

    Args:
        model: Its sleep policies are set.
        data: What depends on positions has been computed, for static bodies too. Trees that are to
            sleep have no velocity and no load.
        trees: Indexes of the trees that are to sleep.
    """
    model.tree_sleep_policy[:] = NEVER_SLEEPS
    model.tree_sleep_policy[trees] = MAY_SLEEP
    data.tree_asleep[:] = AWAKE_TREE
    data.tree_asleep[trees] = trees
    data.tree_awake[:] = 1
    data.tree_awake[trees] = 0
    moving = np.where(data.tree_awake[model.body_treeid] == 1, AWAKE_BODY, SLEEPING_BODY)
    data.body_awake[:] = np.where(model.body_treeid < 0, STATIC_BODY, moving)
    is_stepped = data.body_awake != SLEEPING_BODY
    has_stepped_parent = is_stepped[model.body_parentid]
    has_stepped_parent[0] = False  # the world is its own parent
    is_awake = data.body_awake == AWAKE_BODY
    data.ntree_awake = len(data.tree_awake) - len(trees)
    data.nbody_awake = _store(data.body_awake_ind, is_stepped)
    data.nparent_awake = _store(data.parent_awake_ind, has_stepped_parent)
    data.nv_awake = _store(data.dof_awake_ind, is_awake[model.dof_bodyid])


def _store(indexes: MjInts, mask: npt.NDArray[np.bool_]) -> int:
    """Write the indexes that a mask selects; return their number."""
    found = np.flatnonzero(mask)
    indexes[: len(found)] = found
    return len(found)
