"""Activate and deactivate slots in MuJoCo's arrays; an inactive slot collides with nothing and costs little."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.mujoco.actuator_targets import ActuatorTargets
from zensim.sim_server.physics.mujoco.mjcf import ModelLayout
from zensim.sim_server.physics.mujoco.slot_layout import NO_INDEX, IndexArray, SlotAddress

MAX_EFFORT = 1e12
EMPTY_SLOT_DEPTH_M = 1e4
"""How far under the world empty slots are."""
MAX_STATE_VALUE = 1e9
"""A state with larger numbers is taken for broken: MuJoCo bears 1e10."""

MjInts = npt.NDArray[np.int32]


class MjModelArrays(Protocol):
    """What of MuJoCo's model says whether a slot takes part."""

    qpos0: FloatArray
    body_pos: FloatArray
    body_quat: FloatArray
    body_gravcomp: FloatArray
    body_contype: MjInts
    body_conaffinity: MjInts
    geom_contype: MjInts
    geom_conaffinity: MjInts
    dof_frictionloss: FloatArray


class MjDataArrays(Protocol):
    """What of MuJoCo's data belongs to slots."""

    qpos: FloatArray
    qvel: FloatArray
    qfrc_applied: FloatArray
    xfrc_applied: FloatArray
    eq_active: npt.NDArray[np.uint8]


def activate_slot(
    model: MjModelArrays, data: MjDataArrays, full: MjModelArrays, address: SlotAddress
) -> None:
    """Let what is in a slot touch and fall, as in a model of which all slots are full."""
    geometries, bodies, rates = address.geometries, address.bodies, address.velocities
    model.geom_contype[geometries] = full.geom_contype[geometries]
    model.geom_conaffinity[geometries] = full.geom_conaffinity[geometries]
    model.body_contype[bodies] = full.body_contype[bodies]
    model.body_conaffinity[bodies] = full.body_conaffinity[bodies]
    model.body_gravcomp[bodies] = 0.0
    model.dof_frictionloss[rates] = full.dof_frictionloss[rates]
    data.eq_active[address.equalities] = 1


def activate_motors(
    model: MjModelArrays, wishes: ActuatorTargets, address: SlotAddress, actuation: Actuation
) -> None:
    """Give motors to what is in a slot."""
    for motors, holds in ((actuation.speeds, False), (actuation.angles, True)):
        for joint, effort in zip(motors.joints, motors.efforts, strict=True):
            if (place := address.joint_velocity(joint)) != NO_INDEX:
                model.dof_frictionloss[place] = min(effort, MAX_EFFORT)
                wishes.holds[place] = holds


def deactivate_all_slots(model: MjModelArrays, data: MjDataArrays, plan: ModelLayout) -> None:
    """Empty all slots at once, as `empty` does one."""
    first = plan.first_slot
    model.geom_contype[first.geometries :] = model.geom_conaffinity[first.geometries :] = 0
    model.body_contype[first.bodies :] = model.body_conaffinity[first.bodies :] = 0
    model.body_gravcomp[first.bodies :] = 1.0
    model.dof_frictionloss[first.velocities :] = 0.0
    data.eq_active[:] = 0
    data.qpos[plan.heights()] = -EMPTY_SLOT_DEPTH_M


def deactivate_slot(model: MjModelArrays, data: MjDataArrays, address: SlotAddress) -> None:
    """Let what is in a slot touch nothing and hang still, far below."""
    freeze_slot(model, data, address)
    data.qpos[address.positions] = model.qpos0[address.positions]
    if address.is_free:
        data.qpos[address.start.positions + 2] = -EMPTY_SLOT_DEPTH_M


def freeze_slot(model: MjModelArrays, data: MjDataArrays, address: SlotAddress) -> None:
    """Let what is in a slot touch nothing and hang still where it is."""
    model.geom_contype[address.geometries] = model.geom_conaffinity[address.geometries] = 0
    model.body_contype[address.bodies] = model.body_conaffinity[address.bodies] = 0
    model.body_gravcomp[address.bodies] = 1.0
    model.dof_frictionloss[address.velocities] = 0.0
    data.eq_active[address.equalities] = 0
    data.qvel[address.velocities] = 0.0


def is_within_limits(base: FloatArray) -> bool:
    """Whether a state (13,) is one that MuJoCo can go on with."""
    return bool((np.abs(base) <= MAX_STATE_VALUE).all())


def copy_slot_states(
    old: tuple[MjModelArrays, MjDataArrays, Sequence[SlotAddress]],
    new: tuple[MjModelArrays, MjDataArrays, Sequence[SlotAddress]],
    wishes: tuple[ActuatorTargets, int],
) -> ActuatorTargets:
    """Copy the states of bodies, bit by bit, to their slots of another cast.

    Args:
        old: Model, data, and where the bodies were.
        new: Model, data, and where they are.
        wishes: What they were told, and how many degrees of freedom there are now.

    Returns:
        What they are told.
    """
    (model, data, _), (other_model, other_data, _) = old, new
    places, rates, links = (
        tuple(
            _join_slot_indexes([getattr(seat, what) for seat in seats])
            for seats in (old[2], new[2])
        )
        for what in ("positions", "velocities", "bodies")
    )
    other_data.qpos[places[1]] = data.qpos[places[0]]
    other_data.qvel[rates[1]] = data.qvel[rates[0]]
    other_data.qfrc_applied[rates[1]] = data.qfrc_applied[rates[0]]
    other_data.xfrc_applied[links[1]] = data.xfrc_applied[links[0]]
    other_model.body_pos[links[1]] = model.body_pos[links[0]]
    other_model.body_quat[links[1]] = model.body_quat[links[0]]
    return wishes[0].remap(rates[0], rates[1], wishes[1])


def _join_slot_indexes(places: Sequence[IndexArray]) -> IndexArray:
    return np.concatenate([np.zeros(0, np.intp), *places])
