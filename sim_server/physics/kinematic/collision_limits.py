"""Limit motions of discs so that they stop before other discs and before edges."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import IntArray

STOPPING_GAP_M = 0.001
"""How far apart things stop."""
RELATIVE_TOLERANCE = 1e-9
ROUNDS_UNTIL_STOP = 4
"""After so many, who still is in the way of another stands."""
NO_INDICES, NO_FRACTIONS = np.zeros(0, np.intp), np.zeros(0)
MAX_ADVANCES = 12
"""Steps towards an edge; what has not arrived by then waits for the next time."""


@dataclass(frozen=True)
class DiscMotions:
    """Discs and where they want to go.

    Attributes:
        start: (n, 2) their centres.
        way: (n, 2) from there.
        radius: (n,).
        bend: (n,) how far [m] the true path leaves the straight one at most.
        reach: (n,) how far [m] from its centre a disc gets, the gap included.
        may_stop: (n,) whether it can be stopped here.
    """

    start: FloatArray
    way: FloatArray
    radius: FloatArray
    bend: FloatArray
    reach: FloatArray
    may_stop: np.ndarray[tuple[int], np.dtype[np.bool_]]


def limit_by_edges(
    moves: DiscMotions, disc: IntArray, ends: FloatArray, thick: FloatArray
) -> FloatArray:
    """Find how far each disc may go for the edges near it.

    Args:
        moves: All n discs.
        disc: (k,) which disc stands before which edge.
        ends: (k, 4) those edges.
        thick: (k,) their radii.

    Returns:
        Shares (n,).
    """
    shares: FloatArray = np.ones(len(moves.radius))
    if not len(disc):
        return shares
    start, way = moves.start[disc], moves.way[disc]
    length = np.hypot(way[:, 0], way[:, 1])
    away, apart = find_distances_to_edges(start, ends)
    towards = np.einsum("ij,ij->i", way, away)
    kept = moves.radius[disc] + thick + STOPPING_GAP_M
    bend = moves.bend[disc]
    goes = (
        (towards < -RELATIVE_TOLERANCE * length) & (length > 0.0) & (apart - length < kept + bend)
    )
    if not goes.any():
        return shares
    part = _advance_conservatively(
        start[goes], way[goes], ends[goes], np.minimum(kept, apart)[goes]
    )
    is_wild = (bend[goes] > STOPPING_GAP_M / 2.0) & (part < 1.0)
    np.minimum.at(shares, disc[goes], np.where(is_wild, 0.0, part))
    return shares


def _advance_conservatively(
    start: FloatArray, way: FloatArray, ends: FloatArray, kept: FloatArray
) -> FloatArray:
    """Go on by the distance that is free for certain, until none is left."""
    length = np.hypot(way[:, 0], way[:, 1])
    share = np.zeros(len(start))
    for _ in range(MAX_ADVANCES):
        _, apart = find_distances_to_edges(start + way * share[:, None], ends)
        share = np.minimum(1.0, share + np.maximum(apart - kept, 0.0) / length)
    return share


def find_distances_to_edges(points: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the unit vectors (k, 2) from edges to points, and how far apart they are (k,)."""
    first, along = ends[:, :2], ends[:, 2:] - ends[:, :2]
    from_first = points - first
    square = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", from_first, along) / np.where(square > 0.0, square, 1.0)
    away = from_first - along * np.clip(share, 0.0, 1.0)[:, None]
    apart = np.hypot(away[:, 0], away[:, 1])
    return away / np.where(apart > 0.0, apart, 1.0)[:, None], apart


def limit_by_other_discs(
    moves: DiscMotions, one: IntArray, other: IntArray, shares: FloatArray
) -> FloatArray:
    """Shorten shares (n,) until no two discs come nearer than they may.

    Only who goes towards another is shortened, so that a follower does not stop its leader. What
    overlaps from the start may part, and comes no nearer.

    Args:
        moves: All n discs.
        one: (k,) of each pair that may meet.
        other: (k,) likewise.
        shares: How far they may go for other reasons.
    """
    shares = shares.copy()
    for last in range(len(moves.radius) + ROUNDS_UNTIL_STOP):
        way = moves.way if shares.min() >= 1.0 else moves.way * shares[:, None]
        blamed, part = _find_collisions(moves, way, one, other)
        if not len(blamed):
            return shares
        if last >= ROUNDS_UNTIL_STOP:
            part = np.zeros_like(part)
        np.minimum.at(shares, blamed, shares[blamed] * part)
    return shares


def _find_collisions(
    moves: DiscMotions, way: FloatArray, one: IntArray, other: IntArray
) -> tuple[IntArray, FloatArray]:
    """Name those who run into another, and the share of their way until then."""
    apart = moves.start.take(other, axis=0) - moves.start.take(one, axis=0)
    square = np.einsum("ij,ij->i", apart, apart)
    within = moves.reach[one] + moves.reach[other]
    near = np.flatnonzero(square < within * within)
    if not len(near):
        return NO_INDICES, NO_FRACTIONS
    one, other, apart, square = one[near], other[near], apart[near], square[near]
    closing = way.take(other, axis=0) - way.take(one, axis=0)
    b = np.einsum("ij,ij->i", apart, closing)
    a = np.einsum("ij,ij->i", closing, closing)
    total = moves.radius[one] + moves.radius[other] + STOPPING_GAP_M
    bend = moves.bend[one] + moves.bend[other]
    is_wild = bend > STOPPING_GAP_M / 2.0
    kept = np.minimum(total * total, square)
    wide = np.where(is_wild, (total + bend) ** 2, kept)
    passing = square - b * b / np.where(a > 0.0, a, 1.0)
    nearest = np.where(-b > a, square + 2.0 * b + a, passing)
    meet = (b < -RELATIVE_TOLERANCE * np.sqrt(a * square)) & (
        nearest < wide - RELATIVE_TOLERANCE * total * total
    )
    if not meet.any():
        return NO_INDICES, NO_FRACTIONS
    a, b, c = a[meet], b[meet], (square - kept)[meet]
    share = (-b - np.sqrt(np.maximum(b * b - a * c, 0.0))) / a
    share = np.where(is_wild[meet], 0.0, np.clip(share * (1.0 - RELATIVE_TOLERANCE), 0.0, 1.0))
    return _limit_approaching(moves, way, (one[meet], other[meet]), apart[meet], share)


def _limit_approaching(
    moves: DiscMotions,
    way: FloatArray,
    pairs: tuple[IntArray, IntArray],
    apart: FloatArray,
    share: FloatArray,
) -> tuple[IntArray, FloatArray]:
    one, other = pairs
    is_one = (np.einsum("ij,ij->i", way[one], apart) > 0.0) & moves.may_stop[one]
    is_other = (np.einsum("ij,ij->i", way[other], apart) < 0.0) & moves.may_stop[other]
    return (
        np.concatenate([one[is_one], other[is_other]]),
        np.concatenate([share[is_one], share[is_other]]),
    )
