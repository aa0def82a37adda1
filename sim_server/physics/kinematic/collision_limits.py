"""Limit motions of discs so that they stop before other discs and before edges."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import IntArray

STOPPING_GAP_M = 0.001
"""Distance at which discs stop."""
RELATIVE_TOLERANCE = 1e-9
ROUNDS_UNTIL_STOP = 4
"""Rounds of shortening after which discs in conflict stand still."""
NO_INDICES, NO_FRACTIONS = np.zeros(0, np.intp), np.zeros(0)
MAX_ADVANCES = 12
"""Iterations towards an edge per step of the engine."""


@dataclass(frozen=True)
class DiscMotions:
    """Proposed motions of n discs.

    Attributes:
        start: (n, 2) centres.
        way: (n, 2) displacements.
        radius: (n,).
        bend: (n,) bound of the distance [m] of the path from the straight line.
        reach: (n,) bound of the distance [m] from the centre that the disc covers, with the gap.
        may_stop: (n,) whether it can be stopped.
    """

    start: FloatArray
    way: FloatArray
    radius: FloatArray
    bend: FloatArray
    reach: FloatArray
    may_stop: np.ndarray[tuple[int], np.dtype[np.bool_]]


def dot_rows(one: FloatArray, other: FloatArray) -> FloatArray:
    """Multiply vectors (n, 2) pair by pair: a product (n,) never depends on the other rows."""
    return one[:, 0] * other[:, 0] + one[:, 1] * other[:, 1]


def limit_by_edges(
    moves: DiscMotions, disc: IntArray, ends: FloatArray, thick: FloatArray
) -> FloatArray:
    """Find the fractions (n,) of displacements at which discs stop before edges.

    Args:
        moves: All n discs.
        disc: (k,) disc of each pair of a disc and an edge.
        ends: (k, 4) of the edges.
        thick: (k,) radii of the edges.
    """
    fractions: FloatArray = np.ones(len(moves.radius))
    if not len(disc):
        return fractions
    start, way = moves.start[disc], moves.way[disc]
    length = np.hypot(way[:, 0], way[:, 1])
    away, apart = find_distances_to_edges(start, ends)
    towards = dot_rows(way, away)
    kept = moves.radius[disc] + thick + STOPPING_GAP_M
    bend = moves.bend[disc]
    goes = (
        (towards < -RELATIVE_TOLERANCE * length) & (length > 0.0) & (apart - length < kept + bend)
    )
    if not goes.any():
        return fractions
    part = _advance_conservatively(
        start[goes], way[goes], ends[goes], np.minimum(kept, apart)[goes]
    )
    is_curved = (bend[goes] > STOPPING_GAP_M / 2.0) & (part < 1.0)
    np.minimum.at(fractions, disc[goes], np.where(is_curved, 0.0, part))
    return fractions


def _advance_conservatively(
    start: FloatArray, way: FloatArray, ends: FloatArray, kept: FloatArray
) -> FloatArray:
    """Advance repeatedly by the distance that is free; return the fractions."""
    length = np.hypot(way[:, 0], way[:, 1])
    fraction = np.zeros(len(start))
    for _ in range(MAX_ADVANCES):
        _, apart = find_distances_to_edges(start + way * fraction[:, None], ends)
        fraction = np.minimum(1.0, fraction + np.maximum(apart - kept, 0.0) / length)
    return fraction


def find_distances_to_edges(points: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the unit vectors (k, 2) from edges to points, and the distances (k,)."""
    first, along = ends[:, :2], ends[:, 2:] - ends[:, :2]
    from_first = points - first
    square = dot_rows(along, along)
    fraction = dot_rows(from_first, along) / np.where(square > 0.0, square, 1.0)
    away = from_first - along * np.clip(fraction, 0.0, 1.0)[:, None]
    apart = np.hypot(away[:, 0], away[:, 1])
    return away / np.where(apart > 0.0, apart, 1.0)[:, None], apart


def limit_by_other_discs(
    moves: DiscMotions, one: IntArray, other: IntArray, fractions: FloatArray
) -> FloatArray:
    """Shorten fractions (n,) until no two discs come too near.

    Only a disc that moves towards another is stopped, so that a follower does not stop its leader.
    Discs that overlap at the start may separate, but not come nearer.

    Args:
        moves: All n discs.
        one: (k,) of each pair that may meet.
        other: (k,) likewise.
        fractions: (n,) fractions allowed for other reasons.
    """
    fractions = fractions.copy()
    near = _list_near_pairs(moves, one, other)
    if not len(near.one):
        return fractions
    for last in range(len(moves.radius) + ROUNDS_UNTIL_STOP):
        way = moves.way if fractions.min() >= 1.0 else moves.way * fractions[:, None]
        stopped, part = _find_collisions(moves, way, near)
        if not len(stopped):
            return fractions
        if last >= ROUNDS_UNTIL_STOP:
            part = np.zeros_like(part)
        np.minimum.at(fractions, stopped, fractions[stopped] * part)
    return fractions


@dataclass(frozen=True)
class _NearPairs:
    """Pairs (k,) of discs that may meet, `apart` (k, 2), at a distance of the root of `square`."""

    one: IntArray
    other: IntArray
    apart: FloatArray
    square: FloatArray


def _list_near_pairs(moves: DiscMotions, one: IntArray, other: IntArray) -> _NearPairs:
    x, y = np.ascontiguousarray(moves.start.T)
    ahead, aside = x[other] - x[one], y[other] - y[one]
    square = ahead * ahead + aside * aside
    within = moves.reach[one] + moves.reach[other]
    near = np.flatnonzero(square < within * within)
    apart = np.stack([ahead[near], aside[near]], axis=1)
    return _NearPairs(one[near], other[near], apart, square[near])


def _find_collisions(
    moves: DiscMotions, way: FloatArray, near: _NearPairs
) -> tuple[IntArray, FloatArray]:
    """Find the discs that run into others, and the fractions of their way until then."""
    one, other, apart, square = near.one, near.other, near.apart, near.square
    closing = way.take(other, axis=0) - way.take(one, axis=0)
    b = dot_rows(apart, closing)
    a = dot_rows(closing, closing)
    total = moves.radius[one] + moves.radius[other] + STOPPING_GAP_M
    bend = moves.bend[one] + moves.bend[other]
    is_curved = bend > STOPPING_GAP_M / 2.0
    kept = np.minimum(total * total, square)
    wide = np.where(is_curved, (total + bend) ** 2, kept)
    passing = square - b * b / np.where(a > 0.0, a, 1.0)
    nearest = np.where(-b > a, square + 2.0 * b + a, passing)
    meet = (b < -RELATIVE_TOLERANCE * np.sqrt(a * square)) & (
        nearest < wide - RELATIVE_TOLERANCE * total * total
    )
    if not meet.any():
        return NO_INDICES, NO_FRACTIONS
    a, b, c = a[meet], b[meet], (square - kept)[meet]
    fraction = (-b - np.sqrt(np.maximum(b * b - a * c, 0.0))) / a
    fraction = np.where(
        is_curved[meet], 0.0, np.clip(fraction * (1.0 - RELATIVE_TOLERANCE), 0.0, 1.0)
    )
    return _limit_approaching(moves, way, (one[meet], other[meet]), apart[meet], fraction)


def _limit_approaching(
    moves: DiscMotions,
    way: FloatArray,
    pairs: tuple[IntArray, IntArray],
    apart: FloatArray,
    fraction: FloatArray,
) -> tuple[IntArray, FloatArray]:
    one, other = pairs
    is_one = (dot_rows(way[one], apart) > 0.0) & moves.may_stop[one]
    is_other = (dot_rows(way[other], apart) < 0.0) & moves.may_stop[other]
    return (
        np.concatenate([one[is_one], other[is_other]]),
        np.concatenate([fraction[is_one], fraction[is_other]]),
    )
