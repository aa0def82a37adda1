"""Readers of CDR messages, compiled for each type."""

import struct
from collections.abc import Callable
from functools import cache
from typing import TypeAlias, TypeVar, cast

import msgspec
from msgspec.structs import replace

from zensim.proto.codec.cdr_layout import (
    BYTES_OF_CODE,
    LENGTH_BYTES,
    BytesLeaf,
    CdrLayout,
    FixedLeaf,
    NumbersLeaf,
    Run,
    SizedLeaf,
    StringLeaf,
    StringsLeaf,
    Values,
    compile_structs,
    group_runs,
)

DecodedMessage = TypeVar("DecodedMessage", bound=msgspec.Struct)
Found = TypeVar("Found")
ReadOne: TypeAlias = Callable[[bytes, int], tuple[Found, int]]
"""Reads a value at an offset; returns it and the offset of its end."""
ReadStep: TypeAlias = Callable[[bytes, int, Values], int]
"""Reads at an offset and appends to the values; returns the offset of the end."""


class MalformedPayload(ValueError):
    """The bytes do not encode the expected message."""


@cache
def compile_reader(message_type: type[DecodedMessage], byte_order: str) -> ReadOne[DecodedMessage]:
    """Compile the reader of a type.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    layout = CdrLayout(message_type)
    steps = [_make_step(run, byte_order) for run in group_runs(layout.leaves)]
    build = cast("Callable[[Values], DecodedMessage]", layout.build)

    def read(payload: bytes, at: int) -> tuple[DecodedMessage, int]:
        values: Values = []
        for step in steps:
            at = step(payload, at, values)
        return build(values), at

    return read


def _make_step(run: Run, byte_order: str) -> ReadStep:
    if isinstance(run, list):
        return _make_fixed_step(run, byte_order)
    read_one = _make_field_reader(run, byte_order)

    def step(payload: bytes, at: int, values: Values) -> int:
        found, at = read_one(payload, at)
        values.append(found)
        return at

    return step


def _make_fixed_step(run: list[FixedLeaf], byte_order: str) -> ReadStep:
    numeric = [replace(leaf, code=_to_read_code(leaf.code)) for leaf in run]
    segments = compile_structs(numeric, byte_order)
    booleans = [slot for leaf in run if leaf.code == "?" for slot in leaf.slots]

    def step(payload: bytes, at: int, values: Values) -> int:
        segment = segments[(at + 4) & 7]
        _require_bytes(payload, at, segment.size)
        values += segment.unpack_from(payload, at)
        for slot in booleans:
            values[slot] = _to_boolean(values[slot])
        return at + segment.size

    return step


def _make_field_reader(run: SizedLeaf, byte_order: str) -> ReadOne[object]:
    read_length = _make_length_reader(byte_order)
    if isinstance(run, StringLeaf):
        return _make_text_reader(read_length)
    if isinstance(run, BytesLeaf):
        return _make_bytes_reader(read_length)
    if isinstance(run, NumbersLeaf):
        return _make_numbers_reader(run.code, byte_order)
    if isinstance(run, StringsLeaf):
        return _make_sequence_reader(read_length, _make_text_reader(read_length), LENGTH_BYTES)
    return _make_sequence_reader(
        read_length, compile_reader(run.element, byte_order), CdrLayout(run.element).min_bytes
    )


def _make_length_reader(byte_order: str) -> ReadOne[int]:
    unpack = struct.Struct(byte_order + "I").unpack_from

    def read(payload: bytes, at: int) -> tuple[int, int]:
        at += -at & 3
        _require_bytes(payload, at, LENGTH_BYTES)
        return unpack(payload, at)[0], at + LENGTH_BYTES

    return read


def _make_text_reader(read_length: ReadOne[int]) -> ReadOne[str]:
    def read(payload: bytes, at: int) -> tuple[str, int]:
        count, start = read_length(payload, at)
        if not count:  # Some writers omit the NUL of an empty string.
            return "", start
        end = start + count
        _require_bytes(payload, start, count)
        if payload[end - 1]:
            raise MalformedPayload(f"the string at byte {start} does not end with NUL")
        try:
            return payload[start : end - 1].decode(), end
        except UnicodeDecodeError as error:
            raise MalformedPayload(f"the string at byte {start} is not UTF-8") from error

    return read


def _make_bytes_reader(read_length: ReadOne[int]) -> ReadOne[bytes]:
    def read(payload: bytes, at: int) -> tuple[bytes, int]:
        count, start = read_length(payload, at)
        _require_bytes(payload, start, count)
        return payload[start : start + count], start + count

    return read


def _make_numbers_reader(code: str, byte_order: str) -> ReadOne[tuple[object, ...]]:
    read_length = _make_length_reader(byte_order)
    size = BYTES_OF_CODE[code]
    read_code = _to_read_code(code)

    def read(payload: bytes, at: int) -> tuple[tuple[object, ...], int]:
        count, start = read_length(payload, at)
        start += -(start + 4) % size if count else 0
        _require_bytes(payload, start, count * size)
        numbers = struct.unpack_from(f"{byte_order}{count}{read_code}", payload, start)
        end = start + count * size
        return tuple(map(_to_boolean, numbers)) if code == "?" else numbers, end

    return read


def _make_sequence_reader(
    read_length: ReadOne[int], read_item: ReadOne[Found], min_bytes: int
) -> ReadOne[tuple[Found, ...]]:
    def read(payload: bytes, at: int) -> tuple[tuple[Found, ...], int]:
        count, at = read_length(payload, at)
        _require_bytes(payload, at, count * min_bytes)
        items = []
        for _ in range(count):
            item, at = read_item(payload, at)
            items.append(item)
        return tuple(items), at

    return read


def _to_read_code(code: str) -> str:
    """Read booleans as numbers: `?` would accept any byte as true."""
    return "B" if code == "?" else code


def _to_boolean(number: object) -> bool:
    if number in (0, 1):
        return number == 1
    raise MalformedPayload(f"a boolean is {number}; use 0 or 1")


def _require_bytes(payload: bytes, at: int, count: int) -> None:
    if at + count > len(payload):
        raise MalformedPayload(
            f"{count} bytes are expected at byte {at}, but the payload has {len(payload)} bytes"
        )
