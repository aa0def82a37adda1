"""Columns of numbers and texts from the CDR bytes of many messages of one type, by array views."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Final, TypeAlias

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.codec.cdr_layout import (
    BYTES_OF_CODE,
    HEADER_BYTES,
    CdrLayout,
    FixedLeaf,
    Leaf,
    NumbersLeaf,
    StringLeaf,
    StringsLeaf,
    StructsLeaf,
)

LITTLE_AT: Final = 1
"""Byte of the CDR header whose lowest bit says that the least significant byte comes first."""
MAX_ITEMS: Final = 32
"""Longest sequence that becomes columns; longer ones of messages have none."""

MAX_LAYOUTS: Final = 64
"""Most layouts of messages of one size that are decoded together: each is a pass over the rest."""


class TextColumn(msgspec.Struct, frozen=True, eq=False):
    """Texts, of which many are equal."""

    codes: npt.NDArray[np.int32]
    """Position of each row's text in `texts`, (n,)."""
    texts: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.codes)

    def to_list(self) -> list[str]:
        """List the text of each row."""
        return [self.texts[code] for code in self.codes.tolist()]


NumberColumn: TypeAlias = npt.NDArray[np.generic]
"""Numbers, (n,); of arrays and sequences (n, k)."""
Column: TypeAlias = NumberColumn | TextColumn


class MessageColumns(msgspec.Struct, frozen=True, eq=False):
    """Columns of messages that have strings and sequences of equal lengths."""

    messages: npt.NDArray[np.int64]
    """Position of the message of each row among those given, (n,)."""
    columns: dict[str, Column]
    """Columns by dotted path, such as `pose.pose.position.x`."""


class ColumnDecoder:
    """Decodes messages of one type, a group for each layout.

    Messages that only have a sequence of others, such as transforms, have a row for each of these.
    """

    def __init__(self, kind: type[msgspec.Struct], *, wants_arrays: bool = False) -> None:
        """Choose columns.

        Args:
            kind: Type of the messages.
            wants_arrays: Whether arrays and sequences of numbers are wanted, such as covariances.
        """
        self._kind = kind
        self._wants_arrays = wants_arrays
        self.damaged = 0
        """Messages that are left out, as they are cut."""

    def decode(self, payloads: Sequence[bytes]) -> Iterator[MessageColumns]:
        """Decode messages from CDR."""
        by_length: dict[int, list[int]] = {}
        for number, payload in enumerate(payloads):
            by_length.setdefault(len(payload), []).append(number)
        for length, numbers in by_length.items():
            if length < HEADER_BYTES:
                self.damaged += len(numbers)
                continue
            raw = np.frombuffer(b"".join(payloads[one] for one in numbers), np.uint8)
            yield from self._decode_rows(raw.reshape(-1, length), np.array(numbers))

    def _decode_rows(
        self, rows: npt.NDArray[np.uint8], numbers: npt.NDArray[np.int64]
    ) -> Iterator[MessageColumns]:
        """Decode messages of one size; those of many layouts one by one."""
        layouts = 0
        while len(rows):
            if layouts == MAX_LAYOUTS:
                for at in range(len(rows)):
                    yield from self._decode_rows(rows[at : at + 1], numbers[at : at + 1])
                return
            layouts += 1
            group = _Group(rows, wants_arrays=self._wants_arrays)
            try:
                found = group.read_rows(self._kind)
            except IndexError:
                # Those that are alike up to the end are as short.
                self.damaged += int(np.count_nonzero(group.is_alike))
                rows, numbers = rows[~group.is_alike], numbers[~group.is_alike]
                continue
            alike = np.flatnonzero(group.is_alike)
            for columns in found:
                chosen = {path: take_rows(one, alike) for path, one in columns.items()}
                yield MessageColumns(numbers[alike], chosen)
            rows, numbers = rows[~group.is_alike], numbers[~group.is_alike]


def take_rows(column: Column, rows: npt.NDArray[np.intp]) -> Column:
    """Take rows of a column by their positions."""
    if isinstance(column, TextColumn):
        return TextColumn(column.codes[rows], column.texts)
    return column[rows]


class _Group:
    """Messages of one size; `is_alike` are those whose layout is that of the first."""

    def __init__(self, rows: npt.NDArray[np.uint8], *, wants_arrays: bool) -> None:
        self._rows = rows
        self._wants_arrays = wants_arrays
        is_little = rows[:, LITTLE_AT] & 1
        self.is_alike = is_little == is_little[0]
        self._order = "<" if is_little[0] else ">"
        self._at = 0

    def read_rows(self, kind: type[msgspec.Struct]) -> list[dict[str, Column]]:
        """Read the columns; several times, if each message has several rows.

        Raises:
            IndexError: The first message is shorter than it says.
        """
        leaves = find_leaves(kind)
        if len(leaves) == 1 and isinstance(leaves[0], StructsLeaf):
            element = leaves[0].element
            return [self._read_struct(element, "") for _ in range(self._read_length())]
        return [self._read_struct(kind, "")]

    def _read_struct(self, kind: type[msgspec.Struct], prefix: str) -> dict[str, Column]:
        found: dict[str, Column] = {}
        for leaf in find_leaves(kind):
            self._read_leaf(leaf, prefix, found)
        return found

    def _read_leaf(self, leaf: Leaf, prefix: str, found: dict[str, Column]) -> None:
        path = prefix + leaf.path
        if isinstance(leaf, FixedLeaf):
            self._read_fixed(leaf, path, found)
        elif isinstance(leaf, StringLeaf):
            found[path] = self._read_text()
        elif isinstance(leaf, StructsLeaf):
            self._read_structs(leaf, path, found)
        elif isinstance(leaf, StringsLeaf):
            for number in range(self._read_length()):
                found[f"{path}[{number}]"] = self._read_text()
        else:
            code = leaf.code if isinstance(leaf, NumbersLeaf) else "B"
            self._keep_sequence(path, self._read_numbers(code, self._read_length()), found)

    def _read_fixed(self, leaf: FixedLeaf, path: str, found: dict[str, Column]) -> None:
        if leaf.code == "x":
            self._at += 1
        elif leaf.length is None:
            found[path] = self._read_numbers(leaf.code, 1)[:, 0]
        else:
            self._keep_array(path, self._read_numbers(leaf.code, leaf.length), found)

    def _read_structs(self, leaf: StructsLeaf, path: str, found: dict[str, Column]) -> None:
        count = self._read_length()
        for number in range(count):
            columns = self._read_struct(leaf.element, f"{path}[{number}].")
            if count <= MAX_ITEMS:
                found.update(columns)

    def _keep_sequence(self, path: str, numbers: NumberColumn, found: dict[str, Column]) -> None:
        """Keep a short sequence as a column for each item; a long one as an array."""
        count = numbers.shape[1]
        if count > MAX_ITEMS:
            self._keep_array(path, numbers, found)
        else:
            found.update({f"{path}[{item}]": numbers[:, item] for item in range(count)})

    def _keep_array(self, path: str, numbers: NumberColumn, found: dict[str, Column]) -> None:
        if self._wants_arrays:
            found[path] = numbers

    def _read_length(self) -> int:
        """Read the length of a string or sequence; messages in which it differs are not alike."""
        lengths = self._read_numbers("I", 1)[:, 0]
        self.is_alike &= lengths == lengths[0]
        return int(lengths[0])

    def _read_numbers(self, code: str, count: int) -> NumberColumn:
        size = BYTES_OF_CODE[code]
        if count:
            self._at += -self._at % size
        raw = self._take(size * count)
        dtype = np.dtype(f"{self._order}{code}") if code != "?" else np.dtype(np.bool_)
        numbers: NumberColumn = np.ascontiguousarray(raw).view(dtype)
        return numbers.reshape(len(raw), count)

    def _read_text(self) -> TextColumn:
        raw = self._take(self._read_length())[:, :-1]
        if not raw.shape[1]:
            return TextColumn(np.zeros(len(raw), np.int32), ("",))
        whole = np.ascontiguousarray(raw).view(np.dtype((np.void, raw.shape[1])))[:, 0]
        distinct, codes = np.unique(whole, return_inverse=True)
        texts = tuple(one.tobytes().decode(errors="replace") for one in distinct)
        return TextColumn(codes.astype(np.int32), texts)

    def _take(self, count: int) -> npt.NDArray[np.uint8]:
        start = HEADER_BYTES + self._at
        self._at += count
        if start + count > self._rows.shape[1]:
            raise IndexError(start + count)
        return self._rows[:, start : start + count]


@cache
def find_leaves(kind: type[msgspec.Struct]) -> tuple[Leaf, ...]:
    """List the fields of a type of messages."""
    return tuple(CdrLayout(kind).leaves)


def join_columns(groups: Sequence[Mapping[str, Column]], path: str, key: str) -> Column | None:
    """Join a column of several groups; None if its kind or shape differs among them.

    Rows of a group without it have an empty text, or NaN.

    Args:
        groups: Columns by path.
        path: Of the column.
        key: Path of a column that all groups have.
    """
    parts = [one.get(path) for one in groups]
    if all(isinstance(one, TextColumn | None) for one in parts):
        filled = [
            one if one is not None else TextColumn(np.zeros(len(group[key]), np.int32), ("",))
            for one, group in zip(parts, groups, strict=True)
        ]
        return _join_texts([one for one in filled if isinstance(one, TextColumn)])
    shapes = {one.shape[1:] for one in parts if isinstance(one, np.ndarray)}
    if len(shapes) > 1 or any(isinstance(one, TextColumn) for one in parts):
        return None
    (shape,) = shapes
    return np.concatenate(
        [
            one if isinstance(one, np.ndarray) else np.full((len(group[key]), *shape), np.nan)
            for one, group in zip(parts, groups, strict=True)
        ]
    )


def _join_texts(columns: Sequence[TextColumn]) -> TextColumn:
    codes: dict[str, int] = {}
    joined = []
    for one in columns:
        own = [codes.setdefault(text, len(codes)) for text in one.texts]
        joined.append(np.array(own, np.int32)[one.codes])
    return TextColumn(np.concatenate(joined), tuple(codes))
