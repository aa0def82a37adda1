"""CDR messages that differ in their stamps, a few numbers and one array, a row per sensor."""

from collections.abc import Sequence
from itertools import count

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_layout import HEADER_BYTES, find_offsets
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.se3 import FloatArray
from zensim.sim_server.scene.broad_phase import IntArray

WORD_BYTES = 4
STAMP_WORDS = (HEADER_BYTES // WORD_BYTES, HEADER_BYTES // WORD_BYTES + 1)
"""Every message begins with its header, and that with the stamp."""


class ArrayMessages:
    """Messages with the bytes of `zensim.proto.codec.cdr.encode`; call `fill`, then `write`."""

    def __init__(
        self,
        templates: Sequence[msgspec.Struct],
        *,
        array: str = "",
        item: object = None,
        integers: Sequence[str] = (),
        numbers: Sequence[str] = (),
    ) -> None:
        """Encode the messages.

        Args:
            templates: One per row; they begin with a header, and their array is empty.
            array: Name of the field that is the array, after which nothing is aligned to more than
                an item of it; empty for none.
            item: The smallest value of the array that is not empty.
            integers: Paths of uint32 fields before the array that are filled in.
            numbers: Paths of float32 fields before the array that are filled in.
        """
        parts = [_split(template, array, item) for template in templates]
        self._tails = [tail for _, tail in parts]
        sizes = [-(-len(head) // WORD_BYTES) * WORD_BYTES for head, _ in parts]
        starts = np.cumsum([0, *sizes])[:-1].tolist()
        self._buffer = bytearray(sum(sizes))
        for (head, _), start in zip(parts, starts, strict=True):
            self._buffer[start : start + len(head)] = head
        self._heads = [
            memoryview(self._buffer)[start : start + len(head)]
            for (head, _), start in zip(parts, starts, strict=True)
        ]
        self._words = np.frombuffer(self._buffer, dtype="<u4")
        self._floats = np.frombuffer(self._buffer, dtype="<f4")
        self._first = np.array(starts, dtype=np.intp) // WORD_BYTES
        self._length_at = self._first + np.array([len(head) for head, _ in parts]) // WORD_BYTES - 1
        self._has_array = bool(array)
        self._integer_at = self._find_words(templates, integers)
        self._number_at = self._find_words(templates, numbers)

    def fill(
        self,
        rows: IntArray,
        time_ns: int,
        *,
        lengths: IntArray | int = 0,
        integers: IntArray | None = None,
        numbers: FloatArray | None = None,
    ) -> None:
        """Fill in what comes before the arrays of some rows (m,).

        Args:
            rows: Of the messages.
            time_ns: Stamp of all of them.
            lengths: Items of the arrays, (m,) or one for all.
            integers: (m, integers).
            numbers: (m, numbers).
        """
        for word, value in zip(STAMP_WORDS, divmod(time_ns, NANOSECONDS), strict=True):
            self._words[self._first[rows] + word] = value
        if self._has_array:
            self._words[self._length_at[rows]] = lengths
        if integers is not None:
            self._words[self._integer_at[rows]] = integers
        if numbers is not None:
            self._floats[self._number_at[rows]] = numbers

    def write(self, rows: IntArray, arrays: Sequence[bytes]) -> list[bytes]:
        """Write the messages of some rows, with the bytes of their arrays."""
        heads, tails = self._heads, self._tails
        return [
            b"".join((heads[row], array, tails[row]))
            for row, array in zip(rows.tolist(), arrays, strict=True)
        ]

    def _find_words(self, templates: Sequence[msgspec.Struct], paths: Sequence[str]) -> IntArray:
        found = np.zeros((len(templates), len(paths)), dtype=np.intp)
        for row, template in enumerate(templates if paths else ()):
            offsets = find_offsets(template)
            found[row] = [offsets[path] // WORD_BYTES for path in paths]
        return found + self._first[:, None]


def split_rows(table: npt.NDArray[np.generic]) -> list[bytes]:
    """Split a table into the bytes of its rows."""
    raw = table.tobytes()
    size = len(raw) // max(len(table), 1)
    return [raw[start : start + size] for start in range(0, len(raw), size)] if size else []


def _split(template: msgspec.Struct, array: str, item: object) -> tuple[bytes, bytes]:
    """Encode a message in two parts: up to the length of its array, and what follows the items."""
    empty = cdr.encode(template)
    if not array:
        return empty, b""
    filled = cdr.encode(msgspec.structs.replace(template, **{array: item}))
    # The encodings differ first in the length.
    end = WORD_BYTES + next(at for at in count() if empty[at] != filled[at])
    return empty[:end], empty[end:]
