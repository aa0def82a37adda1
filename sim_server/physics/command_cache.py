"""The last targets of each body, so that only changed ones are sent to the engine."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.engine import FloatArray

IntArray = npt.NDArray[np.intp]
MAX_CACHED_INDEXES = 256


@dataclass(frozen=True)
class _TargetIndex:
    """Where the numbers of some bodies stand.

    Attributes:
        places: Of each number, in what all bodies were told.
        rows: The body, by its place in the row of bodies, that each number is for.
        starts: Where the numbers of each body begin, and where those of the last end.
    """

    places: IntArray
    rows: IntArray
    starts: list[int]


class CommandCache:
    """The newest numbers of each body; those of one that was told nothing are NaN."""

    def __init__(self, width_of: Callable[[int], int]) -> None:
        self._width_of = width_of
        self._targets: FloatArray = np.full((64, 1), np.nan)
        self._indexes: dict[tuple[int, ...], _TargetIndex] = {}

    def forget(self, body: int) -> None:
        """Note that a body has come, has gone, or was moved past its orders."""
        if body < len(self._targets):
            self._targets[body] = np.nan
        self._indexes.clear()

    def take_changed(
        self, bodies: Sequence[int], numbers: FloatArray
    ) -> Iterator[tuple[int, list[float]]]:
        """List the bodies that are told something new, and their numbers; they are told now."""
        plan = self._find_index(tuple(bodies))
        told = self._targets.reshape(-1)
        is_new = told[plan.places] != numbers
        if not is_new.any():
            return
        told[plan.places] = numbers
        listed = numbers.tolist()
        for row in np.unique(plan.rows[is_new]).tolist():
            yield bodies[row], listed[plan.starts[row] : plan.starts[row + 1]]

    def _find_index(self, bodies: tuple[int, ...]) -> _TargetIndex:
        if (plan := self._indexes.get(bodies)) is None:
            if len(self._indexes) == MAX_CACHED_INDEXES:
                self._indexes.clear()
            plan = self._indexes[bodies] = self._make_index(bodies)
        return plan

    def _make_index(self, bodies: tuple[int, ...]) -> _TargetIndex:
        widths = np.array([self._width_of(body) for body in bodies], dtype=np.intp)
        self._make_room(max(bodies, default=0), int(widths.max(initial=0)))
        starts = np.concatenate([[0], np.cumsum(widths)])
        rows = np.repeat(np.arange(len(bodies)), widths)
        columns = np.arange(starts[-1]) - starts[rows]
        places = np.array(bodies, dtype=np.intp)[rows] * self._targets.shape[1] + columns
        return _TargetIndex(places, rows, starts.tolist())

    def _make_room(self, body: int, width: int) -> None:
        height, had = self._targets.shape
        if body < height and width <= had:
            return
        while height <= body:
            height *= 2
        told = np.full((height, max(width, had)), np.nan)
        told[: len(self._targets), :had] = self._targets
        self._targets = told
        self._indexes.clear()
