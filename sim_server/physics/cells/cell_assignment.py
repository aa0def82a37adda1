"""Assign bodies to cells: groups that may interact, and load balancing."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import IntArray, find_touching_discs, label_components

FILL_RATIO = 0.75
"""To which share of its room a cell that is too full is emptied, and others are filled."""

LARGE_WORLD_CELLS = 4
"""Cells of a large world, while they need not be larger than the largest."""


@dataclass(frozen=True)
class CellCapacity:
    """What cells hold.

    Attributes:
        most: Bodies of a cell, but for a group that is larger.
        at_once: Bodies that are given away in one go; those of a group that must be joined are
            beside it.
        largest: Bodies of a cell of a large world, where each has a fourth of all: a cell takes
            memory, however few it has.
    """

    most: int
    at_once: int
    largest: int = 0

    def max_bodies(self, count: int) -> int:
        """Say how many bodies a cell has at most in a world of so many."""
        return max(self.most, min(self.largest, count // LARGE_WORLD_CELLS))

    def fill_limit(self, count: int) -> int:
        """Say up to how many a cell is filled in a world of so many."""
        return max(1, int(self.max_bodies(count) * FILL_RATIO))


def assign_cells(
    cells: IntArray, groups: IntArray, places: FloatArray, room: CellCapacity
) -> IntArray:
    """Choose a cell for each body.

    Args:
        cells: (n,) where each is now, >= 0.
        groups: (n,) which may touch: bodies of one number go to one cell.
        places: (n, 2).
        room: Of the cells.

    Returns:
        (n,) cells. Numbers that nobody had may be among them: the least that are free.
    """
    found = _merge_groups(cells, groups)
    for cell in np.flatnonzero(np.bincount(found, minlength=1) > room.max_bodies(len(cells))):
        _offload_groups(int(cell), found, groups, places, room)
    return found


def _merge_groups(cells: IntArray, groups: IntArray) -> IntArray:
    """Send each group to the cell that has most of it; to the first of those that have as many."""
    count = int(groups.max(initial=-1)) + 1
    low, high = np.full(count, np.iinfo(np.intp).max), np.full(count, -1)
    np.minimum.at(low, groups, cells)
    np.maximum.at(high, groups, cells)
    home = low
    for group in np.flatnonzero(low != high):
        home[group] = np.bincount(cells[groups == group]).argmax()
    return home[groups]


def _offload_groups(
    cell: int, cells: IntArray, groups: IntArray, places: FloatArray, room: CellCapacity
) -> None:
    """Give groups of a cell away, from one end of it, as many as may be at once."""
    held = np.flatnonzero(cells == cell)
    left, moved = len(held), 0
    for members in _groups_from_far_end(held, groups, places):
        if (
            left <= room.fill_limit(len(cells))
            or moved >= room.at_once
            or len(members) == len(held)
        ):
            return
        target = _find_receiving_cell(cell, members, cells, places, room)
        cells[members] = target
        left, moved = left - len(members), moved + len(members)


def _groups_from_far_end(held: IntArray, groups: IntArray, places: FloatArray) -> list[IntArray]:
    """Line the groups of a cell up along its longer side, the far end first."""
    spread = np.ptp(places[held], axis=0)
    along = places[held, int(spread[1] > spread[0])]
    names, inverse = np.unique(groups[held], return_inverse=True)
    ends = np.full(len(names), -np.inf)
    np.maximum.at(ends, inverse, along)
    order = np.argsort(-ends, kind="stable")
    return [held[inverse == group] for group in order]


def _find_receiving_cell(
    giver: int, members: IntArray, cells: IntArray, places: FloatArray, room: CellCapacity
) -> int:
    """Find the nearest cell that has room for a group, else a new one."""
    counts = np.bincount(cells)
    fits = (counts > 0) & (counts + len(members) <= room.fill_limit(len(cells)))
    fits[giver] = False
    if not fits.any():
        free = np.flatnonzero(counts == 0)
        return int(free[0]) if len(free) else len(counts)
    held = np.maximum(counts, 1)
    middles = np.stack([np.bincount(cells, places[:, axis]) / held for axis in (0, 1)], axis=1)
    apart = np.linalg.norm(middles - places[members].mean(axis=0), axis=1)
    return int(np.where(fits, apart, np.inf).argmin())


CELL_GAP_M = 0.02
"""Between bodies of different cells at the least."""
SPEED_MARGIN_MPS = 2.0
"""What a body may gain in speed by its motors, or by being hit, before the next look."""


@dataclass(frozen=True)
class InteractionGroups:
    """Bodies in groups that cannot touch each other for some time.

    Attributes:
        groups: (n,) by number, from 0.
        speeds: (n,) how fast each may be for that [m/s].
        periods: For how many periods it holds.
    """

    groups: IntArray
    speeds: FloatArray
    periods: int

    @property
    def largest(self) -> int:
        """How many bodies the largest group has."""
        return int(np.bincount(self.groups).max(initial=0))


def find_interaction_groups(
    places: FloatArray, radii: FloatArray, speeds: FloatArray, period_s: float, *, periods: int
) -> InteractionGroups:
    """Put bodies that may touch within some periods into one group.

    Args:
        places: (n, 2); what is not finite is a group of its own.
        radii: (n,) that bodies have [m].
        speeds: (n,) at most, unless others hit them.
        period_s: Length of a period.
        periods: How many.
    """
    is_somewhere = np.isfinite(places).all(axis=1) & np.isfinite(radii) & np.isfinite(speeds)
    known = np.flatnonzero(is_somewhere)
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
    lost = np.flatnonzero(~is_somewhere)
    found[lost] = int(groups.max(initial=-1)) + 1 + np.arange(len(lost))
    return InteractionGroups(found, bounds, periods)


def _raise_to_fastest(speeds: FloatArray, groups: IntArray) -> FloatArray:
    """What a group's fastest hits goes as fast at most, but for what each has to spare anyway."""
    fastest = np.zeros(int(groups.max(initial=-1)) + 1)
    np.maximum.at(fastest, groups, speeds)
    return np.maximum(speeds, fastest[groups] - SPEED_MARGIN_MPS / 2.0)
