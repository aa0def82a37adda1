"""Where the targets of some bodies go, worked out once for each selection."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.casting.make import NONE
from zensim.sim_server.physics.casting.seat import Seat
from zensim.sim_server.physics.casting.wishes import Places, Wishes
from zensim.sim_server.physics.engine import FloatArray


@dataclass(frozen=True)
class Telling:
    """Which of the numbers that bodies are told go where.

    Attributes:
        speeds, speed_numbers: Places in qvel, and of the numbers that they get.
        angles, angle_numbers: Likewise.
        roots, root_numbers: (t,) and (t, 3) likewise, of roots that a twist moves.
    """

    speeds: Places
    speed_numbers: Places
    angles: Places
    angle_numbers: Places
    roots: Places
    root_numbers: Places

    def tell(self, wishes: Wishes, numbers: FloatArray) -> bool:
        """Set what is wished; return whether a root is moved that was not before."""
        wishes.speeds[self.speeds] = numbers[self.speed_numbers]
        wishes.angles[self.angles] = numbers[self.angle_numbers]
        if not len(self.roots):
            return False
        wishes.twists[self.roots[:, None] + np.arange(3)] = numbers[self.root_numbers]
        is_new = not wishes.is_moved[self.roots].all()
        wishes.is_moved[self.roots] = True
        return is_new


def telling_of(bodies: Iterable[tuple[Seat, Actuation]]) -> Telling:
    """Work out where the numbers go that bodies are told, in order."""
    speeds: list[tuple[int, int]] = []
    angles: list[tuple[int, int]] = []
    roots: list[tuple[int, int]] = []
    first = 0
    for seat, plan in bodies:
        for found, motors in ((speeds, plan.speeds), (angles, plan.angles)):
            for joint, place in zip(motors.joints, motors.places, strict=True):
                if (at := seat.joint_velocity(joint)) != NONE:
                    found.append((at, first + place))
        if plan.twist is not None and seat.is_free:
            roots.append((seat.begins.velocities, first + plan.twist))
        first += plan.width
    (speed, speed_number), (angle, angle_number), (root, root_number) = (
        np.array(pairs, np.intp).reshape(-1, 2).T for pairs in (speeds, angles, roots)
    )
    return Telling(
        speed, speed_number, angle, angle_number, root, root_number[:, None] + np.arange(3)
    )
