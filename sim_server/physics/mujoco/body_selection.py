"""Where bodies are in the arrays of a compiled model: to read states and write targets."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import rotate
from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.link_forces import LinkForce
from zensim.sim_server.physics.mujoco.slot_layout import (
    NO_INDEX,
    ROOT_QVEL_COUNT,
    Archetype,
    IndexArray,
    SlotAddress,
)
from zensim.sim_server.physics.mujoco.slot_state import ActuatorTargets

QPOS_POSE_ORDER = np.array([0, 1, 2, 4, 5, 6, 3])


@dataclass(frozen=True)
class StateGather:
    """Indexes of the states of a sequence of bodies.

    Attributes:
        free: Rows of the bodies whose root moves.
        roots, twists: (f, 7) and (f, 6) indexes of their roots in qpos and qvel.
        joint_count: Of all bodies, fixed joints included.
        joints, positions, velocities: Joints that move, and their indexes in qpos and qvel.
    """

    free: IndexArray
    roots: IndexArray
    twists: IndexArray
    joint_count: int
    joints: IndexArray
    positions: IndexArray
    velocities: IndexArray

    def read_bases(self, rows: FloatArray, qpos: FloatArray, qvel: FloatArray) -> FloatArray:
        """Write the states of free roots into `rows` (n, 13), which has those of the others."""
        state = qpos[self.roots]
        orientations = state[:, 3:]
        # Norms drift by 1e-15, which arccos turns into an angle of 1e-7.
        orientations /= np.sqrt(np.einsum("ij,ij->i", orientations, orientations))[:, None]
        velocity = qvel[self.twists]
        # Writing a slice is three times faster than writing rows by index.
        free = slice(None) if len(rows) == len(self.free) else self.free
        rows[free, :7] = state
        rows[free, 7:10] = velocity[:, :3]
        rows[free, 10:] = rotate(orientations, velocity[:, 3:])
        return rows

    def gather_joints(self, values: FloatArray, indexes: IndexArray) -> FloatArray:
        """Gather values of joints; 0 for fixed ones."""
        if len(self.joints) == self.joint_count:
            return np.asarray(values[indexes])
        gathered = np.zeros(self.joint_count)
        gathered[self.joints] = values[indexes]
        return gathered


def make_state_gather(addresses: Sequence[SlotAddress]) -> StateGather:
    """Find the state indexes of a sequence of bodies."""
    free = np.array([row for row, address in enumerate(addresses) if address.is_free], np.intp)
    roots = np.array([addresses[row].start.positions for row in free], np.intp)
    twists = np.array([addresses[row].start.velocities for row in free], np.intp)
    joints, positions, velocities = [], [], []
    first = 0
    for address in addresses:
        moving, position, velocity = address.joints
        joints.append(first + moving)
        positions.append(position)
        velocities.append(velocity)
        first += len(address.layout.velocities)
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


@dataclass(frozen=True)
class TargetScatter:
    """Where the targets of a sequence of bodies go.

    Attributes:
        speeds, speed_columns: Indexes in qvel, and of their values in the targets.
        angles, angle_columns: Likewise.
        joints, joint_columns, joint_efforts: Likewise of the kinds of controlled joints, which
            their numbers follow; and their greatest efforts.
        roots, root_columns: (t,) and (t, 3) likewise, of roots with a planar twist.
    """

    speeds: IndexArray
    speed_columns: IndexArray
    angles: IndexArray
    angle_columns: IndexArray
    joints: IndexArray
    joint_columns: IndexArray
    joint_efforts: FloatArray
    roots: IndexArray
    root_columns: IndexArray

    def apply(self, stored: ActuatorTargets, targets: FloatArray) -> bool:
        """Store targets; return whether motors change their mode, or a root gets a twist."""
        stored.speeds[self.speeds] = targets[self.speed_columns]
        stored.angles[self.angles] = targets[self.angle_columns]
        is_new = self._store_joints(stored, targets) if len(self.joints) else False
        if not len(self.roots):
            return is_new
        stored.twists[self.roots[:, None] + np.arange(3)] = targets[self.root_columns]
        is_new |= not stored.is_twist_imposed[self.roots].all()
        stored.is_twist_imposed[self.roots] = True
        return is_new

    def _store_joints(self, stored: ActuatorTargets, targets: FloatArray) -> bool:
        """Store the targets of controlled joints; return whether a kind has changed."""
        joints, most = self.joints, self.joint_efforts
        kinds, numbers = targets[self.joint_columns], targets[self.joint_columns + 1]
        is_new = bool((stored.kinds[joints] != kinds).any())
        stored.kinds[joints] = kinds
        stored.angles[joints] = np.where(kinds == JointTargetKind.POSITION, numbers, 0.0)
        stored.speeds[joints] = np.where(kinds == JointTargetKind.VELOCITY, numbers, 0.0)
        pushed = np.where(kinds == JointTargetKind.EFFORT, numbers, 0.0)
        stored.efforts[joints] = np.clip(pushed, -most, most)
        return is_new


def make_target_scatter(bodies: Iterable[tuple[SlotAddress, Actuation]]) -> TargetScatter:
    """Find the indexes for the targets of a sequence of bodies."""
    speeds: list[tuple[int, int]] = []
    angles: list[tuple[int, int]] = []
    joints: list[tuple[int, int]] = []
    efforts: list[float] = []
    roots: list[tuple[int, int]] = []
    first = 0
    for address, actuation in bodies:
        for pairs, motors in ((speeds, actuation.speeds), (angles, actuation.angles)):
            for joint, column in zip(motors.joints, motors.columns, strict=True):
                if (index := address.joint_velocity(joint)) != NO_INDEX:
                    pairs.append((index, first + column))
        for motor in actuation.joint_motors:
            if (index := address.joint_velocity(motor.joint)) != NO_INDEX:
                joints.append((index, first + motor.column))
                efforts.append(motor.effort)
        if actuation.twist is not None and address.is_free:
            roots.append((address.start.velocities, first + actuation.twist))
        first += actuation.width
    speed, angle, joint, root = (
        np.array(pairs, np.intp).reshape(-1, 2).T for pairs in (speeds, angles, joints, roots)
    )
    root_columns = root[1][:, None] + np.arange(3)
    return TargetScatter(
        *(speed[0], speed[1], angle[0], angle[1]),
        *(joint[0], joint[1], np.array(efforts), root[0], root_columns),
    )


@dataclass
class MujocoBody:
    """A body in MuJoCo.

    Attributes:
        slot: Its slot among those of its archetype.
        fixed_state: State (13,) to read when MuJoCo has none: of a static or diverged body.
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
    """Indexes to read and command a sequence of bodies."""

    gather: StateGather
    scatter: TargetScatter
    static_bodies: tuple[tuple[int, MujocoBody], ...]
    """Static bodies by row."""

    def read_bases(self, qpos: FloatArray, qvel: FloatArray) -> FloatArray:
        """Read states (n, 13)."""
        rows = np.empty((len(self.gather.free) + len(self.static_bodies), 13))
        for row, body in self.static_bodies:
            rows[row] = body.fixed_state
        return self.gather.read_bases(rows, qpos, qvel)


def make_body_selection(bodies: Sequence[MujocoBody]) -> BodySelection:
    """Find the indexes of a sequence of bodies."""
    return BodySelection(
        make_state_gather([body.address for body in bodies]),
        make_target_scatter((body.address, body.actuation) for body in bodies),
        tuple((row, body) for row, body in enumerate(bodies) if body.archetype.is_static),
    )
