"""Hashes of ROS 2 types, from our Structs: RIHS01, the SHA-256 of a type's description.

Source: REP-2011 and REP-2016; the description is JSON whose spelling is part of the hash.
"""

import hashlib
import json
from functools import cache
from typing import Final, TypedDict, cast

import msgspec
from msgspec import inspect

from zensim.proto.cdr_layout import ros_class
from zensim.proto.header import Time

PREFIX: Final = "RIHS01_"
NESTED: Final = 1
NUMBER_OF_CODE: Final = {
    "b": 2,
    "B": 3,
    "h": 4,
    "H": 5,
    "i": 6,
    "I": 7,
    "q": 8,
    "Q": 9,
    "f": 10,
    "d": 11,
    "?": 15,
}
"""Of the `struct` module to rosidl's numbers of types."""
TEXT: Final = 17
ARRAY, BOUNDED, SEQUENCE = 48, 96, 144
"""Added to a type's number."""
DUMMY: Final = "structure_needs_at_least_one_member"
GID_LENGTH: Final = 16
EVENT_INFO: Final = "service_msgs/msg/ServiceEventInfo"


class TypeOfField(TypedDict):
    """A field's type; a name only where it is nested."""

    type_id: int
    capacity: int
    string_capacity: int
    nested_type_name: str


class Field(TypedDict):
    """A field."""

    name: str
    type: TypeOfField


class Description(TypedDict):
    """A type by itself."""

    type_name: str
    fields: list[Field]


@cache
def type_hash(message_type: type[msgspec.Struct]) -> str:
    """Find the hash of a message's type: of the class that names the ROS interface.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    known: dict[str, Description] = {}
    return _hash_of(_describe(message_type, known), known)


@cache
def service_hash(request: type[msgspec.Struct], response: type[msgspec.Struct]) -> str:
    """Find the hash of a service, or of one service of an action.

    Raises:
        TypeError: A type is not expressible in CDR.
    """
    known: dict[str, Description] = {}
    asked, answered = _describe(request, known), _describe(response, known)
    name = service_type(request)
    event = _describe_event(name, known, asked, answered)
    halves = {"request_message": asked, "response_message": answered, "event_message": event}
    fields = [_field(half, NESTED, nested) for half, nested in halves.items()]
    known[name] = Description(type_name=name, fields=fields)
    return _hash_of(name, known)


def service_type(request: type[msgspec.Struct]) -> str:
    """Name the ROS type of a service by that of its request: `pkg/srv/Name`."""
    return str(vars(ros_class(request))["ros_type"]).removesuffix("_Request")


def _hash_of(name: str, known: dict[str, Description]) -> str:
    others = [description for other, description in sorted(known.items()) if other != name]
    whole = {"type_description": known[name], "referenced_type_descriptions": others}
    return PREFIX + hashlib.sha256(json.dumps(whole).encode()).hexdigest()


def _describe(message_type: type[msgspec.Struct], known: dict[str, Description]) -> str:
    """Describe a type and all within it; return its name."""
    named = ros_class(message_type)
    name = str(vars(named)["ros_type"])
    if name not in known:
        info = cast("inspect.StructType", inspect.type_info(named))
        fields = [_described(field.name, field.type, known) for field in info.fields]
        dummy = [_field(DUMMY, NUMBER_OF_CODE["B"])]
        known[name] = Description(type_name=name, fields=fields or dummy)
    return name


def _describe_event(service: str, known: dict[str, Description], asked: str, answered: str) -> str:
    code = NUMBER_OF_CODE
    info = [
        _field("event_type", code["B"]),
        _field("stamp", NESTED, _describe(Time, known)),
        # An array of char, which is uint8 to rosidl.
        _field("client_gid", ARRAY + code["B"], capacity=GID_LENGTH),
        _field("sequence_number", code["q"]),
    ]
    name = f"{service}_Event"
    known[EVENT_INFO] = Description(type_name=EVENT_INFO, fields=info)
    fields = [
        _field("info", NESTED, EVENT_INFO),
        _field("request", BOUNDED + NESTED, asked, capacity=1),
        _field("response", BOUNDED + NESTED, answered, capacity=1),
    ]
    known[name] = Description(type_name=name, fields=fields)
    return name


def _described(name: str, info: inspect.Type, known: dict[str, Description]) -> Field:
    bare, extra = _unwrapped(info)
    if isinstance(bare, inspect.BytesType):
        return _field(name, SEQUENCE + NUMBER_OF_CODE["B"])
    if not isinstance(bare, inspect.VarTupleType):
        return _field(name, *_number(name, bare, extra, known))
    item, item_extra = _unwrapped(bare.item_type)
    number, nested = _number(name, item, extra | item_extra, known)
    if isinstance(length := extra.get("length"), int):
        return _field(name, ARRAY + number, nested, capacity=length)
    return _field(name, SEQUENCE + number, nested)


def _number(
    name: str, info: inspect.Type, extra: dict[str, object], known: dict[str, Description]
) -> tuple[int, str]:
    if isinstance(info, inspect.StructType):
        return NESTED, _describe(info.cls, known)
    if isinstance(info, inspect.StrType):
        return TEXT, ""
    if isinstance(info, inspect.BoolType):
        return NUMBER_OF_CODE["?"], ""
    code = extra.get("cdr", "d" if isinstance(info, inspect.FloatType) else None)
    if code not in NUMBER_OF_CODE:
        raise TypeError(f"field '{name}' is a {type(info).__name__} without a CDR width")
    return NUMBER_OF_CODE[str(code)], ""


def _unwrapped(info: inspect.Type) -> tuple[inspect.Type, dict[str, object]]:
    if isinstance(info, inspect.Metadata):
        return info.type, info.extra or {}
    return info, {}


def _field(name: str, number: int, nested: str = "", *, capacity: int = 0) -> Field:
    kind = TypeOfField(
        type_id=number, capacity=capacity, string_capacity=0, nested_type_name=nested
    )
    return Field(name=name, type=kind)
