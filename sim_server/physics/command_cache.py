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
        self._told: FloatArray = np.full((64, 1), np.nan)
        self._plans: dict[tuple[int, ...], _TargetIndex] = {}

    def forget(self, body: int) -> None:
        """Note that a body has come, has gone, or was moved past its orders."""
        if body < len(self._told):
            self._told[body] = np.nan
        self._plans.clear()

    def take_changed(
        self, bodies: Sequence[int], numbers: FloatArray
    ) -> Iterator[tuple[int, list[float]]]:
        """List the bodies that are told something new, and their numbers; they are told now."""
        plan = self._plan(tuple(bodies))
        told = self._told.reshape(-1)
        is_new = told[plan.places] != numbers
        if not is_new.any():
            return
        told[plan.places] = numbers
        listed = numbers.tolist()
        for row in np.unique(plan.rows[is_new]).tolist():
            yield bodies[row], listed[plan.starts[row] : plan.starts[row + 1]]

    def _plan(self, bodies: tuple[int, ...]) -> _TargetIndex:
        if (plan := self._plans.get(bodies)) is None:
            if len(self._plans) == MAX_CACHED_INDEXES:
                self._plans.clear()
            plan = self._plans[bodies] = self._planned(bodies)
        return plan

    def _planned(self, bodies: tuple[int, ...]) -> _TargetIndex:
        widths = np.array([self._width_of(body) for body in bodies], dtype=np.intp)
        self._make_room(max(bodies, default=0), int(widths.max(initial=0)))
        starts = np.concatenate([[0], np.cumsum(widths)])
        rows = np.repeat(np.arange(len(bodies)), widths)
        columns = np.arange(starts[-1]) - starts[rows]
        places = np.array(bodies, dtype=np.intp)[rows] * self._told.shape[1] + columns
        return _TargetIndex(places, rows, starts.tolist())

    def _make_room(self, body: int, width: int) -> None:
        height, had = self._told.shape
        if body < height and width <= had:
            return
        while height <= body:
            height *= 2
        told = np.full((height, max(width, had)), np.nan)
        told[: len(self._told), :had] = self._told
        self._told = told
        self._plans.clear()
