"""Where the states of some bodies stand in MuJoCo's arrays, worked out once for each selection."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.rotation import rotate
from zensim.sim_server.physics.casting.make import ROOT_VELOCITIES
from zensim.sim_server.physics.casting.seat import Seat
from zensim.sim_server.physics.casting.wishes import Places
from zensim.sim_server.physics.engine import FloatArray

XYZ_XYZW = np.array([0, 1, 2, 4, 5, 6, 3])


@dataclass(frozen=True)
class Gathering:
    """How the state of some bodies is gathered.

    Attributes:
        free: Rows of those whose root moves.
        roots, twists: (f, 7) and (f, 6) places of their roots in qpos and qvel.
        joint_count: Of all bodies, moving or not.
        joints, positions, velocities: Which joints move, and their places in qpos and qvel.
    """

    free: Places
    roots: Places
    twists: Places
    joint_count: int
    joints: Places
    positions: Places
    velocities: Places

    def bases(self, rows: FloatArray, qpos: FloatArray, qvel: FloatArray) -> FloatArray:
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

    def of_joints(self, numbers: FloatArray, places: Places) -> FloatArray:
        """Gather numbers of joints; those that do not move have 0."""
        if len(self.joints) == self.joint_count:
            return np.asarray(numbers[places])
        found = np.zeros(self.joint_count)
        found[self.joints] = numbers[places]
        return found


def gathering_of(seats: Sequence[Seat]) -> Gathering:
    """Work out how the state of bodies is gathered."""
    free = np.array([row for row, seat in enumerate(seats) if seat.is_free], np.intp)
    roots = np.array([seats[row].begins.positions for row in free], np.intp)
    twists = np.array([seats[row].begins.velocities for row in free], np.intp)
    joints, positions, velocities = [], [], []
    first = 0
    for seat in seats:
        moving, place, speed = seat.joints
        joints.append(first + moving)
        positions.append(place)
        velocities.append(speed)
        first += len(seat.layout.velocities)
    return Gathering(
        free,
        roots[:, None] + XYZ_XYZW,
        twists[:, None] + np.arange(ROOT_VELOCITIES),
        first,
        _joined(joints),
        _joined(positions),
        _joined(velocities),
    )


def _joined(parts: Sequence[Places]) -> Places:
    return np.concatenate(parts) if parts else np.zeros(0, np.intp)
