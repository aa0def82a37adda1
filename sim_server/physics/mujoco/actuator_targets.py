"""Targets per MuJoCo degree of freedom, and the scatter of bodies' targets into them."""

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.mujoco.slot_layout import NO_INDEX, IndexArray, SlotAddress

POSITION_ERP = 0.1
"""Share of its error that a position motor corrects in a step; Bullet's default."""


@dataclass(frozen=True)
class ActuatorTargets:
    """Targets, an entry for each degree of freedom.

    Attributes:
        speeds: Of a velocity motor [rad/s or m/s].
        angles: Of a position motor [rad or m].
        holds: Whether it is a position motor.
        twists: vx, vy and wz at the first three of a root with a planar twist.
        is_twist_imposed: At the first of a root: whether its twist is imposed.
    """

    speeds: FloatArray
    angles: FloatArray
    holds: npt.NDArray[np.bool_]
    twists: FloatArray
    is_twist_imposed: npt.NDArray[np.bool_]

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
    )


@dataclass(frozen=True)
class TargetScatter:
    """Where the targets of a sequence of bodies go.

    Attributes:
        speeds, speed_columns: Indexes in qvel, and of their values in the targets.
        angles, angle_columns: Likewise.
        roots, root_columns: (t,) and (t, 3) likewise, of roots with a planar twist.
    """

    speeds: IndexArray
    speed_columns: IndexArray
    angles: IndexArray
    angle_columns: IndexArray
    roots: IndexArray
    root_columns: IndexArray

    def apply(self, stored: ActuatorTargets, targets: FloatArray) -> bool:
        """Store targets; return whether a twist is imposed on a root that had none."""
        stored.speeds[self.speeds] = targets[self.speed_columns]
        stored.angles[self.angles] = targets[self.angle_columns]
        if not len(self.roots):
            return False
        stored.twists[self.roots[:, None] + np.arange(3)] = targets[self.root_columns]
        is_new = not stored.is_twist_imposed[self.roots].all()
        stored.is_twist_imposed[self.roots] = True
        return is_new


def make_target_scatter(bodies: Iterable[tuple[SlotAddress, Actuation]]) -> TargetScatter:
    """Find the indexes for the targets of a sequence of bodies."""
    speeds: list[tuple[int, int]] = []
    angles: list[tuple[int, int]] = []
    roots: list[tuple[int, int]] = []
    first = 0
    for address, actuation in bodies:
        for pairs, motors in ((speeds, actuation.speeds), (angles, actuation.angles)):
            for joint, column in zip(motors.joints, motors.columns, strict=True):
                if (index := address.joint_velocity(joint)) != NO_INDEX:
                    pairs.append((index, first + column))
        if actuation.twist is not None and address.is_free:
            roots.append((address.start.velocities, first + actuation.twist))
        first += actuation.width
    (speed, speed_column), (angle, angle_column), (root, root_column) = (
        np.array(pairs, np.intp).reshape(-1, 2).T for pairs in (speeds, angles, roots)
    )
    return TargetScatter(
        speed, speed_column, angle, angle_column, root, root_column[:, None] + np.arange(3)
    )
