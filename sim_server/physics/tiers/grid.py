"""Which discs are near which, found on a grid of cells. Pure arithmetic on arrays."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.engine import FloatArray

IntArray = npt.NDArray[np.intp]
LARGE = 4.0
"""Discs larger than so many times the median are held against all, one by one."""
LEAST_CELL_M = 1e-3


@dataclass(frozen=True)
class Cells:
    """Points (n, 2) sorted by the cell that each is in."""

    order: IntArray
    keys: npt.NDArray[np.int64]
    origin: FloatArray
    size_m: float
    width: int

    def of(self, points: FloatArray) -> npt.NDArray[np.int64]:
        """Find the keys of cells; those of a column follow one another."""
        cells = np.floor((points - self.origin) / self.size_m).astype(np.int64)
        # Beyond the border nothing is: one cell there stands for all.
        cells[:, 1] = np.clip(cells[:, 1], -1, self.width - 2)
        return np.asarray(cells[:, 0] * self.width + cells[:, 1])


def cells_of(points: FloatArray, size_m: float) -> Cells:
    """Sort points (n, 2), n > 0, into cells."""
    origin = points.min(axis=0)
    rows = int((points[:, 1].max() - origin[1]) / size_m) + 1
    made = Cells(np.zeros(0, np.intp), np.zeros(0, np.int64), origin, size_m, rows + 3)
    keys = made.of(points)
    order = np.argsort(keys, kind="stable")
    return Cells(order, keys[order], origin, size_m, rows + 3)


def close_pairs(points: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
    """Find all pairs of discs about points (n, 2) with radii (n,) that touch or overlap.

    Returns:
        Indices (k,) of the one and of the other; each pair once, the lower index first.
    """
    if len(points) < 2:  # noqa: PLR2004 - a pair
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    is_large = reach > LARGE * float(np.median(reach))
    rest, large = np.flatnonzero(~is_large), np.flatnonzero(is_large)
    one, other = _gridded(points[rest], reach[rest])
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


def _gridded(points: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
    if len(points) < 2:  # noqa: PLR2004 - a pair
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    cells = cells_of(points, max(2.0 * float(reach.max()), LEAST_CELL_M))
    keys, places = cells.keys, np.arange(len(points))
    # Each against those behind it in its own and the next cell, and against the next column.
    own = _ranges(places + 1, np.searchsorted(keys, keys + 1, side="right"))
    column = keys + cells.width
    beside = _ranges(
        np.searchsorted(keys, column - 1, side="left"),
        np.searchsorted(keys, column + 1, side="right"),
    )
    one = cells.order[np.concatenate([own[0], beside[0]])]
    other = cells.order[np.concatenate([own[1], beside[1]])]
    away = points[one] - points[other]
    total = reach[one] + reach[other]
    is_near = np.einsum("ij,ij->i", away, away) <= total * total
    return one[is_near], other[is_near]


def near_points(
    cells: Cells, points: FloatArray, queries: FloatArray, reach: float
) -> tuple[IntArray, IntArray]:
    """Find the points within a reach of queries (n, 2), no more than the cells' size.

    Returns:
        Indices (k,) of the queries and of the points.
    """
    keys = cells.of(queries)
    found = []
    for beside in (-cells.width, 0, cells.width):
        column = keys + beside
        found.append(
            _ranges(
                np.searchsorted(cells.keys, column - 1, side="left"),
                np.searchsorted(cells.keys, column + 1, side="right"),
            )
        )
    one = np.concatenate([part[0] for part in found])
    other = cells.order[np.concatenate([part[1] for part in found])]
    away = queries[one] - points[other]
    is_near = np.einsum("ij,ij->i", away, away) <= reach * reach
    return one[is_near], other[is_near]


def _ranges(starts: IntArray, ends: IntArray) -> tuple[IntArray, IntArray]:
    """Spread ranges out: whose each is, and each number of it."""
    counts = np.maximum(ends - starts, 0)
    owners = np.repeat(np.arange(len(starts)), counts)
    shifts = np.repeat(np.cumsum(counts) - counts, counts)
    return owners, np.arange(int(counts.sum())) - shifts + starts[owners]
