"""What a step has to do beside MuJoCo for the bodies that are there: motors, twists and loads."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from zensim.proto.rotation import conjugate, rotate
from zensim.sim_server.physics.actuation import imposed
from zensim.sim_server.physics.casting.gathering import Gathering, gathering_of
from zensim.sim_server.physics.casting.pulls import Pulls, pulls_of
from zensim.sim_server.physics.casting.selection import Body
from zensim.sim_server.physics.casting.wishes import ANGLE_SHARE, Places, Wishes
from zensim.sim_server.physics.engine import FloatArray


@dataclass(frozen=True)
class Stock:
    """Who is driven, moved and pulled.

    Attributes:
        motors: Places in qvel of what has friction, in the order of MuJoCo's rows.
        holders, held: Which of them hold an angle, and their places in qpos.
        moved: Roots that a twist moves.
        pulls: What acts on links that are weightless, or slow down.
    """

    motors: Places
    holders: Places
    held: Places
    moved: Gathering
    pulls: Pulls

    def speeds(self, wishes: Wishes, qpos: FloatArray, dt_s: float) -> FloatArray:
        """Find the speed that each motor is to reach in this step; what only rubs has 0."""
        found = wishes.speeds[self.motors]
        if len(self.holders):
            errors = wishes.angles[self.motors[self.holders]] - qpos[self.held]
            found[self.holders] = ANGLE_SHARE / dt_s * errors
        return found

    def impose(self, wishes: Wishes, qpos: FloatArray, qvel: FloatArray) -> None:
        """Let roots go in the plane as they are told; changes `qvel`."""
        rows = self.moved.bases(np.empty((len(self.moved.free), 13)), qpos, qvel)
        places = self.moved.twists
        twists = wishes.twists[places[:, :3]]
        found = imposed(rows[:, 7:], rows[:, 3:7], np.zeros((len(rows), 3)), twists)
        qvel[places[:, :3]] = found[:, :3]
        qvel[places[:, 3:]] = rotate(conjugate(rows[:, 3:7]), found[:, 3:])


def stock_of(bodies: Iterable[Body], wishes: Wishes, friction: FloatArray, places: Places) -> Stock:
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
    free = [body.seat for body in bodies if body.seat.is_free]
    return Stock(
        motors,
        holders,
        places[motors[holders]],
        gathering_of([seat for seat in free if wishes.is_moved[seat.begins.velocities]]),
        pulls_of(
            (body.seat.begins.bodies + body.seat.layout.bodies[load.part + 1], load)
            for body in bodies
            for load in body.loads
        ),
    )
