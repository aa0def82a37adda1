"""How to find bodies among arrays: worked out once, and good until somebody moves house."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.clusters.discs import IntArray
from zensim.sim_server.physics.clusters.members import Members
from zensim.sim_server.physics.engine import BodyStates, FloatArray


@dataclass(frozen=True)
class Lineup:
    """All bodies that move, cell by cell: the order in which they are read and told.

    Attributes:
        cells: Which cells have any.
        bodies: For each of these, the numbers that its bodies have there.
        numbers: (n,) of the bodies, one cell after the other.
        row: (m,) where each number stands in `numbers`.
        joint_start: (n + 1,) where the joints of each start.
        targets: Of all targets, those of these bodies, but for those that have none.
        target_starts: Where the targets of each body that has any start.
        driven: (d,) rows of these bodies.
        cell_targets: (c + 1,) where the targets of each cell start among `targets`.
        slides: Pairs: row, and where a joint that slides stands among all joints.
    """

    cells: tuple[int, ...]
    bodies: tuple[tuple[int, ...], ...]
    numbers: IntArray
    row: IntArray
    joint_start: IntArray
    targets: IntArray
    target_starts: IntArray
    driven: IntArray
    cell_targets: IntArray
    slides: tuple[IntArray, IntArray]


def lineup_of(members: Members) -> Lineup:
    """Line up all that moves and takes part."""
    moving = members.present
    numbers = moving[np.argsort(members.cell[moving], kind="stable")]
    cells, firsts = np.unique(members.cell[numbers], return_index=True)
    inner = members.inner[numbers]
    parts = np.split(inner, firsts[1:]) if len(numbers) else []
    row = np.full(len(members.cell), -1, np.intp)
    row[numbers] = np.arange(len(numbers))
    counts = [len(members.by_number[number].model.joints) for number in numbers.tolist()]
    joint_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    starts, widths = members.targets_of(numbers)
    slides = [
        (at, joint_start[at] + slide)
        for at, number in enumerate(numbers.tolist())
        for slide in members.by_number[number].reach.slides
    ]
    return Lineup(
        tuple(cells.tolist()),
        tuple(tuple(part.tolist()) for part in parts),
        numbers,
        row,
        joint_start,
        _ranges(starts, widths),
        (np.cumsum(widths) - widths)[widths > 0].astype(np.intp),
        np.flatnonzero(widths > 0),
        np.concatenate([[0], np.cumsum(widths)])[[*firsts, len(numbers)]].astype(np.intp),
        (np.array([a for a, _ in slides], np.intp), np.array([b for _, b in slides], np.intp)),
    )


@dataclass(frozen=True)
class Route:
    """Where the bodies that somebody names stand in a lineup and among the targets.

    Attributes:
        rows: (k,) of the lineup.
        into: (k,) rows of the answer that they fill; the others are of bodies that never move.
        base: (n, 13) the answer, but for those.
        joints: Of the lineup's joints, in the order of the answer's.
        joints_into: Which of the answer's joints these fill.
        joint_count: Of the answer.
        numbers: (n,) the bodies.
        targets: Of all targets, those of these bodies in order.
        starts: Where the targets of each body that has any start.
        driven: These bodies.
        alone: (n,) the numbers that they have in the first cell, if there is no other.
    """

    rows: IntArray
    into: IntArray
    base: FloatArray
    joints: IntArray
    joints_into: IntArray
    joint_count: int
    numbers: IntArray
    targets: IntArray
    starts: IntArray
    driven: IntArray
    alone: tuple[int, ...]

    def cut(self, now: BodyStates) -> BodyStates:
        """Cut the answer out of a reading of the lineup."""
        base = self.base.copy()
        base[self.into] = now.base[self.rows]
        positions, velocities = np.zeros(self.joint_count), np.zeros(self.joint_count)
        positions[self.joints_into] = now.joint_positions[self.joints]
        velocities[self.joints_into] = now.joint_velocities[self.joints]
        return BodyStates(base, positions, velocities)


def route_of(bodies: Sequence[int], members: Members, lineup: Lineup) -> Route:
    """Work out how to find bodies."""
    numbers = np.array(bodies, np.intp)
    rows = lineup.row[numbers] if len(numbers) else numbers
    found = [members.by_number[number] for number in bodies]
    counts = np.array([len(member.model.joints) for member in found], np.intp)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    into = np.flatnonzero(rows >= 0)
    base = np.zeros((len(found), 13))
    for at in np.flatnonzero(rows < 0).tolist():
        base[at] = found[at].base
    slices, widths = members.targets_of(numbers)
    is_driven = widths > 0
    ends = np.cumsum(widths)
    return Route(
        rows[into],
        into,
        base,
        _ranges(lineup.joint_start[rows[into]], counts[into]),
        _ranges(starts[into], counts[into]),
        int(starts[-1]),
        numbers,
        _ranges(slices, widths),
        (ends - widths)[is_driven].astype(np.intp),
        numbers[is_driven],
        tuple(m.copies.get(0, int(members.inner[n])) for n, m in zip(bodies, found, strict=True)),
    )


def _ranges(starts: IntArray, counts: IntArray) -> IntArray:
    """Chain ranges."""
    before = np.repeat(np.cumsum(counts) - counts, counts)
    return (np.arange(int(counts.sum())) - before + np.repeat(starts, counts)).astype(np.intp)


def joined(readings: Sequence[BodyStates]) -> BodyStates:
    """Chain what was read of cells."""
    if len(readings) == 1:
        return readings[0]
    return BodyStates(
        np.concatenate([np.zeros((0, 13)), *(reading.base for reading in readings)]),
        np.concatenate([np.zeros(0), *(reading.joint_positions for reading in readings)]),
        np.concatenate([np.zeros(0), *(reading.joint_velocities for reading in readings)]),
    )
