"""Which body goes to which cell: groups stay whole, and cells that are too full give some away."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.clusters.discs import IntArray
from zensim.sim_server.physics.engine import FloatArray

FILLED = 0.75
"""To which share of its room a cell that is too full is emptied, and others are filled."""

PARTS = 4
"""Cells of a large world, while they need not be larger than the largest."""


@dataclass(frozen=True)
class Room:
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

    def of(self, count: int) -> int:
        """Say how many bodies a cell has at most in a world of so many."""
        return max(self.most, min(self.largest, count // PARTS))

    def filled(self, count: int) -> int:
        """Say up to how many a cell is filled in a world of so many."""
        return max(1, int(self.of(count) * FILLED))


def deal(cells: IntArray, groups: IntArray, places: FloatArray, room: Room) -> IntArray:
    """Choose a cell for each body.

    Args:
        cells: (n,) where each is now, >= 0.
        groups: (n,) which may touch: bodies of one number go to one cell.
        places: (n, 2).
        room: Of the cells.

    Returns:
        (n,) cells. Numbers that nobody had may be among them: the least that are free.
    """
    found = _joined(cells, groups)
    for cell in np.flatnonzero(np.bincount(found, minlength=1) > room.of(len(cells))):
        _shed(int(cell), found, groups, places, room)
    return found


def _joined(cells: IntArray, groups: IntArray) -> IntArray:
    """Send each group to the cell that has most of it; to the first of those that have as many."""
    count = int(groups.max(initial=-1)) + 1
    low, high = np.full(count, np.iinfo(np.intp).max), np.full(count, -1)
    np.minimum.at(low, groups, cells)
    np.maximum.at(high, groups, cells)
    home = low
    for group in np.flatnonzero(low != high):
        home[group] = np.bincount(cells[groups == group]).argmax()
    return home[groups]


def _shed(cell: int, cells: IntArray, groups: IntArray, places: FloatArray, room: Room) -> None:
    """Give groups of a cell away, from one end of it, as many as may be at once."""
    held = np.flatnonzero(cells == cell)
    left, moved = len(held), 0
    for members in _from_the_end(held, groups, places):
        if left <= room.filled(len(cells)) or moved >= room.at_once or len(members) == len(held):
            return
        target = _receiver(cell, members, cells, places, room)
        cells[members] = target
        left, moved = left - len(members), moved + len(members)


def _from_the_end(held: IntArray, groups: IntArray, places: FloatArray) -> list[IntArray]:
    """Line the groups of a cell up along its longer side, the far end first."""
    spread = np.ptp(places[held], axis=0)
    along = places[held, int(spread[1] > spread[0])]
    names, inverse = np.unique(groups[held], return_inverse=True)
    ends = np.full(len(names), -np.inf)
    np.maximum.at(ends, inverse, along)
    order = np.argsort(-ends, kind="stable")
    return [held[inverse == group] for group in order]


def _receiver(
    giver: int, members: IntArray, cells: IntArray, places: FloatArray, room: Room
) -> int:
    """Find the nearest cell that has room for a group, else a new one."""
    counts = np.bincount(cells)
    fits = (counts > 0) & (counts + len(members) <= room.filled(len(cells)))
    fits[giver] = False
    if not fits.any():
        free = np.flatnonzero(counts == 0)
        return int(free[0]) if len(free) else len(counts)
    held = np.maximum(counts, 1)
    middles = np.stack([np.bincount(cells, places[:, axis]) / held for axis in (0, 1)], axis=1)
    apart = np.linalg.norm(middles - places[members].mean(axis=0), axis=1)
    return int(np.where(fits, apart, np.inf).argmin())
