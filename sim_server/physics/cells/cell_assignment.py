"""Assign bodies to cells: groups that may interact, and load balancing."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import IntArray, find_touching_discs, label_components

FILL_RATIO = 0.75
"""Share of the capacity to which an overfull cell is emptied and others are filled."""

LARGE_WORLD_CELLS = 4
"""Number of cells of a large world, unless `CellCapacity.largest` requires more."""


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
    for cell in np.flatnonzero(np.bincount(found, minlength=1) > capacity.max_bodies(len(cells))):
        _offload_groups(int(cell), found, groups, places, capacity)
    return found


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
    cell: int, cells: IntArray, groups: IntArray, places: FloatArray, capacity: CellCapacity
) -> None:
    """Move groups from one end of an overfull cell to others, up to `moved_bodies`."""
    held = np.flatnonzero(cells == cell)
    left, moved = len(held), 0
    for members in _groups_from_far_end(held, groups, places):
        if (
            left <= capacity.fill_limit(len(cells))
            or moved >= capacity.moved_bodies
            or len(members) == len(held)
        ):
            return
        target = _find_receiving_cell(cell, members, cells, places, capacity)
        cells[members] = target
        left, moved = left - len(members), moved + len(members)


def _groups_from_far_end(held: IntArray, groups: IntArray, places: FloatArray) -> list[IntArray]:
    """Sort the groups of a cell along its longer side, the far end first."""
    spread = np.ptp(places[held], axis=0)
    along = places[held, int(spread[1] > spread[0])]
    names, inverse = np.unique(groups[held], return_inverse=True)
    ends = np.full(len(names), -np.inf)
    np.maximum.at(ends, inverse, along)
    order = np.argsort(-ends, kind="stable")
    return [held[inverse == group] for group in order]


def _find_receiving_cell(
    giver: int, members: IntArray, cells: IntArray, places: FloatArray, capacity: CellCapacity
) -> int:
    """Find the nearest cell with capacity for a group, else a new one."""
    counts = np.bincount(cells)
    fits = (counts > 0) & (counts + len(members) <= capacity.fill_limit(len(cells)))
    fits[giver] = False
    if not fits.any():
        free = np.flatnonzero(counts == 0)
        return int(free[0]) if len(free) else len(counts)
    held = np.maximum(counts, 1)
    middles = np.stack([np.bincount(cells, places[:, axis]) / held for axis in (0, 1)], axis=1)
    apart = np.linalg.norm(middles - places[members].mean(axis=0), axis=1)
    return int(np.where(fits, apart, np.inf).argmin())


CELL_GAP_M = 0.02
"""Least distance between bodies of different cells."""
SPEED_MARGIN_MPS = 2.0
"""Speed that a body may gain by motors or impacts before the next regrouping."""


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
