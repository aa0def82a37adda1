"""Which bodies may touch before the next look, as far as speeds can tell."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.clusters.discs import IntArray, labels_of, touching
from zensim.sim_server.physics.engine import FloatArray

MARGIN_M = 0.02
"""Between bodies of different cells at the least."""
SPARE_MPS = 2.0
"""What a body may gain in speed by its motors, or by being hit, before the next look."""


@dataclass(frozen=True)
class Parting:
    """Bodies in groups that cannot touch each other for some time.

    Attributes:
        groups: (n,) by number, from 0.
        speeds: (n,) how fast each may be for that [m/s].
        periods: For how many periods it holds.
    """

    groups: IntArray
    speeds: FloatArray
    periods: int

    @property
    def largest(self) -> int:
        """How many bodies the largest group has."""
        return int(np.bincount(self.groups).max(initial=0))


def part(
    places: FloatArray, radii: FloatArray, speeds: FloatArray, period_s: float, *, periods: int
) -> Parting:
    """Put bodies that may touch within some periods into one group.

    Args:
        places: (n, 2); what is not finite is a group of its own.
        radii: (n,) that bodies have [m].
        speeds: (n,) at most, unless others hit them.
        period_s: Length of a period.
        periods: How many.
    """
    is_somewhere = np.isfinite(places).all(axis=1) & np.isfinite(radii) & np.isfinite(speeds)
    known = np.flatnonzero(is_somewhere)
    bounds = speeds.copy()
    groups = np.zeros(0, np.intp)
    while True:
        swept = radii[known] + bounds[known] * (period_s * periods) + MARGIN_M / 2.0
        groups = labels_of(len(known), *touching(places[known], swept))
        raised = _as_fast_as_the_fastest(bounds[known], groups)
        if (raised <= bounds[known]).all():
            break
        bounds[known] = raised
    found = np.zeros(len(places), np.intp)
    found[known] = groups
    lost = np.flatnonzero(~is_somewhere)
    found[lost] = int(groups.max(initial=-1)) + 1 + np.arange(len(lost))
    return Parting(found, bounds, periods)


def _as_fast_as_the_fastest(speeds: FloatArray, groups: IntArray) -> FloatArray:
    """What a group's fastest hits goes as fast at most, but for what each has to spare anyway."""
    fastest = np.zeros(int(groups.max(initial=-1)) + 1)
    np.maximum.at(fastest, groups, speeds)
    return np.maximum(speeds, fastest[groups] - SPARE_MPS / 2.0)
