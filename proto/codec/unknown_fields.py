"""Finds fields of JSON objects that a message does not have."""

from collections.abc import Mapping
from functools import cache
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import msgspec

from zensim.proto.near_names import name_choices


def describe_unknown_field(kind: Any, given: object) -> str:  # noqa: ANN401  any type
    """Describe the first field that a type, or one inside it, does not have; empty if none.

    Args:
        kind: Type of a message or field.
        given: Decoded JSON that fits it.
    """
    if isinstance(given, list):
        element = next(iter(get_args(kind)), None)
        return next(filter(None, (describe_unknown_field(element, one) for one in given)), "")
    if not isinstance(given, dict):
        return ""
    choices = [one for one in _list_choices(kind) if _is_tagged_as(one, given)]
    if len(choices) != 1:
        return ""
    if get_origin(choices[0]) in (dict, Mapping):
        fields = dict.fromkeys(given, get_args(choices[0])[1])
    else:
        fields = _list_fields(choices[0])
    for name, value in given.items():
        if name not in fields:
            return f"unknown field `{name[:40]}`; use {name_choices(name, fields)}"
        if found := describe_unknown_field(fields[name], value):
            return found
    return ""


@cache
def _list_fields(kind: type[msgspec.Struct]) -> dict[str, Any]:
    fields = {one.encode_name: one.type for one in msgspec.structs.fields(kind)}
    tag = kind.__struct_config__.tag_field
    return fields if tag is None else {tag: str, **fields}


def _list_choices(kind: Any) -> list[Any]:  # noqa: ANN401
    """List the structs and mappings that a type may be."""
    if get_origin(kind) is Annotated:
        return _list_choices(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return [one for part in get_args(kind) for one in _list_choices(part)]
    is_object = isinstance(kind, type) and issubclass(kind, msgspec.Struct)
    return [kind] if is_object or get_origin(kind) in (dict, Mapping) else []


def _is_tagged_as(kind: Any, given: dict[str, object]) -> bool:  # noqa: ANN401
    config = getattr(kind, "__struct_config__", None)
    return config is None or config.tag is None or given.get(config.tag_field) == config.tag
