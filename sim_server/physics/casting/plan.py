"""Where everything of a cast is, and what is to be set right once MuJoCo has compiled it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.blueprint import Part
from zensim.sim_server.physics.casting.make import Layout, Make, Widths, layout_of
from zensim.sim_server.physics.casting.mjcf import Pieces, geometries_of
from zensim.sim_server.physics.casting.seat import Seat
from zensim.sim_server.physics.casting.slots import Cast
from zensim.sim_server.physics.casting.wishes import Places
from zensim.sim_server.physics.engine import MIN_INERTIA, EngineConfig, FloatArray


@dataclass(frozen=True)
class Plan:
    """Where the slots of a cast are.

    Attributes:
        firsts: Where the first slot of all begins.
        begins: Where the first slot of each make begins.
        layouts: What is where in a slot of each make.
        parts: The part of each geometry of a slot.
    """

    cast: Cast
    firsts: Widths
    begins: Mapping[Make, Widths]
    layouts: Mapping[Make, Layout]
    parts: Mapping[Make, tuple[Part, ...]]

    def seat(self, make: Make, slot: int) -> Seat:
        """Find where a slot is."""
        layout = self.layouts[make]
        return Seat(self.begins[make] + layout.widths.times(slot), layout, not make.is_static)

    def seats(self) -> Iterator[tuple[Make, Seat]]:
        """List all slots."""
        for make, count in self.cast:
            for slot in range(count):
                yield make, self.seat(make, slot)

    def heights(self) -> Places:
        """List where in qpos the heights of all roots are that move."""
        found = [
            self.begins[make].positions + 2 + self.layouts[make].widths.positions * np.arange(count)
            for make, count in self.cast
            if not make.is_static
        ]
        return np.concatenate([np.zeros(0, np.intp), *found])

    def lopsided(self) -> Iterator[tuple[int, FloatArray]]:
        """List bodies with moments that no solid could have: MuJoCo makes others of them."""
        for make, seat in self.seats():
            for link, part in enumerate(make.bones):
                moments = np.maximum(part.inertia, MIN_INERTIA)
                if 2.0 * moments.max() > moments.sum():
                    yield seat.begins.bodies + seat.layout.bodies[link], moments

    def yielding(self) -> Iterator[tuple[int, Part]]:
        """List geometries that are not rigid."""
        for make, seat in self.seats():
            for offset, part in enumerate(self.parts[make]):
                if part.contact.stiffness > 0.0:
                    yield seat.begins.geometries + offset, part


def plan_of(cast: Cast, config: EngineConfig, pieces: Pieces) -> Plan:
    """Find where MuJoCo puts the slots of a cast, by the order of its text."""
    at = firsts = Widths(bodies=1, geometries=int(config.has_ground))
    begins, layouts, parts = {}, {}, {}
    for make, count in cast:
        parts[make] = tuple(geometries_of(make, pieces))
        layouts[make] = layout_of(make, len(parts[make]))
        begins[make] = at
        at += layouts[make].widths.times(count)
    return Plan(cast, firsts, begins, layouts, parts)
