"""Proximity of discs in the plane: neighbour lists of discs and edges, and what is free to move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zensim.sim_server.physics.kinematic.collision_limits import (
    DiscMotions,
    dot_rows,
    find_distances_to_edges,
    limit_by_edges,
    limit_by_other_discs,
)
from zensim.sim_server.physics.kinematic.kinematic_robots import CLEARABLE_HEIGHT_M, KinematicRobots
from zensim.sim_server.physics.kinematic.tier_body_table import (
    BoolColumn,
    RowSelection,
    Tier,
    TierBodyTable,
    select_rows,
)
from zensim.sim_server.scene.broad_phase import (
    IntArray,
    PointGrid,
    find_near_points,
    find_touching_discs,
    make_point_grid,
)
from zensim.sim_server.scene.footprints import NO_EDGES, StaticEdges, concatenate_edges

if TYPE_CHECKING:
    from zensim.sim_server.physics.engine import FloatArray

NEAR_M = 0.02
"""Discs with a smaller gap are near each other, if one of them moves."""
CLEAR_M = 0.06
"""Discs with a larger gap to all others are clear."""
NEIGHBOUR_MARGIN_M = 2.0 * CLEAR_M
MOVING_M_S = 1e-3
MIN_APART_M = 1e-9
NONE_STOPPED = np.zeros(0, np.intp), np.zeros((0, 2))


@dataclass(frozen=True)
class MovingDiscs:
    """Discs of n bodies at one check.

    Attributes:
        centres: (n, 2).
        radius: (n,).
        pace: (n,) bounds of their speeds [m/s] until the next check.
        is_free_moving: (n,) whether only the full engine moves it.
    """

    centres: FloatArray
    radius: FloatArray
    pace: FloatArray
    is_free_moving: BoolColumn


@dataclass(frozen=True)
class ProximityResult:
    """Result of a check for n discs.

    Attributes:
        is_near: (n,) whether it can touch something before the next check.
        is_clear: (n,) whether nothing is near.
    """

    is_near: BoolColumn
    is_clear: BoolColumn


def find_discs_near_discs(
    discs: MovingDiscs, pairs: tuple[IntArray, IntArray], period_s: float
) -> ProximityResult:
    """Check discs against discs; pairs of which neither moves do not count."""
    one, other = pairs
    apart = np.hypot(*(discs.centres[one] - discs.centres[other]).T)
    gap = apart - discs.radius[one] - discs.radius[other]
    gap -= (discs.pace[one] + discs.pace[other]) * period_s
    is_moving = (discs.pace > MOVING_M_S) | discs.is_free_moving
    counts = is_moving[one] | is_moving[other]
    near, close = counts & (gap < NEAR_M), counts & (gap < CLEAR_M)
    is_near, is_clear = _all_false(discs), ~_all_false(discs)
    for side in (one, other):
        is_near[side[near]] = True
        is_clear[side[close]] = False
    return ProximityResult(is_near, is_clear)


def find_discs_near_edges(
    discs: MovingDiscs, edges: StaticEdges, pairs: tuple[IntArray, IntArray], period_s: float
) -> ProximityResult:
    """Check moving discs against edges.

    Args:
        discs: All n.
        edges: All edges.
        pairs: Indices of discs and of edges at overlapping heights.
        period_s: Time until the next check.
    """
    disc, edge = pairs
    _, gap = find_distances_to_edges(discs.centres[disc], edges.ends[edge])
    gap -= discs.radius[disc] + edges.thick[edge] + discs.pace[disc] * period_s
    counts = discs.pace[disc] > MOVING_M_S
    is_near, is_clear = _all_false(discs), ~_all_false(discs)
    is_near[disc[counts & (gap < NEAR_M)]] = True
    is_clear[disc[counts & (gap < CLEAR_M)]] = False
    return ProximityResult(is_near, is_clear)


def combine_results(one: ProximityResult, other: ProximityResult) -> ProximityResult:
    """Combine two results."""
    return ProximityResult(one.is_near | other.is_near, one.is_clear & other.is_clear)


def _all_false(discs: MovingDiscs) -> BoolColumn:
    return np.zeros(len(discs.radius), np.bool_)


MIN_TRAVEL_M = 0.05
"""Least distance that a disc can move before the lists are rebuilt."""
LOOKAHEAD_CHECKS = 4.0
"""Checks for which the lists hold, by the speed of each disc."""
SAMPLES_PER_CELL = 4
"""Sample points on an edge per cell of the grid."""
MAX_PAIRED_DISCS = 24
"""Discs of a world, of many, up to which all pairs are listed."""
MAX_APPENDED_DISCS = 64
"""Discs that are compared with all others; with more, all lists are rebuilt."""


class NeighbourLists:
    """Pairs of discs, and of discs and edges, that can meet (a Verlet list).

    Discs of different worlds never meet; those of small worlds are all paired, once.

    Attributes:
        one, other: (k,) indices of the discs of each pair.
        disc, edge: (m,) indices of a disc and of an edge.
    """

    def __init__(self, margin_m: float, worlds: int = 1) -> None:
        self._worlds = worlds
        self.one: IntArray = np.zeros(0, np.intp)
        self.other: IntArray = np.zeros(0, np.intp)
        self.disc: IntArray = np.zeros(0, np.intp)
        self.edge: IntArray = np.zeros(0, np.intp)
        self._margin_m = margin_m
        self._centres: FloatArray = np.zeros((0, 2))
        self._allowed: FloatArray = np.zeros(0)
        self._edges = NO_EDGES
        self._cells: PointGrid | None = None
        self._samples: FloatArray = np.zeros((0, 2))
        self._owners: IntArray = np.zeros(0, np.intp)
        self._is_valid = False
        self._travelled_m = 0.0

    def set_edges(self, edges: StaticEdges) -> None:
        """Replace the edges."""
        self._edges, self._cells = edges, None
        self._is_valid = False

    def invalidate(self) -> None:
        """Rebuild the lists at the next refresh."""
        self._is_valid = False

    def refresh(self, centres: FloatArray, radius: FloatArray, way: FloatArray) -> None:
        """Rebuild the lists if a pair that can meet could be missing.

        Args:
            centres: (n, 2).
            radius: (n,).
            way: (n,) bounds of the distance to the next refresh.
        """
        if self._is_valid and not len(self._edges) and self._has_small_worlds(len(centres)):
            return
        self._travelled_m += float(way.max()) if len(way) else 0.0
        if 0 < len(centres) - len(self._centres) <= MAX_APPENDED_DISCS and self._is_valid:
            self._append(centres, radius, way)
        if (
            self._is_valid
            and len(centres) == len(self._centres)
            and (self._travelled_m < MIN_TRAVEL_M or not self._is_too_far(centres, way))
        ):
            return
        self._travelled_m = 0.0
        self._centres = centres.copy()
        self._allowed = np.maximum(MIN_TRAVEL_M, LOOKAHEAD_CHECKS * way)
        reach = radius + self._allowed + self._margin_m / 2.0
        self.one, self.other = self._find_pairs(centres, reach)
        self.disc, self.edge = self._near_edges(centres, reach + self._margin_m / 2.0)
        self._is_valid = True

    def _has_small_worlds(self, discs: int) -> bool:
        return self._worlds > 1 and discs <= MAX_PAIRED_DISCS * self._worlds

    def _find_pairs(self, centres: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
        """Find the pairs of discs of one world; worlds follow each other."""
        if self._worlds == 1:
            return find_touching_discs(centres, reach)
        discs = len(centres) // self._worlds
        starts = np.arange(self._worlds)[:, None] * discs
        if self._has_small_worlds(len(centres)):
            one, other = np.triu_indices(discs, 1)
            return (starts + one).reshape(-1), (starts + other).reshape(-1)
        x = centres[:, 0]
        side_m = float(x.max() - x.min()) + 2.0 * float(reach.max()) + 1.0
        beside = centres + np.outer(np.repeat(np.arange(self._worlds), discs), (side_m, 0.0))
        return find_touching_discs(beside, reach)

    def _append(self, centres: FloatArray, radius: FloatArray, way: FloatArray) -> None:
        """Add the pairs of discs that follow those of the lists."""
        count = len(self._centres)
        self._centres = np.concatenate([self._centres, centres[count:]])
        more = np.maximum(MIN_TRAVEL_M, LOOKAHEAD_CHECKS * way[count:])
        self._allowed = np.concatenate([self._allowed, more])
        reach = radius + self._allowed + self._margin_m / 2.0
        firsts, seconds = [self.one], [self.other]
        for number in range(count, len(centres)):
            away = self._centres[:number] - self._centres[number]
            total = reach[:number] + reach[number]
            near = np.flatnonzero(dot_rows(away, away) <= total * total)
            firsts.append(near)
            seconds.append(np.full(len(near), number))
        self.one, self.other = np.concatenate(firsts), np.concatenate(seconds)
        far = reach[count:] + self._margin_m / 2.0
        disc, edge = self._near_edges(self._centres[count:], far)
        self.disc = np.concatenate([self.disc, disc + count])
        self.edge = np.concatenate([self.edge, edge])

    def _is_too_far(self, centres: FloatArray, way: FloatArray) -> bool:
        moved = centres - self._centres
        left = self._allowed - way
        square = dot_rows(moved, moved)
        return bool(((left < 0.0) | (square > left * left)).any())

    def _near_edges(self, centres: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
        if not len(self._edges) or not len(centres):
            return np.zeros(0, np.intp), np.zeros(0, np.intp)
        far = float(reach.max()) + float(self._edges.thick.max())
        cells = self._cells
        if cells is None or far > cells.size_m * (1.0 - 1.0 / SAMPLES_PER_CELL):
            cells = self._cells = self._sampled(far * (1.0 + 2.0 / SAMPLES_PER_CELL))
        within = far + cells.size_m / SAMPLES_PER_CELL / 2.0
        disc, sample = find_near_points(cells, self._samples, centres, within)
        pairs = np.unique(np.stack([disc, self._owners[sample]], axis=1), axis=0)
        disc, edge = pairs[:, 0], pairs[:, 1]
        _, apart = find_distances_to_edges(centres[disc], self._edges.ends[edge])
        is_near = apart <= reach[disc] + self._edges.thick[edge]
        return disc[is_near], edge[is_near]

    def _sampled(self, size_m: float) -> PointGrid:
        """Sample all edges so densely that each is found by one of its points."""
        ends = self._edges.ends
        along = ends[:, 2:] - ends[:, :2]
        parts = (
            np.ceil(np.hypot(along[:, 0], along[:, 1]) / size_m * SAMPLES_PER_CELL).astype(np.intp)
            + 1
        )
        self._owners = np.repeat(np.arange(len(ends)), parts)
        at = np.arange(len(self._owners)) - np.repeat(np.cumsum(parts) - parts, parts)
        share = at / np.maximum(parts[self._owners] - 1, 1)
        self._samples = ends[self._owners, :2] + along[self._owners] * share[:, None]
        return make_point_grid(self._samples, size_m)


@dataclass(frozen=True)
class Obstacle:
    """What stops a disc: the row of a body, the point (3,), the direction (2,) from it."""

    row: int
    point: tuple[float, float, float]
    normal: FloatArray


class ProximityIndex:
    """Discs of all bodies that can move, and edges of all that cannot.

    Attributes:
        discs: (d,) rows of bodies that can move.
        own: (n,) indices of the kinematic robots among them.
    """

    def __init__(
        self, rows: TierBodyTable, kinematic: KinematicRobots, period_s: float, worlds: int = 1
    ) -> None:
        self.discs: IntArray = np.zeros(0, np.intp)
        self.own: RowSelection = np.zeros(0, np.intp)
        self._at: RowSelection = self.own
        self._table = rows
        self._kinematic = kinematic
        self._period_s = period_s
        self._neighbours = NeighbourLists(NEIGHBOUR_MARGIN_M, worlds)
        self._outlines: dict[int, StaticEdges] = {}
        self._edges: StaticEdges | None = NO_EDGES

    def tile(self, rows: TierBodyTable, kinematic: KinematicRobots, copies: int) -> ProximityIndex:
        """Make the index of copies of the robots, each among the edges of this one."""
        found = ProximityIndex(rows, kinematic, self._period_s, copies)
        for body, outline in self._outlines.items():
            found.set_outline(body, outline)
        found.gather()
        return found

    def set_outline(self, row: int, outline: StaticEdges) -> None:
        """Set the edges of a static body."""
        self._outlines[row] = outline
        self._edges = None

    def remove_outline(self, row: int) -> None:
        """Remove the edges of a static body."""
        if self._outlines.pop(row, None) is not None:
            self._edges = None

    def gather(self) -> None:
        """Update the rows after bodies came, went or changed tiers."""
        table = self._table
        is_disc = (table.tier == Tier.FULL) | (table.tier == Tier.KINEMATIC)
        discs = np.flatnonzero(is_disc & ~table.is_static)
        if not np.array_equal(discs[: len(self.discs)], self.discs):
            self._neighbours.invalidate()
        self.discs = discs
        place = np.zeros(len(table.tier), np.intp)
        place[discs] = np.arange(len(discs))
        self.own = select_rows(place[self._kinematic.rows])
        self._at = select_rows(discs)

    def invalidate(self) -> None:
        """Rebuild the neighbour lists: a body was moved by a request."""
        self._neighbours.invalidate()

    def find_near(self) -> ProximityResult:
        """Check all discs for the time until the next check."""
        table, rows = self._table, self.discs
        is_free_moving = (table.tier[rows] == Tier.FULL) & ~table.is_held[rows]
        discs = MovingDiscs(
            table.discs(self._at), table.radius[rows], table.pace[rows], is_free_moving
        )
        self._refresh(discs.centres, np.zeros(len(rows)))
        neighbours = self._neighbours
        found = find_discs_near_discs(discs, (neighbours.one, neighbours.other), self._period_s)
        if len(self._static_edges()):
            near = find_discs_near_edges(
                discs, self._static_edges(), self._edge_pairs_at_height(), self._period_s
            )
            found = combine_results(found, near)
        return found

    def find_free_fractions(self, way: FloatArray) -> FloatArray:
        """Find the fractions (n,) of displacements (3, n) that are free for kinematic robots."""
        moves = self._kinematic.disc_motions(way, self._at, self.own, self._period_s)
        self._refresh(moves.start, np.hypot(moves.way[:, 0], moves.way[:, 1]))
        neighbours, fractions = self._neighbours, np.ones(len(self.discs))
        if len(neighbours.disc):
            fractions = self._limit_by_edges(moves)
        if len(neighbours.one):
            fractions = limit_by_other_discs(moves, neighbours.one, neighbours.other, fractions)
        return fractions[self.own]

    def find_touched(self, stopped: IntArray) -> IntArray:
        """Find the rows (t,) of discs beside those of stopped rows (s,), which are among them."""
        table, lists = self._table, self._neighbours
        is_stopped = np.zeros(len(table.tier), np.bool_)
        is_stopped[stopped] = True
        one, other = self.discs[lists.one], self.discs[lists.other]
        chosen = np.flatnonzero(is_stopped[one] | is_stopped[other])
        one, other = one[chosen], other[chosen]
        apart = table.discs(one) - table.discs(other)
        within = table.radius[one] + table.radius[other] + NEAR_M
        is_near = dot_rows(apart, apart) < within * within
        return np.concatenate([stopped, one[is_near], other[is_near]])

    def find_overlapping(self, row: int) -> tuple[list[int], bool]:
        """Find the rows of discs that a disc overlaps, and whether it overlaps an edge."""
        table = self._table
        centre = table.discs(slice(row, row + 1))
        rows = self._list_near_rows(row, centre)
        apart = np.hypot(*(table.discs(rows) - centre).T)
        found: list[int] = rows[apart < table.radius[rows] + table.radius[row]].tolist()
        edges = self._static_edges()
        if not len(edges):
            return found, False
        _, gap = find_distances_to_edges(np.broadcast_to(centre, (len(edges), 2)), edges.ends)
        return found, bool((gap < edges.thick + table.radius[row]).any())

    def _list_near_rows(self, row: int, centre: FloatArray) -> IntArray:
        """List the rows of other discs that may overlap one; few of many."""
        table = self._table
        far = table.radius[row] + table.reach_m
        rows = np.flatnonzero(np.abs(table.place[0] - centre[0, 0]) <= far)
        rows = rows[np.abs(table.place[1, rows] - centre[0, 1]) <= far]
        rows = rows[(table.tier[rows] != Tier.NONE) & ~table.is_static[rows]]
        return np.asarray(rows[rows != row])

    def find_obstacle(self, row: int, way: FloatArray) -> Obstacle | None:
        """Find what stops the disc of a row that should have moved by `way` (2,)."""
        table = self._table
        (centre,) = table.discs(np.array([row]))
        others = self.discs[self.discs != row]
        between = centre - table.discs(others)
        apart = np.hypot(between[:, 0], between[:, 1])
        away = [between / np.maximum(apart, MIN_APART_M)[:, None]]
        gap, bodies = [apart - table.radius[others]], [others]
        low, high = table.place[2, row] + table.heights[:, row]
        for body, edges in self._outlines.items():
            meets = (edges.heights[:, 0] < high) & (edges.heights[:, 1] > low + CLEARABLE_HEIGHT_M)
            ends = edges.ends[meets]
            from_edges, apart = find_distances_to_edges(np.tile(centre, (len(ends), 1)), ends)
            away.append(from_edges)
            gap.append(apart - edges.thick[meets])
            bodies.append(np.full(len(ends), body))
        directions = np.concatenate(away)
        gaps = np.concatenate(gap) - table.radius[row]
        gaps[directions @ way > 0.0] = np.inf
        if not len(gaps) or gaps.min() > NEAR_M:
            return None
        nearest = int(gaps.argmin())
        normal = directions[nearest]
        point = centre - normal * table.radius[row]
        return Obstacle(int(np.concatenate(bodies)[nearest]), (*point, (low + high) / 2.0), normal)

    def _limit_by_edges(self, moves: DiscMotions) -> FloatArray:
        disc, edge = self._edge_pairs_at_height()
        edges = self._static_edges()
        can_stop = moves.may_stop[disc]
        return limit_by_edges(
            moves, disc[can_stop], edges.ends[edge[can_stop]], edges.thick[edge[can_stop]]
        )

    def _edge_pairs_at_height(self) -> tuple[IntArray, IntArray]:
        """List pairs of a disc and a near edge at overlapping heights."""
        table, disc, edge = self._table, self._neighbours.disc, self._neighbours.edge
        rows, heights = self.discs[disc], self._static_edges().heights[edge]
        low = table.place[2, rows] + table.heights[0, rows] + CLEARABLE_HEIGHT_M
        high = table.place[2, rows] + table.heights[1, rows]
        meets = (heights[:, 0] < high) & (heights[:, 1] > low)
        return disc[meets], edge[meets]

    def _refresh(self, centres: FloatArray, way: FloatArray) -> None:
        table = self._table
        self._static_edges()
        far = np.maximum(way, table.pace[self._at] * self._period_s)
        self._neighbours.refresh(centres, table.radius[self._at], far)

    def _static_edges(self) -> StaticEdges:
        if self._edges is None:
            self._edges = concatenate_edges(list(self._outlines.values()))
            self._neighbours.set_edges(self._edges)
        return self._edges


def step_robots(
    kinematic: KinematicRobots, surroundings: ProximityIndex
) -> tuple[IntArray, FloatArray]:
    """Move all kinematic robots by a step: joints, twists, arcs, and stops before obstacles.

    Returns:
        Rows (s,) that obstacles stopped, and the displacements (s, 2) that they shortened.
    """
    twists, way = kinematic.propose_motions()
    if not way.shape[1]:
        return NONE_STOPPED
    fractions = surroundings.find_free_fractions(way)
    stopped = NONE_STOPPED
    if fractions.min() < 1.0:
        held = np.flatnonzero(fractions < 1.0)
        stopped = kinematic.rows[held], way[:2, held].T.copy()
    kinematic.commit(twists, way, fractions)
    return stopped
