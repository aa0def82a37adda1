"""Slots filled and emptied in MuJoCo's arrays: what is empty costs little and touches nothing."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.casting.make import NONE
from zensim.sim_server.physics.casting.plan import Plan
from zensim.sim_server.physics.casting.seat import Seat
from zensim.sim_server.physics.casting.wishes import Places, Wishes
from zensim.sim_server.physics.engine import FloatArray

MOST_EFFORT = 1e12
DEPTH_M = 1e4
"""How far under the world empty slots are."""
FARTHEST = 1e9
"""A state with larger numbers is taken for broken: MuJoCo bears 1e10."""

Ints = npt.NDArray[np.int32]


class Switches(Protocol):
    """What of MuJoCo's model says whether a slot takes part."""

    qpos0: FloatArray
    body_pos: FloatArray
    body_quat: FloatArray
    body_gravcomp: FloatArray
    body_contype: Ints
    body_conaffinity: Ints
    geom_contype: Ints
    geom_conaffinity: Ints
    dof_frictionloss: FloatArray


class State(Protocol):
    """What of MuJoCo's data belongs to slots."""

    qpos: FloatArray
    qvel: FloatArray
    qfrc_applied: FloatArray
    xfrc_applied: FloatArray
    eq_active: npt.NDArray[np.uint8]


def fill(model: Switches, data: State, full: Switches, seat: Seat) -> None:
    """Let what is in a slot touch and fall, as in a model of which all slots are full."""
    geometries, bodies, rates = seat.geometries, seat.bodies, seat.velocities
    model.geom_contype[geometries] = full.geom_contype[geometries]
    model.geom_conaffinity[geometries] = full.geom_conaffinity[geometries]
    model.body_contype[bodies] = full.body_contype[bodies]
    model.body_conaffinity[bodies] = full.body_conaffinity[bodies]
    model.body_gravcomp[bodies] = 0.0
    model.dof_frictionloss[rates] = full.dof_frictionloss[rates]
    data.eq_active[seat.equalities] = 1


def man(model: Switches, wishes: Wishes, seat: Seat, actuation: Actuation) -> None:
    """Give motors to what is in a slot."""
    for motors, holds in ((actuation.speeds, False), (actuation.angles, True)):
        for joint, effort in zip(motors.joints, motors.efforts, strict=True):
            if (place := seat.joint_velocity(joint)) != NONE:
                model.dof_frictionloss[place] = min(effort, MOST_EFFORT)
                wishes.holds[place] = holds


def empty_all(model: Switches, data: State, plan: Plan) -> None:
    """Empty all slots at once, as `empty` does one."""
    first = plan.firsts
    model.geom_contype[first.geometries :] = model.geom_conaffinity[first.geometries :] = 0
    model.body_contype[first.bodies :] = model.body_conaffinity[first.bodies :] = 0
    model.body_gravcomp[first.bodies :] = 1.0
    model.dof_frictionloss[first.velocities :] = 0.0
    data.eq_active[:] = 0
    data.qpos[plan.heights()] = -DEPTH_M


def empty(model: Switches, data: State, seat: Seat) -> None:
    """Let what is in a slot touch nothing and hang still, far below."""
    still(model, data, seat)
    data.qpos[seat.positions] = model.qpos0[seat.positions]
    if seat.is_free:
        data.qpos[seat.begins.positions + 2] = -DEPTH_M


def still(model: Switches, data: State, seat: Seat) -> None:
    """Let what is in a slot touch nothing and hang still where it is."""
    model.geom_contype[seat.geometries] = model.geom_conaffinity[seat.geometries] = 0
    model.body_contype[seat.bodies] = model.body_conaffinity[seat.bodies] = 0
    model.body_gravcomp[seat.bodies] = 1.0
    model.dof_frictionloss[seat.velocities] = 0.0
    data.eq_active[seat.equalities] = 0
    data.qvel[seat.velocities] = 0.0


def is_bearable(base: FloatArray) -> bool:
    """Whether a state (13,) is one that MuJoCo can go on with."""
    return bool((np.abs(base) <= FARTHEST).all())


def carry(
    old: tuple[Switches, State, Sequence[Seat]],
    new: tuple[Switches, State, Sequence[Seat]],
    wishes: tuple[Wishes, int],
) -> Wishes:
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
        tuple(_joined([getattr(seat, what) for seat in seats]) for seats in (old[2], new[2]))
        for what in ("positions", "velocities", "bodies")
    )
    other_data.qpos[places[1]] = data.qpos[places[0]]
    other_data.qvel[rates[1]] = data.qvel[rates[0]]
    other_data.qfrc_applied[rates[1]] = data.qfrc_applied[rates[0]]
    other_data.xfrc_applied[links[1]] = data.xfrc_applied[links[0]]
    other_model.body_pos[links[1]] = model.body_pos[links[0]]
    other_model.body_quat[links[1]] = model.body_quat[links[0]]
    return wishes[0].moved(rates[0], rates[1], wishes[1])


def _joined(places: Sequence[Places]) -> Places:
    return np.concatenate([np.zeros(0, np.intp), *places])
