"""A CDR message encoded once, whose numbers and stamps are filled in."""

import struct
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from itertools import groupby, pairwise
from operator import attrgetter
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
    StructsLeaf,
    Values,
    compile_structs,
    find_offsets,
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


HEADER = b"\x00\x01\x00\x00"
MAX_PADDING = 3
"""Bytes that some writers append to the last field."""

Message = TypeVar("Message", bound=msgspec.Struct)


def encode(message: msgspec.Struct) -> bytes:
    """Encode a message.

    Raises:
        TypeError: Its type is not expressible in CDR.
        ValueError: A value does not fit its field.
    """
    out = bytearray(HEADER)
    compile_writer(type(message))(message, out)
    return bytes(out)


def decode(message_type: type[Message], payload: bytes) -> Message:
    """Decode a message.

    Raises:
        TypeError: The type is not expressible in CDR.
        MalformedPayload: The bytes do not encode this type.
    """
    message, end = compile_reader(message_type, _parse_byte_order(payload))(payload, len(HEADER))
    if len(payload) - end > MAX_PADDING:
        raise MalformedPayload(
            f"the last field ends at byte {end}, but the payload has {len(payload)} bytes"
        )
    return cast("Message", message)


@cache
def is_expressible(message_type: type[msgspec.Struct]) -> bool:
    """Whether the type can be encoded as CDR."""
    try:
        compile_writer(message_type)
    except TypeError:
        return False
    return True


def _parse_byte_order(payload: bytes) -> str:
    # The last two bytes of the header are options that every reader ignores.
    if len(payload) >= len(HEADER) and payload[0] == 0 and payload[1] <= 1:
        return "<" if payload[1] else ">"
    raise MalformedPayload(f"the header is '{payload[: len(HEADER)].hex(' ')}'; use '00 01 00 00'")


FLOAT_BYTES = 8
NANOSECONDS_PER_SECOND = 1_000_000_000
STAMP_STRUCT = struct.Struct("<iI")


class CdrTemplate:
    """A message with the bytes of `cdr.encode`, at a tenth of the cost."""

    def __init__(
        self, template: msgspec.Struct, *, numbers: Sequence[str], stamps: Sequence[str]
    ) -> None:
        """Encode the template.

        Args:
            template: Holds the values that do not change; sequences have their final length.
            numbers: Paths of the float64 fields to fill in; see `zensim.proto.codec.cdr_layout`.
            stamps: Paths of the `Time` fields to fill in.
        """
        self._buffer = bytearray(encode(template))
        offsets = find_offsets(template)
        self._runs = _find_runs([offsets[path] for path in numbers])
        self._stamps = tuple(offsets[f"{path}.sec"] for path in stamps)

    def payload(self, time_ns: int, numbers: Sequence[float]) -> bytes:
        """Fill in the stamps and the numbers; return the message."""
        stamp = divmod(time_ns, NANOSECONDS_PER_SECOND)
        for offset in self._stamps:
            STAMP_STRUCT.pack_into(self._buffer, offset, *stamp)
        for run, offset, part in self._runs:
            run.pack_into(self._buffer, offset, *numbers[part])
        return bytes(self._buffer)


def _find_runs(offsets: Sequence[int]) -> tuple[tuple[struct.Struct, int, slice], ...]:
    """Find runs of adjacent numbers: one pack call writes each."""
    gaps = [
        at for at, (one, next_) in enumerate(pairwise(offsets), 1) if next_ != one + FLOAT_BYTES
    ]
    bounds = [0, *gaps, len(offsets)]
    return tuple(
        (struct.Struct(f"<{end - start}d"), offsets[start], slice(start, end))
        for start, end in pairwise(bounds)
        if end > start
    )
