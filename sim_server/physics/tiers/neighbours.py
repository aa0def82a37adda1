"""Who may meet whom for a while: lists that stay true until somebody has gone too far."""

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.tiers.blocking import from_edges
from zensim.sim_server.physics.tiers.grid import Cells, IntArray, cells_of, close_pairs, near_points
from zensim.sim_server.physics.tiers.outline import NO_EDGES, Edges

LEAST_M = 0.05
"""How far anybody may go, at least, before the lists are made anew."""
AHEAD = 4.0
"""For how many looks the lists are made, by how fast each is."""
SAMPLES = 4
"""Points on an edge for each cell that it goes through."""


class Neighbours:
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
        self._cells: Cells | None = None
        self._samples: FloatArray = np.zeros((0, 2))
        self._owners: IntArray = np.zeros(0, np.intp)
        self._is_true = False
        self._gone_m = 0.0

    def set_edges(self, edges: Edges) -> None:
        """Take other edges."""
        self._edges, self._cells = edges, None
        self._is_true = False

    def forget(self) -> None:
        """Make the lists anew next time: other discs are there."""
        self._is_true = False

    def refresh(self, centres: FloatArray, radius: FloatArray, way: FloatArray) -> None:
        """See that the lists hold all who may meet.

        Args:
            centres: (n, 2) where discs are.
            radius: (n,).
            way: (n,) how far each may go until it is asked again.
        """
        self._gone_m += float(way.max()) if len(way) else 0.0
        if self._is_true and (self._gone_m < LEAST_M or not self._is_too_far(centres, way)):
            return
        self._gone_m = 0.0
        self._centres = centres.copy()
        self._allowed = np.maximum(LEAST_M, AHEAD * way)
        reach = radius + self._allowed + self._margin_m / 2.0
        self.one, self.other = close_pairs(centres, reach)
        self.disc, self.edge = self._near_edges(centres, reach + self._margin_m / 2.0)
        self._is_true = True

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
        if cells is None or far > cells.size_m * (1.0 - 1.0 / SAMPLES):
            cells = self._cells = self._sampled(far * (1.0 + 2.0 / SAMPLES))
        within = far + cells.size_m / SAMPLES / 2.0
        disc, sample = near_points(cells, self._samples, centres, within)
        pairs = np.unique(np.stack([disc, self._owners[sample]], axis=1), axis=0)
        disc, edge = pairs[:, 0], pairs[:, 1]
        _, apart = from_edges(centres[disc], self._edges.ends[edge])
        is_near = apart <= reach[disc] + self._edges.thick[edge]
        return disc[is_near], edge[is_near]

    def _sampled(self, size_m: float) -> Cells:
        """Put points on all edges, so close that each edge is found by one of them."""
        ends = self._edges.ends
        along = ends[:, 2:] - ends[:, :2]
        parts = np.ceil(np.hypot(along[:, 0], along[:, 1]) / size_m * SAMPLES).astype(np.intp) + 1
        self._owners = np.repeat(np.arange(len(ends)), parts)
        at = np.arange(len(self._owners)) - np.repeat(np.cumsum(parts) - parts, parts)
        share = at / np.maximum(parts[self._owners] - 1, 1)
        self._samples = ends[self._owners, :2] + along[self._owners] * share[:, None]
        return cells_of(self._samples, size_m)
