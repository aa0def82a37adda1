"""Writers of CDR messages, compiled for each type."""

import struct
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from itertools import groupby
from operator import attrgetter
from typing import TypeAlias, TypeVar

import msgspec

from zensim.proto.codec.cdr_layout import (
    BYTES_OF_CODE,
    BytesLeaf,
    CdrLayout,
    FixedLeaf,
    NumbersLeaf,
    Run,
    StringLeaf,
    StructsLeaf,
    compile_structs,
    group_runs,
)

Write: TypeAlias = Callable[[msgspec.Struct, bytearray], None]
"""Appends a message to the output, which begins with the header of 4 bytes."""
Item = TypeVar("Item")
Gather: TypeAlias = Callable[[msgspec.Struct], Iterable[object]]
LENGTH_STRUCTS = tuple(struct.Struct(f"<{-phase % 4}xI") for phase in range(4))
"""Padding and length, by the offset modulo 4."""


@cache
def compile_writer(message_type: type[msgspec.Struct]) -> Write:
    """Compile the writer of a type.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    writes = [_make_run_writer(run) for run in group_runs(CdrLayout(message_type).leaves)]
    if len(writes) == 1:
        return writes[0]

    def write(message: msgspec.Struct, out: bytearray) -> None:
        for write_run in writes:
            write_run(message, out)

    return write


def _make_run_writer(run: Run) -> Write:
    if isinstance(run, list):
        return _make_fixed_writer(run)
    get = attrgetter(run.path)
    if isinstance(run, StringLeaf):
        return lambda message, out: _write_text(get(message), out)
    if isinstance(run, BytesLeaf):
        return lambda message, out: _write_bytes(get(message), out)
    if isinstance(run, StructsLeaf):
        write_one = compile_writer(run.element)
        return lambda message, out: _write_each(get(message), out, write_one)
    if isinstance(run, NumbersLeaf):
        return _make_numbers_writer(run)
    return lambda message, out: _write_each(get(message), out, _write_text)


def _make_fixed_writer(run: list[FixedLeaf]) -> Write:
    packs = [compiled.pack for compiled in compile_structs(run, "<")]
    gather = _make_gatherer(run)

    def write(message: msgspec.Struct, out: bytearray) -> None:
        try:
            out += packs[(len(out) + 4) & 7](*gather(message))
        except (struct.error, OverflowError) as error:
            raise _make_range_error(run, message) from error

    return write


def _make_numbers_writer(leaf: NumbersLeaf) -> Write:
    get = attrgetter(leaf.path)
    size = BYTES_OF_CODE[leaf.code]

    def write(message: msgspec.Struct, out: bytearray) -> None:
        numbers = get(message)
        out += LENGTH_STRUCTS[len(out) & 3].pack(len(numbers))
        padding = -(len(out) + 4) % size if numbers else 0
        try:
            out += struct.pack(f"<{padding}x{len(numbers)}{leaf.code}", *numbers)
        except (struct.error, OverflowError) as error:
            raise _make_range_error([leaf], message) from error

    return write


def _write_text(text: str, out: bytearray) -> None:
    raw = text.encode()
    out += LENGTH_STRUCTS[len(out) & 3].pack(len(raw) + 1) + raw + b"\0"


def _write_bytes(octets: bytes, out: bytearray) -> None:
    out += LENGTH_STRUCTS[len(out) & 3].pack(len(octets))
    out += octets


def _write_each(
    items: Sequence[Item], out: bytearray, write_one: Callable[[Item, bytearray], None]
) -> None:
    out += LENGTH_STRUCTS[len(out) & 3].pack(len(items))
    for item in items:
        write_one(item, out)


def _make_gatherer(run: list[FixedLeaf]) -> Gather:
    """Compile the collector of a run's values, with one getter for adjacent scalars."""
    parts: list[Gather] = []
    for are_plain, group in groupby(run, key=lambda leaf: leaf.length is None):
        leaves = [leaf for leaf in group if leaf.path]
        parts.extend(
            [_make_scalar_gatherer(leaves)] if are_plain else map(_make_array_gatherer, leaves)
        )
    if len(parts) == 1:
        return parts[0]

    def gather(message: msgspec.Struct) -> list[object]:
        values: list[object] = []
        for part in parts:
            values += part(message)
        return values

    return gather


def _make_scalar_gatherer(leaves: list[FixedLeaf]) -> Gather:
    if len(leaves) > 1:
        return attrgetter(*[leaf.path for leaf in leaves])
    gets = [attrgetter(leaf.path) for leaf in leaves]
    return lambda message: [get(message) for get in gets]


def _make_array_gatherer(leaf: FixedLeaf) -> Gather:
    get = attrgetter(leaf.path)

    def gather(message: msgspec.Struct) -> Sequence[object]:
        numbers: Sequence[object] = get(message)
        if len(numbers) == leaf.length:
            return numbers
        raise ValueError(
            f"{type(message).__name__}.{leaf.path} has {len(numbers)} numbers; use {leaf.length}"
        )

    return gather


def _make_range_error(
    run: Sequence[FixedLeaf | NumbersLeaf], message: msgspec.Struct
) -> ValueError:
    leaf, number = next(
        (leaf, number)
        for leaf in run
        if leaf.path
        for number in _list_numbers(leaf, message)
        if not _fits(number, leaf.code)
    )
    return ValueError(
        f"{type(message).__name__}.{leaf.path} is {number!r:.80}, which does not fit;"
        f" use {_describe_range(leaf.code)}"
    )


def _list_numbers(leaf: FixedLeaf | NumbersLeaf, message: msgspec.Struct) -> Sequence[object]:
    value = attrgetter(leaf.path)(message)
    is_plain = isinstance(leaf, FixedLeaf) and leaf.length is None
    return (value,) if is_plain else value


def _fits(number: object, code: str) -> bool:
    try:
        struct.pack("<" + code, number)
    except (struct.error, OverflowError):
        return False
    return True


def _describe_range(code: str) -> str:
    bits = 8 * BYTES_OF_CODE[code]
    if code in "fd":
        return f"a number of {bits} bits"
    least = 0 if code.isupper() else -(1 << bits - 1)
    return f"an integer from {least} to {least + (1 << bits) - 1}"
