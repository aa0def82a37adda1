"""Where all discs and edges of a world are: how far robots may go, and who is near whom."""

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.tiers.blocking import (
    Moves,
    from_edges,
    shares_by_each_other,
    shares_by_edges,
)
from zensim.sim_server.physics.tiers.grid import IntArray
from zensim.sim_server.physics.tiers.kinematic import STEP_OVER_M, Kinematic
from zensim.sim_server.physics.tiers.lookout import (
    MARGIN_M,
    Discs,
    Sight,
    both,
    look,
    look_at_edges,
)
from zensim.sim_server.physics.tiers.neighbours import Neighbours
from zensim.sim_server.physics.tiers.outline import NO_EDGES, Edges, joined
from zensim.sim_server.physics.tiers.rows import At, Rows, Tier, at_rows


class Surroundings:
    """All discs that are there, and what never moves.

    Attributes:
        discs: (d,) rows of all that can move.
        mine: (n,) where the kinematic robots are among them.
    """

    def __init__(self, rows: Rows, kinematic: Kinematic, period_s: float) -> None:
        self.discs: IntArray = np.zeros(0, np.intp)
        self.mine: At = np.zeros(0, np.intp)
        self._at: At = self.mine
        self._known = rows
        self._kinematic = kinematic
        self._period_s = period_s
        self._neighbours = Neighbours(MARGIN_M)
        self._outlines: dict[int, Edges] = {}
        self._edges: Edges | None = NO_EDGES

    def stand(self, row: int, outline: Edges) -> None:
        """Note what never moves, or that it was put elsewhere."""
        self._outlines[row] = outline
        self._edges = None

    def clear(self, row: int) -> None:
        """Note that what never moved is gone."""
        if self._outlines.pop(row, None) is not None:
            self._edges = None

    def gather(self) -> None:
        """Note that bodies came, went, or changed tiers."""
        known = self._known
        discs = np.flatnonzero((known.tier != Tier.NONE) & ~known.is_static)
        if not np.array_equal(discs, self.discs):
            self._neighbours.forget()
        self.discs = discs
        place = np.zeros(len(known.tier), np.intp)
        place[discs] = np.arange(len(discs))
        self.mine = at_rows(place[self._kinematic.rows])
        self._at = at_rows(discs)

    def moved(self) -> None:
        """Note that somebody was put elsewhere."""
        self._neighbours.forget()

    def look(self) -> Sight:
        """See who is near whom, until the next look."""
        known, rows = self._known, self.discs
        is_loose = (known.tier[rows] == Tier.FULL) & ~known.is_held[rows]
        discs = Discs(known.discs(self._at), known.radius[rows], known.pace[rows], is_loose)
        self._refresh(discs.centres, np.zeros(len(rows)))
        neighbours = self._neighbours
        found = look(discs, (neighbours.one, neighbours.other), self._period_s)
        if len(self._standing()):
            near = look_at_edges(discs, self._standing(), self._before(), self._period_s)
            found = both(found, near)
        return found

    def shares(self, way: FloatArray) -> FloatArray:
        """Find how much (n,) of their ways (3, n) kinematic robots can go."""
        moves = self._kinematic.moves(way, self._at, self.mine, self._period_s)
        self._refresh(moves.start, np.hypot(moves.way[:, 0], moves.way[:, 1]))
        neighbours, shares = self._neighbours, np.ones(len(self.discs))
        if len(neighbours.disc):
            shares = self._shares_by_edges(moves)
        if len(neighbours.one):
            shares = shares_by_each_other(moves, neighbours.one, neighbours.other, shares)
        return shares[self.mine]

    def within(self, row: int) -> tuple[list[int], bool]:
        """Find whose discs a disc reaches into, and whether it reaches an edge."""
        known = self._known
        rows = np.flatnonzero((known.tier != Tier.NONE) & ~known.is_static)
        rows = rows[rows != row]
        centre = known.discs(np.array([row]))
        apart = np.hypot(*(known.discs(rows) - centre).T)
        found: list[int] = rows[apart < known.radius[rows] + known.radius[row]].tolist()
        edges = self._standing()
        if not len(edges):
            return found, False
        _, gap = from_edges(np.broadcast_to(centre, (len(edges), 2)), edges.ends)
        return found, bool((gap < edges.thick + known.radius[row]).any())

    def _shares_by_edges(self, moves: Moves) -> FloatArray:
        disc, edge = self._before()
        edges = self._standing()
        may = moves.may_stop[disc]
        return shares_by_edges(moves, disc[may], edges.ends[edge[may]], edges.thick[edge[may]])

    def _before(self) -> tuple[IntArray, IntArray]:
        """Pairs of a disc and an edge near it that is as high as it."""
        known, disc, edge = self._known, self._neighbours.disc, self._neighbours.edge
        rows, heights = self.discs[disc], self._standing().heights[edge]
        low = known.place[2, rows] + known.heights[0, rows] + STEP_OVER_M
        high = known.place[2, rows] + known.heights[1, rows]
        meets = (heights[:, 0] < high) & (heights[:, 1] > low)
        return disc[meets], edge[meets]

    def _refresh(self, centres: FloatArray, way: FloatArray) -> None:
        known = self._known
        self._standing()
        far = np.maximum(way, known.pace[self._at] * self._period_s)
        self._neighbours.refresh(centres, known.radius[self._at], far)

    def _standing(self) -> Edges:
        if self._edges is None:
            self._edges = joined(list(self._outlines.values()))
            self._neighbours.set_edges(self._edges)
        return self._edges
