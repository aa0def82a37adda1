"""Broad phase in the plane: touching discs, near points, connected components."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.proto.se3 import FloatArray

IntArray = npt.NDArray[np.intp]

LARGE_RATIO = 4.0
"""Discs that are so many times as large as the middle one are compared with every other."""
MAX_SQUARES = 1e8
"""Along a side, so that numbers of squares fit into 64 bits."""
MIN_SQUARE_M = 1e-6
NEIGHBOUR_OFFSETS = ((0, 0), (1, -1), (1, 0), (1, 1), (0, 1))
"""Half of the squares around one: each pair of squares is looked at once."""


def find_touching_discs(centres: FloatArray, radii: FloatArray) -> tuple[IntArray, IntArray]:
    """Find the pairs of discs that touch.

    Args:
        centres: (n, 2), finite.
        radii: (n,), >= 0.

    Returns:
        Two arrays of the same length: one end of each pair, and the other.
    """
    if len(radii) == 0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    is_large = radii > LARGE_RATIO * np.median(radii)
    found = [
        *_pairs_on_grid(np.flatnonzero(~is_large), centres, radii),
        *_pairs_with_large(np.flatnonzero(is_large), centres, radii),
    ]
    one = np.concatenate([np.zeros(0, np.intp), *(pair[0] for pair in found)])
    other = np.concatenate([np.zeros(0, np.intp), *(pair[1] for pair in found)])
    return one, other


def label_components(count: int, one: IntArray, other: IntArray) -> IntArray:
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


def _pairs_on_grid(
    members: IntArray, centres: FloatArray, radii: FloatArray
) -> Iterator[tuple[IntArray, IntArray]]:
    """Find the pairs among discs of like size, on a grid of squares as wide as the largest."""
    if len(members) == 0:
        return
    corner = centres[members].min(axis=0)
    widest = float((centres[members] - corner).max())
    side = max(2.0 * float(radii[members].max()), widest / MAX_SQUARES, MIN_SQUARE_M)
    squares = np.floor((centres[members] - corner) / side).astype(np.intp)
    height = int(squares[:, 1].max()) + 3
    keys = squares[:, 0] * height + squares[:, 1] + 1
    order = np.argsort(keys, kind="stable")
    members, keys = members[order], keys[order]
    for across, up in NEIGHBOUR_OFFSETS:
        at, to = _pairs_in_square(keys, across * height + up)
        keep = _are_touching(members[at], members[to], centres, radii)
        yield members[at][keep], members[to][keep]


def _pairs_in_square(keys: IntArray, offset: int) -> tuple[IntArray, IntArray]:
    """Pair each place in sorted keys with all whose key is so much more; once within a square."""
    first = np.searchsorted(keys, keys + offset, "left")
    last = np.searchsorted(keys, keys + offset, "right")
    if offset == 0:
        first = np.arange(1, len(keys) + 1)
    counts = last - first
    at = np.repeat(np.arange(len(keys)), counts)
    before = np.repeat(np.cumsum(counts) - counts, counts)
    return at, np.arange(len(at)) - before + np.repeat(first, counts)


def _pairs_with_large(
    large: IntArray, centres: FloatArray, radii: FloatArray
) -> Iterator[tuple[IntArray, IntArray]]:
    for number in large:
        others = np.arange(len(radii))
        keep = _are_touching(np.full(len(others), number), others, centres, radii) & (
            others != number
        )
        yield np.full(int(keep.sum()), number), others[keep]


def _are_touching(
    one: IntArray, other: IntArray, centres: FloatArray, radii: FloatArray
) -> npt.NDArray[np.bool_]:
    apart = centres[one] - centres[other]
    touch: npt.NDArray[np.bool_] = (apart * apart).sum(axis=1) <= (radii[one] + radii[other]) ** 2
    return touch


LARGE_DISC_RATIO = 4.0
"""Discs larger than so many times the median are held against all, one by one."""
MIN_GRID_CELL_M = 1e-3


@dataclass(frozen=True)
class PointGrid:
    """Points (n, 2) sorted by the cell that each is in."""

    order: IntArray
    keys: npt.NDArray[np.int64]
    origin: FloatArray
    size_m: float
    width: int

    def find_keys(self, points: FloatArray) -> npt.NDArray[np.int64]:
        """Find the keys of cells; those of a column follow one another."""
        cells = np.floor((points - self.origin) / self.size_m).astype(np.int64)
        # Beyond the border nothing is: one cell there stands for all.
        cells[:, 1] = np.clip(cells[:, 1], -1, self.width - 2)
        return np.asarray(cells[:, 0] * self.width + cells[:, 1])


def make_point_grid(points: FloatArray, size_m: float) -> PointGrid:
    """Sort points (n, 2), n > 0, into cells."""
    origin = points.min(axis=0)
    rows = int((points[:, 1].max() - origin[1]) / size_m) + 1
    made = PointGrid(np.zeros(0, np.intp), np.zeros(0, np.int64), origin, size_m, rows + 3)
    keys = made.find_keys(points)
    order = np.argsort(keys, kind="stable")
    return PointGrid(order, keys[order], origin, size_m, rows + 3)


def find_close_pairs(points: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
    """Find all pairs of discs about points (n, 2) with radii (n,) that touch or overlap.

    Returns:
        Indices (k,) of the one and of the other; each pair once, the lower index first.
    """
    if len(points) < 2:  # noqa: PLR2004 - a pair
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    is_large = reach > LARGE_DISC_RATIO * float(np.median(reach))
    rest, large = np.flatnonzero(~is_large), np.flatnonzero(is_large)
    one, other = _close_pairs_on_grid(points[rest], reach[rest])
    firsts, seconds = [rest[one]], [rest[other]]
    for number in large.tolist():
        apart = np.hypot(*(points - points[number]).T)
        near = np.flatnonzero(apart <= reach + reach[number])
        near = near[(near < number) | ~is_large[near]]
        near = near[near != number]
        firsts.append(np.full(len(near), number))
        seconds.append(near)
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    low, high = np.minimum(first, second), np.maximum(first, second)
    order = np.lexsort((high, low))
    return low[order], high[order]


def _close_pairs_on_grid(points: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
    if len(points) < 2:  # noqa: PLR2004 - a pair
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    cells = make_point_grid(points, max(2.0 * float(reach.max()), MIN_GRID_CELL_M))
    keys, places = cells.keys, np.arange(len(points))
    # Each against those behind it in its own and the next cell, and against the next column.
    own = _expand_ranges(places + 1, np.searchsorted(keys, keys + 1, side="right"))
    column = keys + cells.width
    beside = _expand_ranges(
        np.searchsorted(keys, column - 1, side="left"),
        np.searchsorted(keys, column + 1, side="right"),
    )
    one = cells.order[np.concatenate([own[0], beside[0]])]
    other = cells.order[np.concatenate([own[1], beside[1]])]
    away = points[one] - points[other]
    total = reach[one] + reach[other]
    is_near = np.einsum("ij,ij->i", away, away) <= total * total
    return one[is_near], other[is_near]


def find_near_points(
    cells: PointGrid, points: FloatArray, queries: FloatArray, reach: float
) -> tuple[IntArray, IntArray]:
    """Find the points within a reach of queries (n, 2), no more than the cells' size.

    Returns:
        Indices (k,) of the queries and of the points.
    """
    keys = cells.find_keys(queries)
    found = []
    for beside in (-cells.width, 0, cells.width):
        column = keys + beside
        found.append(
            _expand_ranges(
                np.searchsorted(cells.keys, column - 1, side="left"),
                np.searchsorted(cells.keys, column + 1, side="right"),
            )
        )
    one = np.concatenate([part[0] for part in found])
    other = cells.order[np.concatenate([part[1] for part in found])]
    away = queries[one] - points[other]
    is_near = np.einsum("ij,ij->i", away, away) <= reach * reach
    return one[is_near], other[is_near]


def _expand_ranges(starts: IntArray, ends: IntArray) -> tuple[IntArray, IntArray]:
    """Spread ranges out: whose each is, and each number of it."""
    counts = np.maximum(ends - starts, 0)
    owners = np.repeat(np.arange(len(starts)), counts)
    shifts = np.repeat(np.cumsum(counts) - counts, counts)
    return owners, np.arange(int(counts.sum())) - shifts + starts[owners]
