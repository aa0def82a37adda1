"""Index arrays to read the states and set the targets of a sequence of bodies."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import rotate
from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.link_forces import LinkForce
from zensim.sim_server.physics.mujoco.actuator_targets import TargetScatter, make_target_scatter
from zensim.sim_server.physics.mujoco.slot_layout import (
    ROOT_QVEL_COUNT,
    Archetype,
    IndexArray,
    SlotAddress,
)

QPOS_POSE_ORDER = np.array([0, 1, 2, 4, 5, 6, 3])


@dataclass(frozen=True)
class StateGather:
    """How the state of some bodies is gathered.

    Attributes:
        free: Rows of those whose root moves.
        roots, twists: (f, 7) and (f, 6) places of their roots in qpos and qvel.
        joint_count: Of all bodies, moving or not.
        joints, positions, velocities: Which joints move, and their places in qpos and qvel.
    """

    free: IndexArray
    roots: IndexArray
    twists: IndexArray
    joint_count: int
    joints: IndexArray
    positions: IndexArray
    velocities: IndexArray

    def read_bases(self, rows: FloatArray, qpos: FloatArray, qvel: FloatArray) -> FloatArray:
        """Fill in the states (n, 13) of what is free; `rows` has those of the others."""
        state = qpos[self.roots]
        turns = state[:, 3:]
        # MuJoCo lets lengths drift by 1e-15, which is an angle of 1e-7 by its cosine.
        turns /= np.sqrt(np.einsum("ij,ij->i", turns, turns))[:, None]
        velocity = qvel[self.twists]
        # A slice is written thrice as fast as rows by number.
        free = slice(None) if len(rows) == len(self.free) else self.free
        rows[free, :7] = state
        rows[free, 7:10] = velocity[:, :3]
        rows[free, 10:] = rotate(turns, velocity[:, 3:])
        return rows

    def gather_joints(self, numbers: FloatArray, places: IndexArray) -> FloatArray:
        """Gather numbers of joints; those that do not move have 0."""
        if len(self.joints) == self.joint_count:
            return np.asarray(numbers[places])
        found = np.zeros(self.joint_count)
        found[self.joints] = numbers[places]
        return found


def make_state_gather(seats: Sequence[SlotAddress]) -> StateGather:
    """Work out how the state of bodies is gathered."""
    free = np.array([row for row, seat in enumerate(seats) if seat.is_free], np.intp)
    roots = np.array([seats[row].start.positions for row in free], np.intp)
    twists = np.array([seats[row].start.velocities for row in free], np.intp)
    joints, positions, velocities = [], [], []
    first = 0
    for seat in seats:
        moving, place, speed = seat.joints
        joints.append(first + moving)
        positions.append(place)
        velocities.append(speed)
        first += len(seat.layout.velocities)
    return StateGather(
        free,
        roots[:, None] + QPOS_POSE_ORDER,
        twists[:, None] + np.arange(ROOT_QVEL_COUNT),
        first,
        _concatenate_indexes(joints),
        _concatenate_indexes(positions),
        _concatenate_indexes(velocities),
    )


def _concatenate_indexes(parts: Sequence[IndexArray]) -> IndexArray:
    return np.concatenate(parts) if parts else np.zeros(0, np.intp)


@dataclass
class MujocoBody:
    """What the engine knows of a body.

    Attributes:
        slot: Its number among those of its make.
        stand: State (13,) that it reads as where that is not MuJoCo's: when static, or broken.
    """

    model: Model
    archetype: Archetype
    slot: int
    address: SlotAddress
    actuation: Actuation
    loads: Sequence[LinkForce]
    fixed_state: FloatArray | None = None


@dataclass(frozen=True)
class BodySelection:
    """How some bodies are read and told."""

    gather: StateGather
    scatter: TargetScatter
    static_bodies: tuple[tuple[int, MujocoBody], ...]
    """Rows of what is static."""

    def read_bases(self, qpos: FloatArray, qvel: FloatArray) -> FloatArray:
        """Read states (n, 13)."""
        rows = np.empty((len(self.gather.free) + len(self.static_bodies), 13))
        for row, body in self.static_bodies:
            rows[row] = body.fixed_state
        return self.gather.read_bases(rows, qpos, qvel)


def make_body_selection(bodies: Sequence[MujocoBody]) -> BodySelection:
    """Work out how bodies are read and told."""
    return BodySelection(
        make_state_gather([body.address for body in bodies]),
        make_target_scatter((body.address, body.actuation) for body in bodies),
        tuple((row, body) for row, body in enumerate(bodies) if body.archetype.is_static),
    )
