"""One deterministic sample of each message, generated from its type."""

from collections.abc import Iterator
from itertools import cycle
from typing import TypeVar, cast

import msgspec
from msgspec import inspect

Message = TypeVar("Message", bound=msgspec.Struct)

MAX_NUMBER = 100
"""Numbers count from 1 up to here, to fit every width."""
ITEMS_PER_SEQUENCE = 2
"""Length of sequences without a fixed length."""


def make_sample_message(message_type: type[Message]) -> Message:
    """Fill each field with a value that differs from its neighbours.

    Raises:
        TypeError: A field has an unsupported type.
    """
    return cast("Message", _fill(inspect.type_info(message_type), "", cycle(range(1, MAX_NUMBER))))


def _fill(info: inspect.Type, name: str, numbers: Iterator[int]) -> object:
    if isinstance(info, inspect.Metadata):
        return _fill(info.type, name, numbers)
    if isinstance(info, inspect.StructType):
        fields = {field.name: _fill(field.type, field.name, numbers) for field in info.fields}
        return info.cls(**fields)
    if isinstance(info, inspect.UnionType):
        chosen = next(kind for kind in info.types if not isinstance(kind, inspect.NoneType))
        return _fill(chosen, name, numbers)
    if isinstance(info, inspect.VarTupleType | inspect.TupleType | inspect.DictType):
        return _fill_collection(info, name, numbers)
    return _fill_scalar(info, name, numbers)


def _fill_collection(
    info: inspect.VarTupleType | inspect.TupleType | inspect.DictType,
    name: str,
    numbers: Iterator[int],
) -> object:
    if isinstance(info, inspect.DictType):
        keys = [f"{name}_{place}" for place in range(ITEMS_PER_SEQUENCE)]
        return {key: _fill(info.value_type, key, numbers) for key in keys}
    if isinstance(info, inspect.TupleType):
        return tuple(_fill(item, name, numbers) for item in info.item_types)
    count = info.max_length or ITEMS_PER_SEQUENCE
    names = [f"{name}_{place}" for place in range(count)]
    return tuple(_fill(info.item_type, item_name, numbers) for item_name in names)


def _fill_scalar(info: inspect.Type, name: str, numbers: Iterator[int]) -> object:
    if isinstance(info, inspect.StrType):
        return name
    if isinstance(info, inspect.BoolType):
        return True
    if isinstance(info, inspect.IntType):
        return next(numbers)
    if isinstance(info, inspect.FloatType):
        return next(numbers) + 0.5
    if isinstance(info, inspect.BytesType):
        return bytes(next(numbers) for _ in range(ITEMS_PER_SEQUENCE))
    if isinstance(info, inspect.LiteralType):
        return info.values[0]
    raise TypeError(
        f"field '{name}' is a {type(info).__name__}; add the type to proto.sample_messages"
    )
