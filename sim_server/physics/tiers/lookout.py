"""Which bodies have something near them that they may touch before the next look. Pure arrays."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.tiers.blocking import from_edges
from zensim.sim_server.physics.tiers.grid import IntArray
from zensim.sim_server.physics.tiers.outline import Edges
from zensim.sim_server.physics.tiers.rows import BoolColumn

NEAR_M = 0.02
"""Discs with a smaller gap are near each other, if any of them moves."""
ALONE_M = 0.06
"""With a larger gap they are alone again."""
MARGIN_M = 2.0 * ALONE_M
MOVING_M_S = 1e-3


@dataclass(frozen=True)
class Discs:
    """Bodies at a look.

    Attributes:
        centres: (n, 2).
        radius: (n,).
        pace: (n,) how fast [m/s] each may be until the next look.
        is_loose: (n,) whether it moves by itself or by others, and cannot be stopped here.
    """

    centres: FloatArray
    radius: FloatArray
    pace: FloatArray
    is_loose: BoolColumn


@dataclass(frozen=True)
class Sight:
    """What a look found, a number each.

    Attributes:
        is_near: Whether it may touch something before the next look.
        is_alone: Whether nothing is anywhere near.
    """

    is_near: BoolColumn
    is_alone: BoolColumn


def look(discs: Discs, pairs: tuple[IntArray, IntArray], period_s: float) -> Sight:
    """See who has others near: at least one of two moves, or is loose."""
    one, other = pairs
    apart = np.hypot(*(discs.centres[one] - discs.centres[other]).T)
    gap = apart - discs.radius[one] - discs.radius[other]
    gap -= (discs.pace[one] + discs.pace[other]) * period_s
    is_moving = (discs.pace > MOVING_M_S) | discs.is_loose
    counts = is_moving[one] | is_moving[other]
    near, close = counts & (gap < NEAR_M), counts & (gap < ALONE_M)
    is_near, is_alone = _nobody(discs), ~_nobody(discs)
    for side in (one, other):
        is_near[side[near]] = True
        is_alone[side[close]] = False
    return Sight(is_near, is_alone)


def look_at_edges(
    discs: Discs, edges: Edges, pairs: tuple[IntArray, IntArray], period_s: float
) -> Sight:
    """See who moves near an edge.

    Args:
        discs: All n.
        edges: All edges.
        pairs: A disc and an edge each, whose heights meet.
        period_s: Until the next look.
    """
    disc, edge = pairs
    _, gap = from_edges(discs.centres[disc], edges.ends[edge])
    gap -= discs.radius[disc] + edges.thick[edge] + discs.pace[disc] * period_s
    counts = discs.pace[disc] > MOVING_M_S
    is_near, is_alone = _nobody(discs), ~_nobody(discs)
    is_near[disc[counts & (gap < NEAR_M)]] = True
    is_alone[disc[counts & (gap < ALONE_M)]] = False
    return Sight(is_near, is_alone)


def both(one: Sight, other: Sight) -> Sight:
    """Put two looks together."""
    return Sight(one.is_near | other.is_near, one.is_alone & other.is_alone)


def _nobody(discs: Discs) -> BoolColumn:
    return np.zeros(len(discs.radius), np.bool_)
