"""Targets per MuJoCo degree of freedom, and the scatter of bodies' targets into them."""

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.mujoco.slot_layout import NO_INDEX, IndexArray, SlotAddress

POSITION_ERP = 0.1
"""Of its error, that a motor which holds an angle mends in a step; Bullet's own share."""


@dataclass(frozen=True)
class ActuatorTargets:
    """Targets of motors and of roots.

    Attributes:
        speeds: What each motor is to reach [rad/s or m/s].
        angles: Where each motor is to hold its joint [rad or m].
        holds: Whether it holds an angle.
        twists: vx, vy and wz at the first three of a root that a twist moves.
        is_moved: Whether a twist moves the root that begins here.
    """

    speeds: FloatArray
    angles: FloatArray
    holds: npt.NDArray[np.bool_]
    twists: FloatArray
    is_twist_imposed: npt.NDArray[np.bool_]

    def remap(self, old: IndexArray, new: IndexArray, count: int) -> "ActuatorTargets":
        """Move entries from places to places of another cast that has so many."""
        found = make_zero_targets(count)
        for field in fields(self):
            getattr(found, field.name)[new] = getattr(self, field.name)[old]
        return found

    def clear(self, places: IndexArray) -> None:
        """Wish nothing any more."""
        for field in fields(self):
            getattr(self, field.name)[places] = 0


def make_zero_targets(count: int) -> ActuatorTargets:
    """Make entries for so many degrees of freedom that wish nothing."""
    return ActuatorTargets(
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, dtype=np.bool_),
        np.zeros(count),
        np.zeros(count, dtype=np.bool_),
    )


@dataclass(frozen=True)
class TargetScatter:
    """Which of the numbers that bodies are told go where.

    Attributes:
        speeds, speed_numbers: Places in qvel, and of the numbers that they get.
        angles, angle_numbers: Likewise.
        roots, root_numbers: (t,) and (t, 3) likewise, of roots that a twist moves.
    """

    speeds: IndexArray
    speed_numbers: IndexArray
    angles: IndexArray
    angle_numbers: IndexArray
    roots: IndexArray
    root_numbers: IndexArray

    def apply(self, wishes: ActuatorTargets, numbers: FloatArray) -> bool:
        """Set what is wished; return whether a root is moved that was not before."""
        wishes.speeds[self.speeds] = numbers[self.speed_numbers]
        wishes.angles[self.angles] = numbers[self.angle_numbers]
        if not len(self.roots):
            return False
        wishes.twists[self.roots[:, None] + np.arange(3)] = numbers[self.root_numbers]
        is_new = not wishes.is_twist_imposed[self.roots].all()
        wishes.is_twist_imposed[self.roots] = True
        return is_new


def make_target_scatter(bodies: Iterable[tuple[SlotAddress, Actuation]]) -> TargetScatter:
    """Work out where the numbers go that bodies are told, in order."""
    speeds: list[tuple[int, int]] = []
    angles: list[tuple[int, int]] = []
    roots: list[tuple[int, int]] = []
    first = 0
    for seat, plan in bodies:
        for found, motors in ((speeds, plan.speeds), (angles, plan.angles)):
            for joint, place in zip(motors.joints, motors.columns, strict=True):
                if (at := seat.joint_velocity(joint)) != NO_INDEX:
                    found.append((at, first + place))
        if plan.twist is not None and seat.is_free:
            roots.append((seat.start.velocities, first + plan.twist))
        first += plan.width
    (speed, speed_number), (angle, angle_number), (root, root_number) = (
        np.array(pairs, np.intp).reshape(-1, 2).T for pairs in (speeds, angles, roots)
    )
    return TargetScatter(
        speed, speed_number, angle, angle_number, root, root_number[:, None] + np.arange(3)
    )
