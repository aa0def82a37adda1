"""Hypothesis strategies for messages, made from their types."""

from functools import cache
from typing import TypeVar, cast

import msgspec
from hypothesis import strategies as st
from msgspec import inspect

Message = TypeVar("Message", bound=msgspec.Struct)

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
UINT64 = 2**64 - 1
MAX_ITEMS = 2
FLOATS32 = st.floats(allow_nan=False, allow_infinity=False, width=32)
PLAIN: dict[type[inspect.Type], st.SearchStrategy[object]] = {
    inspect.BoolType: st.booleans(),
    inspect.BytesType: st.binary(max_size=12),
    inspect.FloatType: st.floats(allow_nan=False, allow_infinity=False),
    inspect.NoneType: st.none(),
    inspect.StrType: TEXTS,
}


@cache
def messages_of(message_type: type[Message]) -> st.SearchStrategy[Message]:
    """Any message of a type; its numbers are finite, since JSON knows no others."""
    return cast("st.SearchStrategy[Message]", _values(inspect.type_info(message_type)))


def _values(info: inspect.Type) -> st.SearchStrategy[object]:
    if isinstance(info, inspect.Metadata):
        return FLOATS32 if info.extra == {"cdr": "f"} else _values(info.type)
    if isinstance(info, inspect.StructType):
        return st.builds(info.cls, **{field.name: _values(field.type) for field in info.fields})
    if isinstance(info, inspect.UnionType):
        return st.one_of(*map(_values, info.types))
    if isinstance(info, inspect.VarTupleType | inspect.TupleType | inspect.DictType):
        return _collections(info)
    return _plain_values(info)


def _collections(
    info: inspect.VarTupleType | inspect.TupleType | inspect.DictType,
) -> st.SearchStrategy[object]:
    if isinstance(info, inspect.DictType):
        return st.dictionaries(TEXTS, _values(info.value_type), max_size=MAX_ITEMS)
    if isinstance(info, inspect.TupleType):
        return st.tuples(*map(_values, info.item_types))
    least, most = info.min_length or 0, info.max_length or MAX_ITEMS
    return st.lists(_values(info.item_type), min_size=least, max_size=most).map(tuple)


def _plain_values(info: inspect.Type) -> st.SearchStrategy[object]:
    if isinstance(info, inspect.LiteralType):
        return st.sampled_from(info.values)
    if isinstance(info, inspect.IntType):
        most = UINT64 if info.le is None else info.le
        return st.integers(0 if info.ge is None else info.ge, most)
    return PLAIN[type(info)]
