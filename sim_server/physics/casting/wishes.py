"""What bodies are told to do, an entry for each of MuJoCo's degrees of freedom."""

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.engine import FloatArray

Places = npt.NDArray[np.intp]

ANGLE_SHARE = 0.1
"""Of its error, that a motor which holds an angle mends in a step; Bullet's own share."""


@dataclass(frozen=True)
class Wishes:
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
    is_moved: npt.NDArray[np.bool_]

    def moved(self, old: Places, new: Places, count: int) -> "Wishes":
        """Move entries from places to places of another cast that has so many."""
        found = no_wishes(count)
        for field in fields(self):
            getattr(found, field.name)[new] = getattr(self, field.name)[old]
        return found

    def forget(self, places: Places) -> None:
        """Wish nothing any more."""
        for field in fields(self):
            getattr(self, field.name)[places] = 0


def no_wishes(count: int) -> Wishes:
    """Make entries for so many degrees of freedom that wish nothing."""
    return Wishes(
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, dtype=np.bool_),
        np.zeros(count),
        np.zeros(count, dtype=np.bool_),
    )
