"""Proximity of discs and static edges: neighbour lists, near and clear checks."""

from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.kinematic.collision_limits import (
    DiscMotions,
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

NEAR_M = 0.02
"""Discs with a smaller gap are near each other, if any of them moves."""
CLEAR_M = 0.06
"""With a larger gap they are alone again."""
NEIGHBOUR_MARGIN_M = 2.0 * CLEAR_M
MOVING_M_S = 1e-3


@dataclass(frozen=True)
class MovingDiscs:
    """Bodies at a look.

    Attributes:
        centres: (n, 2).
        radius: (n,).
        pace: (n,) how fast [m/s] each may be until the next look.
        is_loose: (n,) whether it moves by itself or by others, and cannot be stopped here.
    """

    centres: FloatArray
    radius: FloatArray
    pace: FloatArray
    is_free_moving: BoolColumn


@dataclass(frozen=True)
class ProximityResult:
    """What a look found, a number each.

    Attributes:
        is_near: Whether it may touch something before the next look.
        is_alone: Whether nothing is anywhere near.
    """

    is_near: BoolColumn
    is_alone: BoolColumn


def find_discs_near_discs(
    discs: MovingDiscs, pairs: tuple[IntArray, IntArray], period_s: float
) -> ProximityResult:
    """See who has others near: at least one of two moves, or is loose."""
    one, other = pairs
    apart = np.hypot(*(discs.centres[one] - discs.centres[other]).T)
    gap = apart - discs.radius[one] - discs.radius[other]
    gap -= (discs.pace[one] + discs.pace[other]) * period_s
    is_moving = (discs.pace > MOVING_M_S) | discs.is_free_moving
    counts = is_moving[one] | is_moving[other]
    near, close = counts & (gap < NEAR_M), counts & (gap < CLEAR_M)
    is_near, is_alone = _all_false(discs), ~_all_false(discs)
    for side in (one, other):
        is_near[side[near]] = True
        is_alone[side[close]] = False
    return ProximityResult(is_near, is_alone)


def find_discs_near_edges(
    discs: MovingDiscs, edges: StaticEdges, pairs: tuple[IntArray, IntArray], period_s: float
) -> ProximityResult:
    """See who moves near an edge.

    Args:
        discs: All n.
        edges: All edges.
        pairs: A disc and an edge each, whose heights meet.
        period_s: Until the next look.
    """
    disc, edge = pairs
    _, gap = find_distances_to_edges(discs.centres[disc], edges.ends[edge])
    gap -= discs.radius[disc] + edges.thick[edge] + discs.pace[disc] * period_s
    counts = discs.pace[disc] > MOVING_M_S
    is_near, is_alone = _all_false(discs), ~_all_false(discs)
    is_near[disc[counts & (gap < NEAR_M)]] = True
    is_alone[disc[counts & (gap < CLEAR_M)]] = False
    return ProximityResult(is_near, is_alone)


def combine_results(one: ProximityResult, other: ProximityResult) -> ProximityResult:
    """Put two looks together."""
    return ProximityResult(one.is_near | other.is_near, one.is_alone & other.is_alone)


def _all_false(discs: MovingDiscs) -> BoolColumn:
    return np.zeros(len(discs.radius), np.bool_)


MIN_TRAVEL_M = 0.05
"""How far anybody may go, at least, before the lists are made anew."""
LOOKAHEAD_CHECKS = 4.0
"""For how many looks the lists are made, by how fast each is."""
SAMPLES_PER_CELL = 4
"""Points on an edge for each cell that it goes through."""


class NeighbourLists:
    """Pairs of discs that may meet, and discs that may meet edges.

    Attributes:
        one, other: (k,) indices of the discs of each pair.
        disc, edge: (m,) indices of a disc and of an edge.
    """

    def __init__(self, margin_m: float) -> None:
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
        """Take other edges."""
        self._edges, self._cells = edges, None
        self._is_valid = False

    def invalidate(self) -> None:
        """Make the lists anew next time: other discs are there."""
        self._is_valid = False

    def refresh(self, centres: FloatArray, radius: FloatArray, way: FloatArray) -> None:
        """See that the lists hold all who may meet.

        Args:
            centres: (n, 2) where discs are.
            radius: (n,).
            way: (n,) how far each may go until it is asked again.
        """
        self._travelled_m += float(way.max()) if len(way) else 0.0
        if self._is_valid and (
            self._travelled_m < MIN_TRAVEL_M or not self._is_too_far(centres, way)
        ):
            return
        self._travelled_m = 0.0
        self._centres = centres.copy()
        self._allowed = np.maximum(MIN_TRAVEL_M, LOOKAHEAD_CHECKS * way)
        reach = radius + self._allowed + self._margin_m / 2.0
        self.one, self.other = find_touching_discs(centres, reach)
        self.disc, self.edge = self._near_edges(centres, reach + self._margin_m / 2.0)
        self._is_valid = True

    def _is_too_far(self, centres: FloatArray, way: FloatArray) -> bool:
        gone = centres - self._centres
        left = self._allowed - way
        square = np.einsum("ij,ij->i", gone, gone)
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
        """Put points on all edges, so close that each edge is found by one of them."""
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


class ProximityIndex:
    """All discs that are there, and what never moves.

    Attributes:
        discs: (d,) rows of all that can move.
        mine: (n,) where the kinematic robots are among them.
    """

    def __init__(self, rows: TierBodyTable, kinematic: KinematicRobots, period_s: float) -> None:
        self.discs: IntArray = np.zeros(0, np.intp)
        self.mine: RowSelection = np.zeros(0, np.intp)
        self._at: RowSelection = self.mine
        self._known = rows
        self._kinematic = kinematic
        self._period_s = period_s
        self._neighbours = NeighbourLists(NEIGHBOUR_MARGIN_M)
        self._outlines: dict[int, StaticEdges] = {}
        self._edges: StaticEdges | None = NO_EDGES

    def set_outline(self, row: int, outline: StaticEdges) -> None:
        """Note what never moves, or that it was put elsewhere."""
        self._outlines[row] = outline
        self._edges = None

    def remove_outline(self, row: int) -> None:
        """Note that what never moved is gone."""
        if self._outlines.pop(row, None) is not None:
            self._edges = None

    def gather(self) -> None:
        """Note that bodies came, went, or changed tiers."""
        known = self._known
        discs = np.flatnonzero((known.tier != Tier.NONE) & ~known.is_static)
        if not np.array_equal(discs, self.discs):
            self._neighbours.invalidate()
        self.discs = discs
        place = np.zeros(len(known.tier), np.intp)
        place[discs] = np.arange(len(discs))
        self.mine = select_rows(place[self._kinematic.rows])
        self._at = select_rows(discs)

    def invalidate(self) -> None:
        """Note that somebody was put elsewhere."""
        self._neighbours.invalidate()

    def find_near(self) -> ProximityResult:
        """See who is near whom, until the next look."""
        known, rows = self._known, self.discs
        is_loose = (known.tier[rows] == Tier.FULL) & ~known.is_held[rows]
        discs = MovingDiscs(known.discs(self._at), known.radius[rows], known.pace[rows], is_loose)
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
        """Find how much (n,) of their ways (3, n) kinematic robots can go."""
        moves = self._kinematic.disc_motions(way, self._at, self.mine, self._period_s)
        self._refresh(moves.start, np.hypot(moves.way[:, 0], moves.way[:, 1]))
        neighbours, shares = self._neighbours, np.ones(len(self.discs))
        if len(neighbours.disc):
            shares = self._limit_by_edges(moves)
        if len(neighbours.one):
            shares = limit_by_other_discs(moves, neighbours.one, neighbours.other, shares)
        return shares[self.mine]

    def find_overlapping(self, row: int) -> tuple[list[int], bool]:
        """Find whose discs a disc reaches into, and whether it reaches an edge."""
        known = self._known
        rows = np.flatnonzero((known.tier != Tier.NONE) & ~known.is_static)
        rows = rows[rows != row]
        centre = known.discs(np.array([row]))
        apart = np.hypot(*(known.discs(rows) - centre).T)
        found: list[int] = rows[apart < known.radius[rows] + known.radius[row]].tolist()
        edges = self._static_edges()
        if not len(edges):
            return found, False
        _, gap = find_distances_to_edges(np.broadcast_to(centre, (len(edges), 2)), edges.ends)
        return found, bool((gap < edges.thick + known.radius[row]).any())

    def _limit_by_edges(self, moves: DiscMotions) -> FloatArray:
        disc, edge = self._edge_pairs_at_height()
        edges = self._static_edges()
        may = moves.may_stop[disc]
        return limit_by_edges(moves, disc[may], edges.ends[edge[may]], edges.thick[edge[may]])

    def _edge_pairs_at_height(self) -> tuple[IntArray, IntArray]:
        """Pairs of a disc and an edge near it that is as high as it."""
        known, disc, edge = self._known, self._neighbours.disc, self._neighbours.edge
        rows, heights = self.discs[disc], self._static_edges().heights[edge]
        low = known.place[2, rows] + known.heights[0, rows] + CLEARABLE_HEIGHT_M
        high = known.place[2, rows] + known.heights[1, rows]
        meets = (heights[:, 0] < high) & (heights[:, 1] > low)
        return disc[meets], edge[meets]

    def _refresh(self, centres: FloatArray, way: FloatArray) -> None:
        known = self._known
        self._static_edges()
        far = np.maximum(way, known.pace[self._at] * self._period_s)
        self._neighbours.refresh(centres, known.radius[self._at], far)

    def _static_edges(self) -> StaticEdges:
        if self._edges is None:
            self._edges = concatenate_edges(list(self._outlines.values()))
            self._neighbours.set_edges(self._edges)
        return self._edges
