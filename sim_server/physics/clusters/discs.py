"""Which discs in the plane touch, and which hang together by touching. Pure; by arrays."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.engine import FloatArray

IntArray = npt.NDArray[np.intp]

LARGE = 4.0
"""Discs that are so many times as large as the middle one are compared with every other."""
MOST_SQUARES = 1e8
"""Along a side, so that numbers of squares fit into 64 bits."""
LEAST_SIDE_M = 1e-6
NEIGHBOURS = ((0, 0), (1, -1), (1, 0), (1, 1), (0, 1))
"""Half of the squares around one: each pair of squares is looked at once."""


def touching(centres: FloatArray, radii: FloatArray) -> tuple[IntArray, IntArray]:
    """Find the pairs of discs that touch.

    Args:
        centres: (n, 2), finite.
        radii: (n,), >= 0.

    Returns:
        Two arrays of the same length: one end of each pair, and the other.
    """
    if len(radii) == 0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    is_large = radii > LARGE * np.median(radii)
    found = [
        *_among(np.flatnonzero(~is_large), centres, radii),
        *_with_all(np.flatnonzero(is_large), centres, radii),
    ]
    one = np.concatenate([np.zeros(0, np.intp), *(pair[0] for pair in found)])
    other = np.concatenate([np.zeros(0, np.intp), *(pair[1] for pair in found)])
    return one, other


def labels_of(count: int, one: IntArray, other: IntArray) -> IntArray:
    """Join what is paired: number (n,) the groups 0, 1, 2... by their first members."""
    least = np.arange(count)
    while len(one):
        before = least
        lower = np.minimum(least[one], least[other])
        least = least.copy()
        np.minimum.at(least, before[one], lower)
        np.minimum.at(least, before[other], lower)
        least = least[least]
        if np.array_equal(least, before) and np.array_equal(least[one], least[other]):
            break
    return np.unique(least, return_inverse=True)[1].astype(np.intp)


def _among(
    members: IntArray, centres: FloatArray, radii: FloatArray
) -> Iterator[tuple[IntArray, IntArray]]:
    """Find the pairs among discs of like size, on a grid of squares as wide as the largest."""
    if len(members) == 0:
        return
    corner = centres[members].min(axis=0)
    widest = float((centres[members] - corner).max())
    side = max(2.0 * float(radii[members].max()), widest / MOST_SQUARES, LEAST_SIDE_M)
    squares = np.floor((centres[members] - corner) / side).astype(np.intp)
    height = int(squares[:, 1].max()) + 3
    keys = squares[:, 0] * height + squares[:, 1] + 1
    order = np.argsort(keys, kind="stable")
    members, keys = members[order], keys[order]
    for across, up in NEIGHBOURS:
        at, to = _in_square(keys, across * height + up)
        keep = _touch(members[at], members[to], centres, radii)
        yield members[at][keep], members[to][keep]


def _in_square(keys: IntArray, offset: int) -> tuple[IntArray, IntArray]:
    """Pair each place in sorted keys with all whose key is so much more; once within a square."""
    first = np.searchsorted(keys, keys + offset, "left")
    last = np.searchsorted(keys, keys + offset, "right")
    if offset == 0:
        first = np.arange(1, len(keys) + 1)
    counts = last - first
    at = np.repeat(np.arange(len(keys)), counts)
    before = np.repeat(np.cumsum(counts) - counts, counts)
    return at, np.arange(len(at)) - before + np.repeat(first, counts)


def _with_all(
    large: IntArray, centres: FloatArray, radii: FloatArray
) -> Iterator[tuple[IntArray, IntArray]]:
    for number in large:
        others = np.arange(len(radii))
        keep = _touch(np.full(len(others), number), others, centres, radii) & (others != number)
        yield np.full(int(keep.sum()), number), others[keep]


def _touch(
    one: IntArray, other: IntArray, centres: FloatArray, radii: FloatArray
) -> npt.NDArray[np.bool_]:
    apart = centres[one] - centres[other]
    touch: npt.NDArray[np.bool_] = (apart * apart).sum(axis=1) <= (radii[one] + radii[other]) ** 2
    return touch
