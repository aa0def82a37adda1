"""CDR writers: one compiled function a struct type, runs of fixed fields in one go."""

import struct
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from itertools import groupby
from operator import attrgetter
from typing import TypeAlias, TypeVar

import msgspec

from zensim.proto.cdr_layout import (
    BYTES_OF_CODE,
    Fixed,
    Layout,
    Numbers,
    Octets,
    Run,
    Structs,
    Text,
    images,
    runs,
)

Write: TypeAlias = Callable[[msgspec.Struct, bytearray], None]
"""Adds a message to what is written already, 4 bytes of header first."""
Item = TypeVar("Item")
Gather: TypeAlias = Callable[[msgspec.Struct], Iterable[object]]

LENGTHS = tuple(struct.Struct(f"<{-phase % 4}xI") for phase in range(4))
"""A length after its padding, by the place it begins at, modulo 4."""


@cache
def writer(message_type: type[msgspec.Struct]) -> Write:
    """Compile the writer of a type.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    writes = [_run_writer(run) for run in runs(Layout(message_type).leaves)]
    if len(writes) == 1:
        return writes[0]

    def write(message: msgspec.Struct, out: bytearray) -> None:
        for write_run in writes:
            write_run(message, out)

    return write


def _run_writer(run: Run) -> Write:
    if isinstance(run, list):
        return _fixed_writer(run)
    get = attrgetter(run.path)
    if isinstance(run, Text):
        return lambda message, out: _write_text(get(message), out)
    if isinstance(run, Octets):
        return lambda message, out: _write_octets(get(message), out)
    if isinstance(run, Structs):
        write_one = writer(run.element)
        return lambda message, out: _write_each(get(message), out, write_one)
    if isinstance(run, Numbers):
        return _numbers_writer(run)
    return lambda message, out: _write_each(get(message), out, _write_text)


def _fixed_writer(run: list[Fixed]) -> Write:
    packs = [image.pack for image in images(run, "<")]
    gather = _gather(run)

    def write(message: msgspec.Struct, out: bytearray) -> None:
        try:
            out += packs[(len(out) + 4) & 7](*gather(message))
        except (struct.error, OverflowError) as error:
            raise _misfit(run, message) from error

    return write


def _numbers_writer(leaf: Numbers) -> Write:
    get = attrgetter(leaf.path)
    size = BYTES_OF_CODE[leaf.code]

    def write(message: msgspec.Struct, out: bytearray) -> None:
        numbers = get(message)
        out += LENGTHS[len(out) & 3].pack(len(numbers))
        padding = -(len(out) + 4) % size if numbers else 0
        try:
            out += struct.pack(f"<{padding}x{len(numbers)}{leaf.code}", *numbers)
        except (struct.error, OverflowError) as error:
            raise _misfit([leaf], message) from error

    return write


def _write_text(text: str, out: bytearray) -> None:
    raw = text.encode()
    out += LENGTHS[len(out) & 3].pack(len(raw) + 1) + raw + b"\0"


def _write_octets(octets: bytes, out: bytearray) -> None:
    out += LENGTHS[len(out) & 3].pack(len(octets)) + octets


def _write_each(
    items: Sequence[Item], out: bytearray, write_one: Callable[[Item, bytearray], None]
) -> None:
    out += LENGTHS[len(out) & 3].pack(len(items))
    for item in items:
        write_one(item, out)


def _gather(run: list[Fixed]) -> Gather:
    """Compile the collector of a run's values: neighbouring plain ones by a single look."""
    parts: list[Gather] = []
    for are_plain, group in groupby(run, key=lambda leaf: leaf.length is None):
        leaves = [leaf for leaf in group if leaf.path]
        parts.extend([_gather_plain(leaves)] if are_plain else map(_gather_array, leaves))
    if len(parts) == 1:
        return parts[0]

    def gather(message: msgspec.Struct) -> list[object]:
        values: list[object] = []
        for part in parts:
            values += part(message)
        return values

    return gather


def _gather_plain(leaves: list[Fixed]) -> Gather:
    if len(leaves) > 1:
        return attrgetter(*[leaf.path for leaf in leaves])
    gets = [attrgetter(leaf.path) for leaf in leaves]
    return lambda message: [get(message) for get in gets]


def _gather_array(leaf: Fixed) -> Gather:
    get = attrgetter(leaf.path)

    def gather(message: msgspec.Struct) -> Sequence[object]:
        numbers: Sequence[object] = get(message)
        if len(numbers) == leaf.length:
            return numbers
        raise ValueError(
            f"{type(message).__name__}.{leaf.path} has {len(numbers)} numbers; use {leaf.length}"
        )

    return gather


def _misfit(run: Sequence[Fixed | Numbers], message: msgspec.Struct) -> ValueError:
    leaf, number = next(
        (leaf, number)
        for leaf in run
        if leaf.path
        for number in _numbers_of(leaf, message)
        if not _fits(number, leaf.code)
    )
    return ValueError(
        f"{type(message).__name__}.{leaf.path} is {number!r:.80}, which does not fit;"
        f" use {_range(leaf.code)}"
    )


def _numbers_of(leaf: Fixed | Numbers, message: msgspec.Struct) -> Sequence[object]:
    value = attrgetter(leaf.path)(message)
    is_plain = isinstance(leaf, Fixed) and leaf.length is None
    return (value,) if is_plain else value


def _fits(number: object, code: str) -> bool:
    try:
        struct.pack("<" + code, number)
    except (struct.error, OverflowError):
        return False
    return True


def _range(code: str) -> str:
    bits = 8 * BYTES_OF_CODE[code]
    if code in "fd":
        return f"a number of {bits} bits"
    least = 0 if code.isupper() else -(1 << bits - 1)
    return f"an integer from {least} to {least + (1 << bits) - 1}"
