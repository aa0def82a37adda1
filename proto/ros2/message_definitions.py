"""Message definitions as text, in MCAP's schema encoding `ros2msg`, from struct types."""

from functools import cache
from typing import Final

import msgspec

from zensim.proto.ros2.type_hash import (
    ARRAY,
    BOUNDED,
    BOUNDED_TEXT,
    BYTE,
    DUMMY_MEMBER,
    NESTED,
    NUMBER_OF_CODE,
    SEQUENCE,
    TEXT,
    FieldType,
    TypeDescription,
    describe_type,
)

SEPARATOR: Final = "=" * 80
"""Line between a definition and those that it refers to."""
NAME_OF_CODE: Final = {
    "b": "int8",
    "B": "uint8",
    "h": "int16",
    "H": "uint16",
    "i": "int32",
    "I": "uint32",
    "q": "int64",
    "Q": "uint64",
    "f": "float32",
    "d": "float64",
    "?": "bool",
}
NAME_OF_NUMBER: Final = {NUMBER_OF_CODE[code]: name for code, name in NAME_OF_CODE.items()} | {
    BYTE: "byte",
    TEXT: "string",
}


@cache
def write_definition(message_type: type[msgspec.Struct]) -> str:
    """Write the definition of a message, and behind it those of all types that it refers to.

    Raises:
        TypeError: The type is not expressible in CDR.
    """
    whole = describe_type(message_type)
    others = (
        f"MSG: {_shorten(other['type_name'])}\n{_write_fields(other)}"
        for other in whole["referenced_type_descriptions"]
    )
    return f"{SEPARATOR}\n".join((_write_fields(whole["type_description"]), *others))


def _write_fields(described: TypeDescription) -> str:
    # rosidl gives an empty message a field that its definition does not have.
    return "".join(
        f"{_write_type(field['type'])} {field['name']}\n"
        for field in described["fields"]
        if field["name"] != DUMMY_MEMBER
    )


def _write_type(kind: FieldType) -> str:
    """Write the type of a field: `float64[36]`, `string<=64`, `geometry_msgs/Pose[]`."""
    number, suffix = kind["type_id"], ""
    for start, written in (
        (SEQUENCE, "[]"),
        (BOUNDED, f"[<={kind['capacity']}]"),
        (ARRAY, f"[{kind['capacity']}]"),
    ):
        if number > start:
            number, suffix = number - start, written
            break
    if number == NESTED:
        return _shorten(kind["nested_type_name"]) + suffix
    if number == BOUNDED_TEXT:
        return f"string<={kind['string_capacity']}{suffix}"
    return NAME_OF_NUMBER[number] + suffix


def _shorten(ros_type: str) -> str:
    """Convert `pkg/msg/Name` to `pkg/Name`, as definitions refer to types."""
    return ros_type.replace("/msg/", "/")
