"""CDR layout of a struct type as a flat list of leaves, and the byte offsets of a message."""

import struct
from collections.abc import Callable, Sequence
from functools import cache
from operator import attrgetter, itemgetter
from typing import TypeAlias, cast

import msgspec
from msgspec import inspect

Values: TypeAlias = list[object]
"""Values that were read, leaf by leaf; a fixed array has one slot per item."""
Build: TypeAlias = Callable[[Values], object]


class FixedLeaf(msgspec.Struct, frozen=True):
    """A number or boolean, a fixed array of them, or the dummy byte of an empty struct."""

    path: str
    """Dotted path from the message; empty for the dummy."""
    slot: int
    """Index of its first value."""
    code: str
    """Format character of `struct`; `?` boolean, `x` dummy."""
    length: int | None = None
    """None = a scalar."""

    @property
    def slots(self) -> range:
        """Indices of its values."""
        return range(self.slot, self.slot + (self.length or 1))


class StringLeaf(msgspec.Struct, frozen=True):
    """A string."""

    path: str


class BytesLeaf(msgspec.Struct, frozen=True):
    """A sequence of uint8 or int8, as bytes."""

    path: str


class NumbersLeaf(msgspec.Struct, frozen=True):
    """A sequence of numbers or booleans."""

    path: str
    code: str


class StringsLeaf(msgspec.Struct, frozen=True):
    """A sequence of strings."""

    path: str


class StructsLeaf(msgspec.Struct, frozen=True):
    """A sequence of messages."""

    path: str
    element: type[msgspec.Struct]


SizedLeaf: TypeAlias = StringLeaf | BytesLeaf | NumbersLeaf | StringsLeaf | StructsLeaf
"""A leaf that begins with its length."""
Leaf: TypeAlias = FixedLeaf | SizedLeaf
Run: TypeAlias = list[FixedLeaf] | SizedLeaf
"""Adjacent fixed leaves, or one other leaf."""

BYTES_OF_CODE = {code: struct.calcsize(f"<{code}") for code in "x?bBhHiIqQfd"}
LENGTH_BYTES = 4


class CdrLayout:
    """Leaves of a struct type in wire order, and the builder of a message from their values.

    Raises:
        TypeError: The type is not expressible in CDR.
    """

    def __init__(self, message_type: type[msgspec.Struct]) -> None:
        self.leaves: list[Leaf] = []
        self._slots = 0
        try:
            self.build = self._struct(message_type, "")
        except TypeError as error:
            name = message_type.__name__
            raise TypeError(
                f"{name} is not expressible in CDR, use MessagePack or JSON: {error}"
            ) from error

    @property
    def min_bytes(self) -> int:
        """Size of the smallest message [bytes], without padding."""
        return sum(
            BYTES_OF_CODE[leaf.code] * (leaf.length or 1)
            if isinstance(leaf, FixedLeaf)
            else LENGTH_BYTES
            for leaf in self.leaves
        )

    def _struct(self, message_type: type[msgspec.Struct], prefix: str) -> Build:
        start = self._slots
        fields = _fields(message_type)
        if not fields:
            self.leaves.append(FixedLeaf("", start, "x"))
        parts = [self._field(field.type, prefix + field.name) for field in fields]
        if all(isinstance(part, itemgetter) for part in parts):
            return _build_from_run(message_type, slice(start, self._slots))
        return _build_from_parts(message_type, parts)

    def _field(self, info: inspect.Type, path: str) -> Build:
        bare, extra = unwrap_metadata(info)
        if isinstance(bare, inspect.StructType):
            return self._struct(bare.cls, path + ".")
        start = self._slots
        leaf = _make_leaf(bare, extra, path, start)
        self.leaves.append(leaf)
        if isinstance(leaf, FixedLeaf) and leaf.length is not None:
            self._slots += leaf.length
            return _build_array(slice(start, self._slots))
        self._slots += 1
        return itemgetter(start)


@cache
def find_ros_class(message_type: type) -> type:
    """Find the class that names the ROS interface; fields of its subclasses are not in CDR.

    Raises:
        TypeError: No class of the MRO defines `ros_type`.
    """
    for ancestor in message_type.__mro__:
        if "ros_type" in ancestor.__dict__:
            return ancestor
    raise TypeError(f"{message_type.__name__} has no ros_type")


def _fields(message_type: type[msgspec.Struct]) -> tuple[inspect.Field, ...]:
    info = cast("inspect.StructType", inspect.type_info(find_ros_class(message_type)))
    return info.fields


def unwrap_metadata(info: inspect.Type) -> tuple[inspect.Type, dict[str, object]]:
    """Return the type without its annotation, and the extra fields of that."""
    if isinstance(info, inspect.Metadata):
        return info.type, info.extra or {}
    return info, {}


def _make_leaf(bare: inspect.Type, extra: dict[str, object], path: str, slot: int) -> Leaf:
    if isinstance(bare, inspect.StrType):
        return StringLeaf(path)
    if isinstance(bare, inspect.BytesType):
        return BytesLeaf(path)
    if not isinstance(bare, inspect.VarTupleType):
        return FixedLeaf(path, slot, _find_code(bare, extra, path))
    item, item_extra = unwrap_metadata(bare.item_type)
    if isinstance(length := extra.get("length"), int):
        return FixedLeaf(path, slot, _find_code(item, extra | item_extra, path), length)
    return _make_sequence_leaf(item, item_extra, path)


def _make_sequence_leaf(item: inspect.Type, extra: dict[str, object], path: str) -> Leaf:
    if isinstance(item, inspect.StrType):
        return StringsLeaf(path)
    if isinstance(item, inspect.StructType):
        return StructsLeaf(path, item.cls)
    return NumbersLeaf(path, _find_code(item, extra, path))


def _find_code(info: inspect.Type, extra: dict[str, object], path: str) -> str:
    if isinstance(info, inspect.BoolType):
        return "?"
    stated = extra.get("cdr", "d" if isinstance(info, inspect.FloatType) else None)
    if isinstance(info, inspect.IntType | inspect.FloatType) and stated in BYTES_OF_CODE:
        return str(stated)
    raise TypeError(f"field '{path}' is a {type(info).__name__} without a CDR width")


def _build_from_run(message_type: type[msgspec.Struct], run: slice) -> Build:
    return lambda values: message_type(*values[run])


def _build_from_parts(message_type: type[msgspec.Struct], parts: list[Build]) -> Build:
    return lambda values: message_type(*[part(values) for part in parts])


def _build_array(run: slice) -> Build:
    return lambda values: tuple(values[run])


def group_runs(leaves: list[Leaf]) -> list[Run]:
    """Group adjacent fixed leaves: one struct reads and writes each run."""
    joined: list[Run] = []
    for leaf in leaves:
        if not isinstance(leaf, FixedLeaf):
            joined.append(leaf)
        elif joined and isinstance(joined[-1], list):
            joined[-1].append(leaf)
        else:
            joined.append([leaf])
    return joined


def compile_structs(run: list[FixedLeaf], byte_order: str) -> tuple[struct.Struct, ...]:
    """Compile a run for each offset modulo 8."""
    return tuple(struct.Struct(byte_order + _make_struct_format(run, phase)) for phase in range(8))


def _make_struct_format(run: list[FixedLeaf], phase: int) -> str:
    at, format_ = phase, ""
    for leaf in run:
        size, count = BYTES_OF_CODE[leaf.code], leaf.length or 1
        padding = -at % size
        format_ += f"{padding}x{count}{leaf.code}"
        at += padding + size * count
    return format_


HEADER_BYTES = 4
"""Alignment is counted from the end of the header."""


def find_offsets(message: msgspec.Struct) -> dict[str, int]:
    """Find the byte offset of each number, by its path.

    A path is dotted, with `[0]` for items of arrays and sequences; without index it is the first
    byte of a sequence of numbers. Messages of one type whose strings and sequences have equal
    lengths have equal offsets.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    found: dict[str, int] = {}
    _walk_message(message, "", 0, found)
    return {path: place + HEADER_BYTES for path, place in found.items()}


def _walk_message(message: msgspec.Struct, prefix: str, at: int, found: dict[str, int]) -> int:
    for leaf in _cached_layout(type(message)).leaves:
        at = _find_end(leaf, message, prefix, at, found)
    return at


@cache
def _cached_layout(message_type: type[msgspec.Struct]) -> CdrLayout:
    """Cache the layout: a thousand compilations take ten seconds."""
    return CdrLayout(message_type)


def _find_end(
    leaf: Leaf, message: msgspec.Struct, prefix: str, at: int, found: dict[str, int]
) -> int:
    if isinstance(leaf, FixedLeaf):
        return _find_numbers_end(prefix + leaf.path, leaf.code, leaf.length, at, found)
    value = attrgetter(leaf.path)(message)
    if isinstance(leaf, StringLeaf):
        return _find_text_end(value, at)
    at = _skip_length(at)
    if isinstance(leaf, BytesLeaf):
        found[prefix + leaf.path] = at
        return at + len(value)
    if isinstance(leaf, NumbersLeaf):
        return _find_numbers_end(prefix + leaf.path, leaf.code, len(value), at, found)
    return _find_items_end(leaf, value, prefix, at, found)


def _find_items_end(
    leaf: Leaf, items: Sequence[object], prefix: str, at: int, found: dict[str, int]
) -> int:
    for number, item in enumerate(items):
        if isinstance(leaf, StructsLeaf) and isinstance(item, msgspec.Struct):
            at = _walk_message(item, f"{prefix}{leaf.path}[{number}].", at, found)
        else:
            at = _find_text_end(str(item), at)
    return at


def _find_numbers_end(
    path: str, code: str, length: int | None, at: int, found: dict[str, int]
) -> int:
    size = BYTES_OF_CODE[code]
    if length is None:
        at += -at % size
        found[path] = at
        return at + size
    if length:
        at += -at % size
    found[path] = at
    found.update({f"{path}[{item}]": at + item * size for item in range(length)})
    return at + length * size


def _find_text_end(text: str, at: int) -> int:
    return _skip_length(at) + len(text.encode()) + 1


def _skip_length(at: int) -> int:
    return at + -at % LENGTH_BYTES + LENGTH_BYTES
