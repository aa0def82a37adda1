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
"""Templates are encoded once more when robots come and go, which they do one by one."""


class CdrBatch:
    """A CDR message per row, with the bytes of `zensim.proto.codec.cdr.encode`."""

    def __init__(
        self, templates: Sequence[msgspec.Struct], numbers: Sequence[str], stamps: Sequence[str]
    ) -> None:
        """Encode the messages.

        Args:
            templates: One per row, of one type, with sequences of equal lengths.
            numbers: Paths of the float64 fields to fill in; see `zensim.proto.codec.cdr_layout`.
            stamps: Paths of the `Time` fields to fill in.
        """
        paths = tuple(numbers), tuple(stamps)
        encoded = {one: _encode_template(one, *paths) for one in dict.fromkeys(templates)}
        rows = [encoded[one] for one in templates]
        starts, end = [], 0
        for one in rows:
            # The header ends at a word boundary, so that the fields are aligned.
            starts.append(end + WORD_BYTES - HEADER_BYTES)
            end = -(-(starts[-1] + len(one.payload)) // WORD_BYTES) * WORD_BYTES
        self._buffer = bytearray(end)
        for one, start in zip(rows, starts, strict=True):
            self._buffer[start : start + len(one.payload)] = one.payload
        self._views = [
            memoryview(self._buffer)[start : start + len(one.payload)]
            for one, start in zip(rows, starts, strict=True)
        ]
        at = np.array(starts, dtype=np.int64)[:, None]
        self._floats = np.frombuffer(self._buffer, dtype="<f8")
        self._words = np.frombuffer(self._buffer, dtype="<u4")
        self._number_at = (at + _stack_offsets([one.numbers for one in rows], len(numbers))) // 8
        self._sec_at = (at + _stack_offsets([one.stamps for one in rows], len(stamps))) // 4

    def fill(self, rows: IntArray, numbers: FloatArray, times_ns: IntArray) -> None:
        """Fill numbers (m, numbers) and stamps [ns] (m,) into some rows."""
        sec, nanosec = np.divmod(times_ns, NANOSECONDS)
        self._floats[self._number_at[rows]] = numbers
        self._words[self._sec_at[rows]] = sec[:, None]
        self._words[self._sec_at[rows] + 1] = nanosec[:, None]

    def payload(self, row: int) -> bytes:
        """Return one message."""
        return self._views[row].tobytes()

    def payloads(self, rows: IntArray) -> list[bytes]:
        """Return some messages."""
        if len(rows) == len(self._views):
            return [view.tobytes() for view in self._views]
        return [self._views[row].tobytes() for row in rows.tolist()]


class _EncodedTemplate:
    """An encoded message and the offsets of its fields."""

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
    """A topic of each robot of a group; messages are filled only for subscribers."""

    def __init__(
        self,
        publisher: FleetTopicPublisher,
        *,
        numbers: FindNumbers,
        paths: Sequence[str],
        stamps: Sequence[str],
        rate_hz: float | None = None,
    ) -> None:
        """Create a topic without rows.

        Args:
            publisher: Publishes the messages.
            numbers: Finds the numbers of rows.
            paths: Of the numbers in a message.
            stamps: Paths of its `Time` fields.
            rate_hz: Maximum rate of a row; None = at every call, 0 = at every state.
        """
        self._rates = None if rate_hz is None else GroupRateLimiter(rate_hz)
        self.publisher = publisher
        self._numbers = numbers
        self._paths, self._stamps = paths, stamps
        self._batch = CdrBatch((), paths, stamps)
        self._members: list[TopicMember] = []
        self._has_value = np.zeros(0, dtype=np.bool_)
        self._published_ns = np.zeros(0, dtype=np.int64)

    def remap(
        self, members: Sequence[TopicMember], templates: Sequence[msgspec.Struct], before: IntArray
    ) -> None:
        """Set the robots and their messages.

        Args:
            members: One per row.
            templates: One per row, with any numbers.
            before: Former row of each, see `remap_floats`.
        """
        self._members = list(members)
        for row, member in enumerate(members):
            member.row = row
        self._batch = CdrBatch(templates, self._paths, self._stamps)
        self.remap_rows(before)

    def remap_rows(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        self._has_value = remap_flags(self._has_value, before)
        self._published_ns = remap_ints(self._published_ns, before)
        if self._rates is not None:
            self._rates.remap(before)

    def reset(self) -> None:
        """Forget all values; time may have gone back."""
        self._has_value[:] = False
        if self._rates is not None:
            self._rates.reset()

    def due(self, rows: IntArray, time_ns: int) -> IntArray:
        """Find the rows that are due by the rate."""
        if self._rates is None or not len(rows):
            return rows
        found, _ = self._rates.open(time_ns)
        return np.intersect1d(rows, found, assume_unique=True)

    def publish(self, rows: IntArray, time_ns: int) -> None:
        """Publish some rows."""
        if not len(rows):
            return
        self._has_value[rows] = True
        self._published_ns[rows] = time_ns
        if not self.publisher.is_wanted:
            return
        self._fill(rows)
        members = self._members
        if len(rows) < len(members):
            members = [members[row] for row in rows.tolist()]
        self.publisher.put(members, self._batch.payloads(rows))

    def payload(self, row: int) -> bytes | None:
        """See `LastValues`."""
        if not self._has_value[row]:
            return None
        self._fill(np.array([row]))
        return self._batch.payload(row)

    def _fill(self, rows: IntArray) -> None:
        self._batch.fill(rows, self._numbers(rows), self._published_ns[rows])
