"""Where one body's slot begins, and what is in it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zensim.sim_server.physics.casting.make import NONE, Layout, Widths
from zensim.sim_server.physics.casting.wishes import Places


@dataclass(frozen=True)
class Seat:
    """A slot of a cast."""

    begins: Widths
    layout: Layout
    is_free: bool
    """It has a root that moves."""

    @cached_property
    def positions(self) -> Places:
        """All places in qpos."""
        first = self.begins.positions
        return np.arange(first, first + self.layout.widths.positions)

    @cached_property
    def velocities(self) -> Places:
        """All places in qvel."""
        first = self.begins.velocities
        return np.arange(first, first + self.layout.widths.velocities)

    @cached_property
    def bodies(self) -> Places:
        """All of its bodies."""
        first = self.begins.bodies
        return np.arange(first, first + self.layout.widths.bodies)

    @cached_property
    def geometries(self) -> Places:
        """All of its geometries."""
        first = self.begins.geometries
        return np.arange(first, first + self.layout.widths.geometries)

    @cached_property
    def equalities(self) -> Places:
        """All of its equalities."""
        first = self.begins.equalities
        return np.arange(first, first + self.layout.widths.equalities)

    def joint_velocity(self, joint: int) -> int:
        """Find a joint's place in qvel; NONE where it does not move."""
        offset = self.layout.velocities[joint]
        return NONE if offset == NONE else self.begins.velocities + offset

    @cached_property
    def joints(self) -> tuple[Places, Places, Places]:
        """Find the joints that move, by their places in the model, in qpos and in qvel."""
        moving = np.array([i for i, at in enumerate(self.layout.velocities) if at != NONE], np.intp)
        positions = np.array(self.layout.positions, np.intp)[moving]
        velocities = np.array(self.layout.velocities, np.intp)[moving]
        return moving, self.begins.positions + positions, self.begins.velocities + velocities
