"""Finds entities that have left the world: they fall, and nothing is below them."""

from collections.abc import Sequence

import numpy as np

from zensim.sim_server.physics.engine import FloatArray

FALL_SPEED_MPS = 15.0
"""Speed down from which an entity falls without end: that of a fall of 11 m."""
FALL_DEPTH_M = 10.0
"""Least depth below its initial pose."""
CHECK_PERIOD_NS = 500_000_000


class FallWatch:
    """The entities that fall out of the world."""

    def __init__(self) -> None:
        self.falling: set[str] = set()

    def update(
        self, names: Sequence[str], base: FloatArray, initial_z: FloatArray
    ) -> tuple[str, ...]:
        """Compare states (n, 13) with the initial heights (n,); name those that fall since now."""
        is_falling = (base[:, 9] < -FALL_SPEED_MPS) & (base[:, 2] < initial_z - FALL_DEPTH_M)
        found = {names[row] for row in np.flatnonzero(is_falling).tolist()}
        new = found - self.falling
        self.falling = found
        return tuple(sorted(new))
