"""Where each field of a message lies in CDR: struct types read once into flat, ordered leaves."""

import struct
from collections.abc import Callable
from functools import cache
from operator import itemgetter
from typing import TypeAlias, cast

import msgspec
from msgspec import inspect

Values: TypeAlias = list[object]
"""What a reader found, leaf by leaf; a fixed array takes as many places as it is long."""
Build: TypeAlias = Callable[[Values], object]


class Fixed(msgspec.Struct, frozen=True):
    """A number or boolean, a fixed array of them, or the dummy byte of an empty struct."""

    path: str
    """Dotted, from the message; empty for the dummy."""
    slot: int
    """Place of its first value among the values."""
    code: str
    """Of the `struct` module; `?` boolean, `x` dummy."""
    length: int | None = None
    """None = a plain value."""

    @property
    def slots(self) -> range:
        """Places of its values."""
        return range(self.slot, self.slot + (self.length or 1))


class Text(msgspec.Struct, frozen=True):
    """A string."""

    path: str


class Octets(msgspec.Struct, frozen=True):
    """A sequence of uint8, as bytes."""

    path: str


class Numbers(msgspec.Struct, frozen=True):
    """A sequence of numbers or booleans."""

    path: str
    code: str


class Texts(msgspec.Struct, frozen=True):
    """A sequence of strings."""

    path: str


class Structs(msgspec.Struct, frozen=True):
    """A sequence of messages."""

    path: str
    element: type[msgspec.Struct]


Sized: TypeAlias = Text | Octets | Numbers | Texts | Structs
"""A leaf that begins with its own length."""
Leaf: TypeAlias = Fixed | Sized
Run: TypeAlias = list[Fixed] | Sized
"""Neighbouring fixed leaves, or one that is not."""

BYTES_OF_CODE = {code: struct.calcsize(f"<{code}") for code in "x?bBhHiIqQfd"}
LENGTH_BYTES = 4


class Layout:
    """The leaves of one struct type in wire order, and how to build a message from their values.

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
    def least_bytes(self) -> int:
        """Bytes of the smallest message, padding not counted."""
        return sum(
            BYTES_OF_CODE[leaf.code] * (leaf.length or 1)
            if isinstance(leaf, Fixed)
            else LENGTH_BYTES
            for leaf in self.leaves
        )

    def _struct(self, message_type: type[msgspec.Struct], prefix: str) -> Build:
        start = self._slots
        fields = _fields(message_type)
        if not fields:
            self.leaves.append(Fixed("", start, "x"))
        parts = [self._field(field.type, prefix + field.name) for field in fields]
        if all(isinstance(part, itemgetter) for part in parts):
            return _build_from_run(message_type, slice(start, self._slots))
        return _build_from_parts(message_type, parts)

    def _field(self, info: inspect.Type, path: str) -> Build:
        bare, extra = _unwrapped(info)
        if isinstance(bare, inspect.StructType):
            return self._struct(bare.cls, path + ".")
        start = self._slots
        leaf = _leaf(bare, extra, path, start)
        self.leaves.append(leaf)
        if isinstance(leaf, Fixed) and leaf.length is not None:
            self._slots += leaf.length
            return _build_array(slice(start, self._slots))
        self._slots += 1
        return itemgetter(start)


@cache
def ros_class(message_type: type) -> type:
    """Find the class that names the ROS interface; what a subclass adds isn't in CDR.

    Raises:
        TypeError: No class of the MRO defines `ros_type`.
    """
    for ancestor in message_type.__mro__:
        if "ros_type" in ancestor.__dict__:
            return ancestor
    raise TypeError(f"{message_type.__name__} has no ros_type")


def _fields(message_type: type[msgspec.Struct]) -> tuple[inspect.Field, ...]:
    info = cast("inspect.StructType", inspect.type_info(ros_class(message_type)))
    return info.fields


def _unwrapped(info: inspect.Type) -> tuple[inspect.Type, dict[str, object]]:
    if isinstance(info, inspect.Metadata):
        return info.type, info.extra or {}
    return info, {}


def _leaf(bare: inspect.Type, extra: dict[str, object], path: str, slot: int) -> Leaf:
    if isinstance(bare, inspect.StrType):
        return Text(path)
    if isinstance(bare, inspect.BytesType):
        return Octets(path)
    if not isinstance(bare, inspect.VarTupleType):
        return Fixed(path, slot, _code(bare, extra, path))
    item, item_extra = _unwrapped(bare.item_type)
    if isinstance(length := extra.get("length"), int):
        return Fixed(path, slot, _code(item, extra | item_extra, path), length)
    return _sequence(item, item_extra, path)


def _sequence(item: inspect.Type, extra: dict[str, object], path: str) -> Leaf:
    if isinstance(item, inspect.StrType):
        return Texts(path)
    if isinstance(item, inspect.StructType):
        return Structs(path, item.cls)
    return Numbers(path, _code(item, extra, path))


def _code(info: inspect.Type, extra: dict[str, object], path: str) -> str:
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


def runs(leaves: list[Leaf]) -> list[Run]:
    """Join neighbouring fixed leaves: each run is read and written in one go."""
    joined: list[Run] = []
    for leaf in leaves:
        if not isinstance(leaf, Fixed):
            joined.append(leaf)
        elif joined and isinstance(joined[-1], list):
            joined[-1].append(leaf)
        else:
            joined.append([leaf])
    return joined


def images(run: list[Fixed], byte_order: str) -> tuple[struct.Struct, ...]:
    """Compile a run for each of the 8 places, modulo 8, that it can begin at."""
    return tuple(struct.Struct(byte_order + _image(run, phase)) for phase in range(8))


def _image(run: list[Fixed], phase: int) -> str:
    at, image = phase, ""
    for leaf in run:
        size, count = BYTES_OF_CODE[leaf.code], leaf.length or 1
        padding = -at % size
        image += f"{padding}x{count}{leaf.code}"
        at += padding + size * count
    return image
