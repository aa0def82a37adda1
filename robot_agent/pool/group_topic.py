"""One topic of a group: CDR messages encoded once, filled with numbers and published when due."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import msgspec
import numpy as np

from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_layout import HEADER_BYTES, find_offsets
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.robot_agent.pool.fleet_publisher import FleetTopicPublisher, TopicMember
from zensim.robot_agent.pool.robot_rows import (
    FloatArray,
    GroupRateLimiter,
    IntArray,
    remap_flags,
    remap_ints,
)

WORD_BYTES = 8
MAX_CACHED_TEMPLATES = 8192
"""Where numbers go in messages that were written before: robots come and go one by one."""


class CdrBatch:
    """A message a row, each byte as `zensim.proto.codec.cdr.encode` writes it."""

    def __init__(
        self, templates: Sequence[msgspec.Struct], numbers: Sequence[str], stamps: Sequence[str]
    ) -> None:
        """Write the messages.

        Args:
            templates: One a row, of one type, with sequences of the same lengths.
            numbers: Paths of their float64 numbers that change; see `zensim.proto.codec.cdr_layout`.
            stamps: Paths of their `Time`s.
        """
        paths = tuple(numbers), tuple(stamps)
        images = {one: _encode_template(one, *paths) for one in dict.fromkeys(templates)}
        rows = [images[one] for one in templates]
        starts, end = [], 0
        for image in rows:
            # The header goes before the word that the message begins at, so that it is aligned.
            starts.append(end + WORD_BYTES - HEADER_BYTES)
            end = -(-(starts[-1] + len(image.payload)) // WORD_BYTES) * WORD_BYTES
        self._buffer = bytearray(end)
        for image, start in zip(rows, starts, strict=True):
            self._buffer[start : start + len(image.payload)] = image.payload
        self._views = [
            memoryview(self._buffer)[start : start + len(image.payload)]
            for image, start in zip(rows, starts, strict=True)
        ]
        at = np.array(starts, dtype=np.int64)[:, None]
        self._floats = np.frombuffer(self._buffer, dtype="<f8")
        self._words = np.frombuffer(self._buffer, dtype="<u4")
        self._number_at = (
            at + _stack_offsets([image.numbers for image in rows], len(numbers))
        ) // 8
        self._sec_at = (at + _stack_offsets([image.stamps for image in rows], len(stamps))) // 4

    def fill(self, rows: IntArray, numbers: FloatArray, times_ns: IntArray) -> None:
        """Write numbers (m, numbers) and stamps [ns], (m,), into some rows."""
        sec, nanosec = np.divmod(times_ns, NANOSECONDS)
        self._floats[self._number_at[rows]] = numbers
        self._words[self._sec_at[rows]] = sec[:, None]
        self._words[self._sec_at[rows] + 1] = nanosec[:, None]

    def payload(self, row: int) -> bytes:
        """Take one message as it is."""
        return self._views[row].tobytes()

    def payloads(self, rows: IntArray) -> list[bytes]:
        """Take some messages as they are."""
        if len(rows) == len(self._views):
            return [view.tobytes() for view in self._views]
        return [self._views[row].tobytes() for row in rows.tolist()]


class _EncodedTemplate:
    """One message, and where its numbers are."""

    def __init__(
        self, template: msgspec.Struct, numbers: Sequence[str], stamps: Sequence[str]
    ) -> None:
        self.payload = cdr.encode(template)
        places = find_offsets(template)
        self.numbers = [places[path] for path in numbers]
        self.stamps = [places[f"{path}.sec"] for path in stamps]


@lru_cache(maxsize=MAX_CACHED_TEMPLATES)
def _encode_template(
    template: msgspec.Struct, numbers: tuple[str, ...], stamps: tuple[str, ...]
) -> _EncodedTemplate:
    return _EncodedTemplate(template, numbers, stamps)


def _stack_offsets(listed: Sequence[Sequence[int]], count: int) -> IntArray:
    return np.array(listed, dtype=np.int64).reshape(len(listed), count)


FindNumbers = Callable[[IntArray], FloatArray]
"""Finds the numbers of some rows' last messages, in the order of the paths; (m, numbers)."""


class GroupTopic:
    """Keeps when each row was told, and writes messages only when somebody wants them."""

    def __init__(
        self,
        outlet: FleetTopicPublisher,
        *,
        numbers: FindNumbers,
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
        self._rates = None if rate_hz is None else GroupRateLimiter(rate_hz)
        self.outlet = outlet
        self._numbers = numbers
        self._paths, self._stamps = paths, stamps
        self._images = CdrBatch((), paths, stamps)
        self._lines: list[TopicMember] = []
        self._has_value = np.zeros(0, dtype=np.bool_)
        self._told_ns = np.zeros(0, dtype=np.int64)

    def remap(
        self, lines: Sequence[TopicMember], templates: Sequence[msgspec.Struct], before: IntArray
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
        self._images = CdrBatch(templates, self._paths, self._stamps)
        self.remap_rows(before)

    def remap_rows(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self._has_value = remap_flags(self._has_value, before)
        self._told_ns = remap_ints(self._told_ns, before)
        if self._rates is not None:
            self._rates.remap(before)

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

    def publish(self, rows: IntArray, time_ns: int) -> None:
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
