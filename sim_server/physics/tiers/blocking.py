"""How far discs may go before they touch: each other, and edges. Pure arithmetic on arrays.

Everything goes in a straight line, at its own even speed, from where it is to where it wants to be.
A share of 1 is the whole way, 0 none of it.
"""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.tiers.grid import IntArray

GAP_M = 0.001
"""How far apart things stop."""
SLACK = 1e-9
ROUNDS = 4
"""After so many, who still is in the way of another stands."""
NOBODY, NO_SHARES = np.zeros(0, np.intp), np.zeros(0)
CREEPS = 12
"""Steps towards an edge; what has not arrived by then waits for the next time."""


@dataclass(frozen=True)
class Moves:
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


def shares_by_edges(
    moves: Moves, disc: IntArray, ends: FloatArray, thick: FloatArray
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
    away, apart = from_edges(start, ends)
    towards = np.einsum("ij,ij->i", way, away)
    kept = moves.radius[disc] + thick + GAP_M
    bend = moves.bend[disc]
    goes = (towards < -SLACK * length) & (length > 0.0) & (apart - length < kept + bend)
    if not goes.any():
        return shares
    part = _creep(start[goes], way[goes], ends[goes], np.minimum(kept, apart)[goes])
    is_wild = (bend[goes] > GAP_M / 2.0) & (part < 1.0)
    np.minimum.at(shares, disc[goes], np.where(is_wild, 0.0, part))
    return shares


def _creep(start: FloatArray, way: FloatArray, ends: FloatArray, kept: FloatArray) -> FloatArray:
    """Go on by the distance that is free for certain, until none is left."""
    length = np.hypot(way[:, 0], way[:, 1])
    share = np.zeros(len(start))
    for _ in range(CREEPS):
        _, apart = from_edges(start + way * share[:, None], ends)
        share = np.minimum(1.0, share + np.maximum(apart - kept, 0.0) / length)
    return share


def from_edges(points: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the unit vectors (k, 2) from edges to points, and how far apart they are (k,)."""
    first, along = ends[:, :2], ends[:, 2:] - ends[:, :2]
    from_first = points - first
    square = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", from_first, along) / np.where(square > 0.0, square, 1.0)
    away = from_first - along * np.clip(share, 0.0, 1.0)[:, None]
    apart = np.hypot(away[:, 0], away[:, 1])
    return away / np.where(apart > 0.0, apart, 1.0)[:, None], apart


def shares_by_each_other(
    moves: Moves, one: IntArray, other: IntArray, shares: FloatArray
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
    for last in range(len(moves.radius) + ROUNDS):
        way = moves.way if shares.min() >= 1.0 else moves.way * shares[:, None]
        blamed, part = _meeting(moves, way, one, other)
        if not len(blamed):
            return shares
        if last >= ROUNDS:
            part = np.zeros_like(part)
        np.minimum.at(shares, blamed, shares[blamed] * part)
    return shares


def _meeting(
    moves: Moves, way: FloatArray, one: IntArray, other: IntArray
) -> tuple[IntArray, FloatArray]:
    """Name those who run into another, and the share of their way until then."""
    apart = moves.start.take(other, axis=0) - moves.start.take(one, axis=0)
    square = np.einsum("ij,ij->i", apart, apart)
    within = moves.reach[one] + moves.reach[other]
    near = np.flatnonzero(square < within * within)
    if not len(near):
        return NOBODY, NO_SHARES
    one, other, apart, square = one[near], other[near], apart[near], square[near]
    closing = way.take(other, axis=0) - way.take(one, axis=0)
    b = np.einsum("ij,ij->i", apart, closing)
    a = np.einsum("ij,ij->i", closing, closing)
    total = moves.radius[one] + moves.radius[other] + GAP_M
    bend = moves.bend[one] + moves.bend[other]
    is_wild = bend > GAP_M / 2.0
    kept = np.minimum(total * total, square)
    wide = np.where(is_wild, (total + bend) ** 2, kept)
    passing = square - b * b / np.where(a > 0.0, a, 1.0)
    nearest = np.where(-b > a, square + 2.0 * b + a, passing)
    meet = (b < -SLACK * np.sqrt(a * square)) & (nearest < wide - SLACK * total * total)
    if not meet.any():
        return NOBODY, NO_SHARES
    a, b, c = a[meet], b[meet], (square - kept)[meet]
    share = (-b - np.sqrt(np.maximum(b * b - a * c, 0.0))) / a
    share = np.where(is_wild[meet], 0.0, np.clip(share * (1.0 - SLACK), 0.0, 1.0))
    return _blamed(moves, way, (one[meet], other[meet]), apart[meet], share)


def _blamed(
    moves: Moves,
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
