"""CDR readers: one compiled function a struct type; no length is believed before it is checked."""

import struct
from collections.abc import Callable
from functools import cache
from typing import TypeAlias, TypeVar, cast

import msgspec
from msgspec.structs import replace

from zensim.proto.cdr_layout import (
    BYTES_OF_CODE,
    LENGTH_BYTES,
    Fixed,
    Layout,
    Numbers,
    Octets,
    Run,
    Sized,
    Text,
    Texts,
    Values,
    images,
    runs,
)

Message = TypeVar("Message", bound=msgspec.Struct)
Found = TypeVar("Found")
ReadOne: TypeAlias = Callable[[bytes, int], tuple[Found, int]]
"""Reads at a place, returns what it found and where that ends."""
Step: TypeAlias = Callable[[bytes, int, Values], int]
"""Reads at a place, adds what it found to the values, returns where that ends."""


class MalformedPayload(ValueError):
    """These bytes are not that message."""


@cache
def reader(message_type: type[Message], byte_order: str) -> ReadOne[Message]:
    """Compile the reader of a type.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    layout = Layout(message_type)
    steps = [_step(run, byte_order) for run in runs(layout.leaves)]
    build = cast("Callable[[Values], Message]", layout.build)

    def read(payload: bytes, at: int) -> tuple[Message, int]:
        values: Values = []
        for step in steps:
            at = step(payload, at, values)
        return build(values), at

    return read


def _step(run: Run, byte_order: str) -> Step:
    if isinstance(run, list):
        return _fixed_step(run, byte_order)
    read_one = _read_one(run, byte_order)

    def step(payload: bytes, at: int, values: Values) -> int:
        found, at = read_one(payload, at)
        values.append(found)
        return at

    return step


def _fixed_step(run: list[Fixed], byte_order: str) -> Step:
    numeric = [replace(leaf, code=_as_read(leaf.code)) for leaf in run]
    segments = images(numeric, byte_order)
    booleans = [slot for leaf in run if leaf.code == "?" for slot in leaf.slots]

    def step(payload: bytes, at: int, values: Values) -> int:
        segment = segments[(at + 4) & 7]
        _need(payload, at, segment.size)
        values += segment.unpack_from(payload, at)
        for slot in booleans:
            values[slot] = _boolean(values[slot])
        return at + segment.size

    return step


def _read_one(run: Sized, byte_order: str) -> ReadOne[object]:
    read_length = _length_reader(byte_order)
    if isinstance(run, Text):
        return _text_reader(read_length)
    if isinstance(run, Octets):
        return _octets_reader(read_length)
    if isinstance(run, Numbers):
        return _numbers_reader(run.code, byte_order)
    if isinstance(run, Texts):
        return _each_reader(read_length, _text_reader(read_length), LENGTH_BYTES)
    return _each_reader(
        read_length, reader(run.element, byte_order), Layout(run.element).least_bytes
    )


def _length_reader(byte_order: str) -> ReadOne[int]:
    unpack = struct.Struct(byte_order + "I").unpack_from

    def read(payload: bytes, at: int) -> tuple[int, int]:
        at += -at & 3
        _need(payload, at, LENGTH_BYTES)
        return unpack(payload, at)[0], at + LENGTH_BYTES

    return read


def _text_reader(read_length: ReadOne[int]) -> ReadOne[str]:
    def read(payload: bytes, at: int) -> tuple[str, int]:
        count, start = read_length(payload, at)
        if not count:  # Some writers leave out the NUL of an empty string.
            return "", start
        end = start + count
        _need(payload, start, count)
        if payload[end - 1]:
            raise MalformedPayload(f"the string at byte {start} does not end with NUL")
        try:
            return payload[start : end - 1].decode(), end
        except UnicodeDecodeError as error:
            raise MalformedPayload(f"the string at byte {start} is not UTF-8") from error

    return read


def _octets_reader(read_length: ReadOne[int]) -> ReadOne[bytes]:
    def read(payload: bytes, at: int) -> tuple[bytes, int]:
        count, start = read_length(payload, at)
        _need(payload, start, count)
        return payload[start : start + count], start + count

    return read


def _numbers_reader(code: str, byte_order: str) -> ReadOne[tuple[object, ...]]:
    read_length = _length_reader(byte_order)
    size = BYTES_OF_CODE[code]
    read_code = _as_read(code)

    def read(payload: bytes, at: int) -> tuple[tuple[object, ...], int]:
        count, start = read_length(payload, at)
        start += -(start + 4) % size if count else 0
        _need(payload, start, count * size)
        numbers = struct.unpack_from(f"{byte_order}{count}{read_code}", payload, start)
        end = start + count * size
        return tuple(map(_boolean, numbers)) if code == "?" else numbers, end

    return read


def _each_reader(
    read_length: ReadOne[int], read_item: ReadOne[Found], least_bytes: int
) -> ReadOne[tuple[Found, ...]]:
    def read(payload: bytes, at: int) -> tuple[tuple[Found, ...], int]:
        count, at = read_length(payload, at)
        _need(payload, at, count * least_bytes)
        items = []
        for _ in range(count):
            item, at = read_item(payload, at)
            items.append(item)
        return tuple(items), at

    return read


def _as_read(code: str) -> str:
    """Read booleans as numbers: `?` would take any byte for true."""
    return "B" if code == "?" else code


def _boolean(number: object) -> bool:
    if number in (0, 1):
        return number == 1
    raise MalformedPayload(f"a boolean is {number}; use 0 or 1")


def _need(payload: bytes, at: int, count: int) -> None:
    if at + count > len(payload):
        raise MalformedPayload(
            f"{count} bytes are due at byte {at}, but the payload has {len(payload)} bytes"
        )
