"""Where each number of a message lies in its CDR bytes, so that an image can be filled in place."""

from collections.abc import Sequence
from functools import cache
from operator import attrgetter

import msgspec

from zensim.proto.cdr_layout import (
    BYTES_OF_CODE,
    LENGTH_BYTES,
    Fixed,
    Layout,
    Leaf,
    Numbers,
    Octets,
    Structs,
    Text,
)

HEADER_BYTES = 4
"""Alignment is counted from the end of the header."""


def places_of(message: msgspec.Struct) -> dict[str, int]:
    """Find the byte at which each number begins, by its path.

    A path is dotted, with `[0]` for items of arrays and sequences. Another message of the type has
    its numbers at the same places if its texts and sequences are as long.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    found: dict[str, int] = {}
    _walk(message, "", 0, found)
    return {path: place + HEADER_BYTES for path, place in found.items()}


def _walk(message: msgspec.Struct, prefix: str, at: int, found: dict[str, int]) -> int:
    for leaf in _layout(type(message)).leaves:
        at = _past(leaf, message, prefix, at, found)
    return at


@cache
def _layout(message_type: type[msgspec.Struct]) -> Layout:
    """Read a type once: for each of a thousand messages anew it would take ten seconds."""
    return Layout(message_type)


def _past(leaf: Leaf, message: msgspec.Struct, prefix: str, at: int, found: dict[str, int]) -> int:
    if isinstance(leaf, Fixed):
        return _numbers(prefix + leaf.path, leaf.code, leaf.length, at, found)
    value = attrgetter(leaf.path)(message)
    if isinstance(leaf, Text):
        return _text(value, at)
    at = _length(at)
    if isinstance(leaf, Octets):
        return at + len(value)
    if isinstance(leaf, Numbers):
        return _numbers(prefix + leaf.path, leaf.code, len(value), at, found)
    return _items(leaf, value, prefix, at, found)


def _items(leaf: Leaf, items: Sequence[object], prefix: str, at: int, found: dict[str, int]) -> int:
    for number, item in enumerate(items):
        if isinstance(leaf, Structs) and isinstance(item, msgspec.Struct):
            at = _walk(item, f"{prefix}{leaf.path}[{number}].", at, found)
        else:
            at = _text(str(item), at)
    return at


def _numbers(path: str, code: str, length: int | None, at: int, found: dict[str, int]) -> int:
    size = BYTES_OF_CODE[code]
    if length is None:
        at += -at % size
        found[path] = at
        return at + size
    if length:
        at += -at % size
    found.update({f"{path}[{item}]": at + item * size for item in range(length)})
    return at + length * size


def _text(text: str, at: int) -> int:
    return _length(at) + len(text.encode()) + 1


def _length(at: int) -> int:
    return at + -at % LENGTH_BYTES + LENGTH_BYTES
