"""Which bodies belong together, and which cell a group of them gets."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import IntArray, find_touching_discs, label_components

FILL_RATIO = 0.75
"""Share of the capacity to which an overfull cell is emptied and others are filled."""
LARGE_WORLD_CELLS = 4
"""Number of cells of a large world, unless `CellCapacity.largest` requires more."""
CELL_GAP_M = 0.02
"""Least distance between bodies of different cells."""
SPEED_MARGIN_MPS = 2.0
"""Speed that a body may gain by motors or impacts before the next regrouping."""


@dataclass(frozen=True)
class CellCapacity:
    """Maximum numbers of bodies.

    Attributes:
        cell_bodies: Of a cell; a group that cannot be split may exceed it.
        moved_bodies: That an overfull cell gives away in one regrouping.
        large_cell_bodies: Of a cell of a large world; fewer cells take less memory.
    """

    cell_bodies: int
    moved_bodies: int
    large_cell_bodies: int = 0

    def max_bodies(self, count: int) -> int:
        """Find the maximum bodies of a cell in a world of `count` bodies."""
        return max(self.cell_bodies, min(self.large_cell_bodies, count // LARGE_WORLD_CELLS))

    def fill_limit(self, count: int) -> int:
        """Find the number of bodies up to which a cell receives groups."""
        return max(1, int(self.max_bodies(count) * FILL_RATIO))


def assign_cells(
    cells: IntArray, groups: IntArray, places: FloatArray, capacity: CellCapacity
) -> IntArray:
    """Choose a cell for each body.

    Args:
        cells: (n,) current cell of each, >= 0.
        groups: (n,) bodies of one number go to one cell.
        places: (n, 2).
        capacity: Of the cells.

    Returns:
        (n,) cells; new cells get the least free numbers.
    """
    found = _merge_groups(cells, groups)
    loads = CellLoads(found, places)
    for cell in np.flatnonzero(loads.counts > capacity.max_bodies(len(cells))):
        _offload_groups(int(cell), found, groups, loads, capacity)
    return found


class CellLoads:
    """How many bodies each cell has and where, kept while groups move between cells."""

    def __init__(self, cells: IntArray, places: FloatArray) -> None:
        self.places = places
        self.counts = np.bincount(cells, minlength=1)
        self.sums: FloatArray = np.stack([np.bincount(cells, own) for own in places.T], axis=1)
        """(c, 2) sums of the places of the bodies of each cell."""

    def move(self, members: IntArray, giver: int, target: int) -> None:
        """Count bodies in another cell, which may be the next new one."""
        if target == len(self.counts):
            self.counts = np.append(self.counts, 0)
            self.sums = np.concatenate([self.sums, np.zeros((1, 2))])
        moved = self.places[members].sum(axis=0)
        self.counts[giver] -= len(members)
        self.counts[target] += len(members)
        self.sums[giver] -= moved
        self.sums[target] += moved

    def find_receiving_cell(self, giver: int, members: IntArray, fill_limit: int) -> int:
        """Find the nearest cell with capacity for a group, else a new one."""
        counts = self.counts
        fits = (counts > 0) & (counts + len(members) <= fill_limit)
        fits[giver] = False
        if not fits.any():
            free = np.flatnonzero(counts == 0)
            return int(free[0]) if len(free) else len(counts)
        middles = self.sums / np.maximum(counts, 1)[:, None]
        apart = np.hypot(*(middles - self.places[members].mean(axis=0)).T)
        return int(np.where(fits, apart, np.inf).argmin())


def _merge_groups(cells: IntArray, groups: IntArray) -> IntArray:
    """Move each group to the cell that contains most of it; the first of equals."""
    count = int(groups.max(initial=-1)) + 1
    low, high = np.full(count, np.iinfo(np.intp).max), np.full(count, -1)
    np.minimum.at(low, groups, cells)
    np.maximum.at(high, groups, cells)
    target = low
    for group in np.flatnonzero(low != high):
        target[group] = np.bincount(cells[groups == group]).argmax()
    return target[groups]


def _offload_groups(
    cell: int, cells: IntArray, groups: IntArray, loads: CellLoads, capacity: CellCapacity
) -> None:
    """Move groups from one end of an overfull cell to others, up to `moved_bodies`."""
    held = np.flatnonzero(cells == cell)
    left, moved, fill_limit = len(held), 0, capacity.fill_limit(len(cells))
    for members in _list_groups_from_far_end(held, groups, loads.places):
        if left <= fill_limit or moved >= capacity.moved_bodies or len(members) == len(held):
            return
        target = loads.find_receiving_cell(cell, members, fill_limit)
        loads.move(members, cell, target)
        cells[members] = target
        left, moved = left - len(members), moved + len(members)


def _list_groups_from_far_end(
    held: IntArray, groups: IntArray, places: FloatArray
) -> list[IntArray]:
    """Sort the groups of a cell along its longer side, the far end first."""
    spread = np.ptp(places[held], axis=0)
    along = places[held, int(spread[1] > spread[0])]
    names, inverse = np.unique(groups[held], return_inverse=True)
    ends = np.full(len(names), -np.inf)
    np.maximum.at(ends, inverse, along)
    firsts = np.cumsum(np.bincount(inverse, minlength=len(names)))[:-1]
    members = np.split(held[np.argsort(inverse, kind="stable")], firsts)
    return [members[group] for group in np.argsort(-ends, kind="stable").tolist()]


@dataclass(frozen=True)
class InteractionGroups:
    """Groups of bodies that cannot touch other groups for some time.

    Attributes:
        groups: (n,) group of each body, from 0.
        speeds: (n,) assumed bounds of their speeds [m/s].
        periods: Number of periods for which it holds.
    """

    groups: IntArray
    speeds: FloatArray
    periods: int

    @property
    def largest(self) -> int:
        """Number of bodies of the largest group."""
        return int(np.bincount(self.groups).max(initial=0))


def find_interaction_groups(
    places: FloatArray, radii: FloatArray, speeds: FloatArray, period_s: float, *, periods: int
) -> InteractionGroups:
    """Put bodies that may touch within some periods into one group.

    Args:
        places: (n, 2); a body without a finite place is a group of its own.
        radii: (n,) [m].
        speeds: (n,) upper bounds [m/s] without impacts.
        period_s: Length of a period.
        periods: Number of periods.
    """
    is_known = np.isfinite(places).all(axis=1) & np.isfinite(radii) & np.isfinite(speeds)
    known = np.flatnonzero(is_known)
    bounds = speeds.copy()
    groups = np.zeros(0, np.intp)
    while True:
        swept = radii[known] + bounds[known] * (period_s * periods) + CELL_GAP_M / 2.0
        groups = label_components(len(known), *find_touching_discs(places[known], swept))
        raised = _raise_to_fastest(bounds[known], groups)
        if (raised <= bounds[known]).all():
            break
        bounds[known] = raised
    found = np.zeros(len(places), np.intp)
    found[known] = groups
    lost = np.flatnonzero(~is_known)
    found[lost] = int(groups.max(initial=-1)) + 1 + np.arange(len(lost))
    return InteractionGroups(found, bounds, periods)


def _raise_to_fastest(speeds: FloatArray, groups: IntArray) -> FloatArray:
    """Raise speed bounds in each group: an impact may make a body as fast as the fastest one."""
    fastest = np.zeros(int(groups.max(initial=-1)) + 1)
    np.maximum.at(fastest, groups, speeds)
    return np.maximum(speeds, fastest[groups] - SPEED_MARGIN_MPS / 2.0)
