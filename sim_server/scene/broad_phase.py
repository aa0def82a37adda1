"""Broad phase in the plane: touching discs, near points, connected components."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.proto.se3 import FloatArray

IntArray = npt.NDArray[np.intp]

LARGE_RATIO = 4.0
"""Discs of more than this many times the median radius are compared with every other disc."""
MAX_GRID_CELLS = 1e8
"""Cells along a side, so that keys of cells fit into 64 bits."""
MIN_GRID_CELL_M = 1e-3


def find_touching_discs(centres: FloatArray, radii: FloatArray) -> tuple[IntArray, IntArray]:
    """Find all pairs of discs that touch or overlap.

    Args:
        centres: (n, 2), finite.
        radii: (n,), >= 0.

    Returns:
        Indices (k,) of both discs of each pair; each pair once, the lower index first, sorted.
    """
    if len(radii) < 2:  # noqa: PLR2004 - a pair
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    is_large = radii > LARGE_RATIO * float(np.median(radii))
    small, large = np.flatnonzero(~is_large), np.flatnonzero(is_large)
    one, other = _find_grid_pairs(centres[small], radii[small])
    firsts, seconds = [small[one]], [small[other]]
    for number in large.tolist():
        others = np.flatnonzero((np.arange(len(radii)) < number) | ~is_large)
        firsts.append(np.full(len(others), number))
        seconds.append(others)
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    total = radii[first] + radii[second]
    is_touching = _square_distances(centres[first], centres[second]) <= total * total
    first, second = first[is_touching], second[is_touching]
    low, high = np.minimum(first, second), np.maximum(first, second)
    order = np.lexsort((high, low))
    return low[order], high[order]


def label_components(count: int, one: IntArray, other: IntArray) -> IntArray:
    """Number (n,) the connected components of pairs 0, 1, 2... by their first members."""
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


@dataclass(frozen=True)
class PointGrid:
    """Points (n, 2) sorted by the square cell that each is in."""

    order: IntArray
    keys: npt.NDArray[np.int64]
    origin: FloatArray
    size_m: float
    width: int

    def find_keys(self, points: FloatArray) -> npt.NDArray[np.int64]:
        """Find the keys of cells; cells of a column have consecutive keys."""
        cells = np.floor((points - self.origin) / self.size_m).astype(np.int64)
        # No point is beyond the border: one cell there stands for all.
        cells[:, 1] = np.clip(cells[:, 1], -1, self.width - 2)
        return np.asarray(cells[:, 0] * self.width + cells[:, 1])

    def find_in_column(self, keys: npt.NDArray[np.int64]) -> tuple[IntArray, IntArray]:
        """Find the sorted places of points in the cells with these keys and those beside them.

        Returns:
            Indices (k,) of the keys and of the places.
        """
        starts = np.searchsorted(self.keys, keys - 1, side="left")
        return expand_ranges(starts, np.searchsorted(self.keys, keys + 1, side="right") - starts)


def make_point_grid(points: FloatArray, size_m: float) -> PointGrid:
    """Sort points (n, 2), n > 0, into cells of a size or larger."""
    origin = points.min(axis=0)
    extent = points.max(axis=0) - origin
    size_m = max(size_m, float(extent.max()) / MAX_GRID_CELLS, MIN_GRID_CELL_M)
    width = int(extent[1] / size_m) + 4
    unsorted = PointGrid(np.zeros(0, np.intp), np.zeros(0, np.int64), origin, size_m, width)
    keys = unsorted.find_keys(points)
    order = np.argsort(keys, kind="stable")
    return PointGrid(order, keys[order], origin, size_m, width)


def _find_grid_pairs(points: FloatArray, radii: FloatArray) -> tuple[IntArray, IntArray]:
    """Pair points that may be nearer than their radii: those of one cell and of adjacent cells."""
    if len(points) < 2:  # noqa: PLR2004 - a pair
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    grid = make_point_grid(points, 2.0 * float(radii.max()))
    # Each with later points of its own and the next cell, and with the next column.
    after = np.arange(1, len(points) + 1)
    counts = np.searchsorted(grid.keys, grid.keys + 1, side="right") - after
    own, beside = expand_ranges(after, counts), grid.find_in_column(grid.keys + grid.width)
    one = grid.order[np.concatenate([own[0], beside[0]])]
    return one, grid.order[np.concatenate([own[1], beside[1]])]


def find_near_points(
    grid: PointGrid, points: FloatArray, queries: FloatArray, reach_m: float
) -> tuple[IntArray, IntArray]:
    """Find the points (n, 2) of a grid within a reach of queries (m, 2).

    Args:
        grid: Of the points.
        points: As sorted into the grid.
        queries: Where to search.
        reach_m: At most the size of the grid's cells.

    Returns:
        Indices (k,) of the queries and of the points.
    """
    keys = grid.find_keys(queries)
    found = [grid.find_in_column(keys + shift) for shift in (-grid.width, 0, grid.width)]
    one = np.concatenate([part[0] for part in found])
    other = grid.order[np.concatenate([part[1] for part in found])]
    is_near = _square_distances(queries[one], points[other]) <= reach_m * reach_m
    return one[is_near], other[is_near]


def are_beside(grid: PointGrid, points: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether points (m, 2) are in a cell with points of a grid, or in one beside it.

    All within the size of the cells are; none beyond the diagonal of two.
    """
    keys = grid.find_keys(points)
    found = np.zeros(len(points), np.bool_)
    for shift in (-grid.width, 0, grid.width):
        starts = np.searchsorted(grid.keys, keys + shift - 1, side="left")
        found |= np.searchsorted(grid.keys, keys + shift + 1, side="right") > starts
    # The keys of what is beyond the border are those of the cells there.
    aside = np.floor((points[:, 1] - grid.origin[1]) / grid.size_m)
    return np.asarray(found & (aside >= -1.0) & (aside <= grid.width - 3.0))


def _square_distances(one: FloatArray, other: FloatArray) -> FloatArray:
    away = one - other
    return np.asarray(np.einsum("ij,ij->i", away, away))


def expand_ranges(starts: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """List the numbers of ranges: index of the range (k,), and each of its numbers (k,)."""
    counts = np.maximum(counts, 0)
    owners = np.repeat(np.arange(len(starts)), counts)
    shifts = np.repeat(starts - (np.cumsum(counts) - counts), counts)
    return owners, np.arange(len(owners)) + shifts
