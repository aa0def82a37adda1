"""CDR images of one topic of many robots: written once, then only their numbers are filled in."""

from collections.abc import Sequence
from functools import lru_cache

import msgspec
import numpy as np

from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_layout import HEADER_BYTES, find_offsets
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.robot_agent.pool.rows import FloatArray, IntArray

WORD = 8
KEPT_IMAGES = 8192
"""Where numbers go in messages that were written before: robots come and go one by one."""


class Images:
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
        images = {one: _image(one, *paths) for one in dict.fromkeys(templates)}
        rows = [images[one] for one in templates]
        starts, end = [], 0
        for image in rows:
            # The header goes before the word that the message begins at, so that it is aligned.
            starts.append(end + WORD - HEADER_BYTES)
            end = -(-(starts[-1] + len(image.payload)) // WORD) * WORD
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
        self._number_at = (at + _places([image.numbers for image in rows], len(numbers))) // 8
        self._sec_at = (at + _places([image.stamps for image in rows], len(stamps))) // 4

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


class _Image:
    """One message, and where its numbers are."""

    def __init__(
        self, template: msgspec.Struct, numbers: Sequence[str], stamps: Sequence[str]
    ) -> None:
        self.payload = cdr.encode(template)
        places = find_offsets(template)
        self.numbers = [places[path] for path in numbers]
        self.stamps = [places[f"{path}.sec"] for path in stamps]


@lru_cache(maxsize=KEPT_IMAGES)
def _image(template: msgspec.Struct, numbers: tuple[str, ...], stamps: tuple[str, ...]) -> _Image:
    return _Image(template, numbers, stamps)


def _places(listed: Sequence[Sequence[int]], count: int) -> IntArray:
    return np.array(listed, dtype=np.int64).reshape(len(listed), count)
