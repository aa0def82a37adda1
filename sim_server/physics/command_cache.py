"""Last targets of each body, so that only changed ones are sent to the engine."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from zensim.sim_server.physics.engine import FloatArray, IntArray

MAX_CACHED_INDEXES = 256


@dataclass(frozen=True)
class _TargetIndex:
    """Indexes of the targets of some bodies.

    Attributes:
        columns: Of each target, in the flattened targets of all bodies.
        rows: Of the body of each target, in the sequence of bodies.
        starts: Of the first target of each body, and the end of the last.
    """

    columns: IntArray
    rows: IntArray
    starts: list[int]


class CommandCache:
    """Newest targets of each body; NaN where never commanded."""

    def __init__(self, width_of: Callable[[int], int]) -> None:
        self._width_of = width_of
        self._targets: FloatArray = np.full((64, 1), np.nan)
        self._indexes: dict[tuple[int, ...], _TargetIndex] = {}

    def forget(self, body: int) -> None:
        """Forget the targets of a body: it is new, removed, or was reset."""
        if body < len(self._targets):
            self._targets[body] = np.nan
        self._indexes.clear()

    def find(self, body: int, width: int) -> list[float]:
        """Find the targets of a body; 0 if it was never commanded."""
        if body >= len(self._targets) or width > self._targets.shape[1]:
            return [0.0] * width
        found: list[float] = np.nan_to_num(self._targets[body, :width]).tolist()
        return found

    def take_changed(
        self, bodies: Sequence[int], targets: FloatArray
    ) -> Iterator[tuple[int, list[float]]]:
        """Store targets; yield the bodies whose targets changed, with their targets."""
        index = self._find_index(tuple(bodies))
        stored = self._targets.reshape(-1)
        is_changed = stored[index.columns] != targets
        if not is_changed.any():
            return
        stored[index.columns] = targets
        listed = targets.tolist()
        for row in np.unique(index.rows[is_changed]).tolist():
            yield bodies[row], listed[index.starts[row] : index.starts[row + 1]]

    def _find_index(self, bodies: tuple[int, ...]) -> _TargetIndex:
        if (index := self._indexes.get(bodies)) is None:
            if len(self._indexes) == MAX_CACHED_INDEXES:
                self._indexes.clear()
            index = self._indexes[bodies] = self._make_index(bodies)
        return index

    def _make_index(self, bodies: tuple[int, ...]) -> _TargetIndex:
        widths = np.array([self._width_of(body) for body in bodies], dtype=np.intp)
        self._make_room(max(bodies, default=0), int(widths.max(initial=0)))
        starts = np.concatenate([[0], np.cumsum(widths)])
        rows = np.repeat(np.arange(len(bodies)), widths)
        within = np.arange(starts[-1]) - starts[rows]
        columns = np.array(bodies, dtype=np.intp)[rows] * self._targets.shape[1] + within
        return _TargetIndex(columns, rows, starts.tolist())

    def _make_room(self, body: int, width: int) -> None:
        height, old_width = self._targets.shape
        if body < height and width <= old_width:
            return
        while height <= body:
            height *= 2
        grown = np.full((height, max(width, old_width)), np.nan)
        grown[: len(self._targets), :old_width] = self._targets
        self._targets = grown
        self._indexes.clear()
