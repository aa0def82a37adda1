"""One topic of robots of one kind: their images, and when each was told last."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from zensim.robot_agent.pool.images import Images
from zensim.robot_agent.pool.outlet import FleetOutlet, Line
from zensim.robot_agent.pool.rate_gates import RateGates
from zensim.robot_agent.pool.rows import FloatArray, IntArray, carried_flags, carried_ints

Numbers = Callable[[IntArray], FloatArray]
"""Finds the numbers of some rows' last messages, in the order of the paths; (m, numbers)."""


class SquadTopic:
    """Keeps when each row was told, and writes messages only when somebody wants them."""

    def __init__(
        self,
        outlet: FleetOutlet,
        *,
        numbers: Numbers,
        paths: Sequence[str],
        stamps: Sequence[str],
        rate_hz: float | None = None,
    ) -> None:
        """Take what the messages are made of.

        Args:
            outlet: Where they leave.
            numbers: See there.
            paths: Of the numbers in a message.
            stamps: Paths of its `Time`s.
            rate_hz: How often a row is told at most; None = whenever asked, 0 = at every state.
        """
        self._rates = None if rate_hz is None else RateGates(rate_hz)
        self.outlet = outlet
        self._numbers = numbers
        self._paths, self._stamps = paths, stamps
        self._images = Images((), paths, stamps)
        self._lines: list[Line] = []
        self._has_value = np.zeros(0, dtype=np.bool_)
        self._told_ns = np.zeros(0, dtype=np.int64)

    def recut(
        self, lines: Sequence[Line], templates: Sequence[msgspec.Struct], before: IntArray
    ) -> None:
        """Take the robots as they are now.

        Args:
            lines: One a row.
            templates: A message of each, with any numbers.
            before: Where each row was; see `rows.carried`.
        """
        self._lines = list(lines)
        for row, line in enumerate(lines):
            line.row = row
        self._images = Images(templates, self._paths, self._stamps)
        self.carry(before)

    def carry(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self._has_value = carried_flags(self._has_value, before)
        self._told_ns = carried_ints(self._told_ns, before)
        if self._rates is not None:
            self._rates.recut(before)

    def reset(self) -> None:
        """Forget all values: time may have gone back."""
        self._has_value[:] = False
        if self._rates is not None:
            self._rates.reset()

    def due(self, rows: IntArray, time_ns: int) -> IntArray:
        """Find which of some rows its rate lets through."""
        if self._rates is None or not len(rows):
            return rows
        found, _ = self._rates.open(time_ns)
        return np.intersect1d(rows, found, assume_unique=True)

    def tell(self, rows: IntArray, time_ns: int) -> None:
        """Tell the values of some rows."""
        if not len(rows):
            return
        self._has_value[rows] = True
        self._told_ns[rows] = time_ns
        if not self.outlet.is_wanted:
            return
        self._fill(rows)
        lines = self._lines
        if len(rows) < len(lines):
            lines = [lines[row] for row in rows.tolist()]
        self.outlet.put(lines, self._images.payloads(rows))

    def payload(self, row: int) -> bytes | None:
        """See `outlet.Values`."""
        if not self._has_value[row]:
            return None
        self._fill(np.array([row]))
        return self._images.payload(row)

    def _fill(self, rows: IntArray) -> None:
        self._images.fill(rows, self._numbers(rows), self._told_ns[rows])
