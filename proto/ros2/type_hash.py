"""RIHS01 type hashes of messages and services, computed from struct types."""

import json
from functools import cache
from typing import Final, TypedDict, cast

import msgspec
from msgspec import inspect

from zensim.proto.codec.cdr_layout import find_ros_class, unwrap_metadata
from zensim.proto.messages.standard_messages import Time
from zensim.proto.sha256 import sha256

RIHS_PREFIX: Final = "RIHS01_"
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
"""Type ids of rosidl by format character of `struct`."""
BYTE, TEXT, BOUNDED_TEXT = 16, 17, 21
ARRAY, BOUNDED, SEQUENCE = 48, 96, 144
"""Added to a type id."""
DUMMY_MEMBER: Final = "structure_needs_at_least_one_member"
GID_LENGTH: Final = 16
EVENT_INFO: Final = "service_msgs/msg/ServiceEventInfo"


class FieldType(TypedDict):
    """Type of a field; `nested_type_name` is empty for other types."""

    type_id: int
    capacity: int
    string_capacity: int
    nested_type_name: str


class FieldDescription(TypedDict):
    """A field."""

    name: str
    type: FieldType


class TypeDescription(TypedDict):
    """A type without the types that it refers to."""

    type_name: str
    fields: list[FieldDescription]


class WholeDescription(TypedDict):
    """A type and all types that it refers to, by name."""

    type_description: TypeDescription
    referenced_type_descriptions: list[TypeDescription]


def describe_type(message_type: type[msgspec.Struct]) -> WholeDescription:
    """Describe a message, by the class that names the ROS interface.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    known: dict[str, TypeDescription] = {}
    return _collect_types(_describe(message_type, known), known)


@cache
def hash_type(message_type: type[msgspec.Struct]) -> str:
    """Compute the type hash of a message.

    Raises:
        TypeError: See `describe_type`.
    """
    return _hash_description(describe_type(message_type))


@cache
def hash_service(request: type[msgspec.Struct], response: type[msgspec.Struct]) -> str:
    """Compute the type hash of a service, or of one service of an action.

    Raises:
        TypeError: See `describe_service`.
    """
    return _hash_description(describe_service(request, response))


def describe_service(
    request: type[msgspec.Struct], response: type[msgspec.Struct]
) -> WholeDescription:
    """Describe a service, or one service of an action.

    Raises:
        TypeError: A type is not expressible in CDR.
    """
    known: dict[str, TypeDescription] = {}
    request_name, response_name = _describe(request, known), _describe(response, known)
    name = find_service_type(request)
    event = _describe_event(name, known, request_name, response_name)
    parts = {
        "request_message": request_name,
        "response_message": response_name,
        "event_message": event,
    }
    fields = [_make_field(part, NESTED, nested) for part, nested in parts.items()]
    known[name] = TypeDescription(type_name=name, fields=fields)
    return _collect_types(name, known)


def find_service_type(request: type[msgspec.Struct]) -> str:
    """Derive the ROS type of a service, `pkg/srv/Name`, from its request."""
    return str(vars(find_ros_class(request))["ros_type"]).removesuffix("_Request")


def _collect_types(name: str, known: dict[str, TypeDescription]) -> WholeDescription:
    others = [description for other, description in sorted(known.items()) if other != name]
    return WholeDescription(type_description=known[name], referenced_type_descriptions=others)


def _hash_description(whole: WholeDescription) -> str:
    return RIHS_PREFIX + sha256(json.dumps(whole).encode()).hexdigest()


def _describe(message_type: type[msgspec.Struct], known: dict[str, TypeDescription]) -> str:
    """Describe a type and its nested types; return its name."""
    named = find_ros_class(message_type)
    name = str(vars(named)["ros_type"])
    if name not in known:
        info = cast("inspect.StructType", inspect.type_info(named))
        fields = [_describe_field(field.name, field.type, known) for field in info.fields]
        dummy = [_make_field(DUMMY_MEMBER, NUMBER_OF_CODE["B"])]
        known[name] = TypeDescription(type_name=name, fields=fields or dummy)
    return name


def _describe_event(
    service: str, known: dict[str, TypeDescription], request: str, response: str
) -> str:
    code = NUMBER_OF_CODE
    info = [
        _make_field("event_type", code["B"]),
        _make_field("stamp", NESTED, _describe(Time, known)),
        # rosidl describes char as uint8.
        _make_field("client_gid", ARRAY + code["B"], capacity=GID_LENGTH),
        _make_field("sequence_number", code["q"]),
    ]
    name = f"{service}_Event"
    known[EVENT_INFO] = TypeDescription(type_name=EVENT_INFO, fields=info)
    fields = [
        _make_field("info", NESTED, EVENT_INFO),
        _make_field("request", BOUNDED + NESTED, request, capacity=1),
        _make_field("response", BOUNDED + NESTED, response, capacity=1),
    ]
    known[name] = TypeDescription(type_name=name, fields=fields)
    return name


def _describe_field(
    name: str, info: inspect.Type, known: dict[str, TypeDescription]
) -> FieldDescription:
    bare, extra = unwrap_metadata(info)
    bound = cast("int", extra.get("bound", 0))
    if isinstance(bare, inspect.BytesType):
        code = NUMBER_OF_CODE[str(extra.get("cdr", "B"))]
        return _make_field(name, SEQUENCE + (BYTE if extra.get("rosidl") == "byte" else code))
    if isinstance(bare, inspect.StrType) and bound:
        return _make_field(name, BOUNDED_TEXT, string_capacity=bound)
    if not isinstance(bare, inspect.VarTupleType):
        return _make_field(name, *_find_type_number(name, bare, extra, known))
    item, item_extra = unwrap_metadata(bare.item_type)
    number, nested = _find_type_number(name, item, extra | item_extra, known)
    if isinstance(length := extra.get("length"), int):
        return _make_field(name, ARRAY + number, nested, capacity=length)
    if bound:
        return _make_field(name, BOUNDED + number, nested, capacity=bound)
    return _make_field(name, SEQUENCE + number, nested)


def _find_type_number(
    name: str, info: inspect.Type, extra: dict[str, object], known: dict[str, TypeDescription]
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


def _make_field(
    name: str, number: int, nested: str = "", *, capacity: int = 0, string_capacity: int = 0
) -> FieldDescription:
    kind = FieldType(
        type_id=number, capacity=capacity, string_capacity=string_capacity, nested_type_name=nested
    )
    return FieldDescription(name=name, type=kind)
