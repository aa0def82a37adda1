"""CDR messages of many senders in one buffer, filled by arrays."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.codec.cdr import encode
from zensim.proto.codec.cdr_layout import HEADER_BYTES, find_offsets
from zensim.proto.codec.cdr_template import NANOSECONDS_PER_SECOND

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
WORD_BYTES: Final = 8
MAX_CACHED_TEMPLATES: Final = 8192
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
        self._starts = np.array(starts, dtype=np.int64)
        self._ends = self._starts + np.array([len(one.payload) for one in rows], dtype=np.int64)
        at = self._starts[:, None]
        self._make_views()
        self._number_at = (at + _stack_offsets([one.numbers for one in rows], len(numbers))) // 8
        self._sec_at = (at + _stack_offsets([one.stamps for one in rows], len(stamps))) // 4

    def __getstate__(self) -> dict[str, object]:
        """Leave out the views of the buffer."""
        return {**self.__dict__, "_view": None, "_floats": None, "_words": None}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Make the views of the buffer again."""
        self.__dict__.update(state)
        self._make_views()

    def _make_views(self) -> None:
        self._view = memoryview(self._buffer)
        self._floats = np.frombuffer(self._buffer, dtype="<f8")
        self._words = np.frombuffer(self._buffer, dtype="<u4")

    def fill(self, rows: IntArray, numbers: FloatArray, times_ns: IntArray) -> None:
        """Fill numbers (m, numbers) and stamps [ns] (m,) into some rows."""
        sec, nanosec = np.divmod(times_ns, NANOSECONDS_PER_SECOND)
        self._floats[self._number_at[rows]] = numbers
        self._words[self._sec_at[rows]] = sec[:, None]
        self._words[self._sec_at[rows] + 1] = nanosec[:, None]

    def payload(self, row: int) -> bytes:
        """Return one message."""
        return self._view[self._starts[row] : self._ends[row]].tobytes()

    def payloads(self, rows: IntArray) -> list[bytes]:
        """Return some messages; all of them in their own order."""
        wanted = slice(None) if len(rows) == len(self._starts) else rows
        starts, ends = self._starts[wanted].tolist(), self._ends[wanted].tolist()
        view = self._view
        return [view[start:end].tobytes() for start, end in zip(starts, ends, strict=True)]


class _EncodedTemplate:
    """An encoded message and the offsets of its fields."""

    def __init__(
        self, template: msgspec.Struct, numbers: Sequence[str], stamps: Sequence[str]
    ) -> None:
        self.payload = encode(template)
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
