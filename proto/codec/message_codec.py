"""Encode and decode messages as CDR, MessagePack or JSON; detect the format."""

from enum import Enum
from functools import cache
from threading import RLock
from typing import TypeVar, cast

import msgspec

from zensim.proto.codec import cdr
from zensim.proto.codec.cdr_reader import MalformedPayload
from zensim.proto.codec.unknown_fields import describe_unknown_field

__all__ = [
    "Format",
    "MalformedPayload",
    "decode",
    "detect_format",
    "encode",
    "make_encoding",
    "parse_schema_name",
    "supports_format",
]

MAX_DETAIL = 200
"""Characters of a decoder's message that are passed on; part of them is chosen by the sender."""

Message = TypeVar("Message", bound=msgspec.Struct)


class Format(Enum):
    """Serialization format; the value is the Zenoh Encoding."""

    CDR = "application/cdr"
    MSGPACK = "application/msgpack"
    JSON = "application/json"


FORMAT_OF_ENCODING: dict[str, Format] = {
    "application/cdr": Format.CDR,
    "application/msgpack": Format.MSGPACK,
    "application/json": Format.JSON,
    "text/json": Format.JSON,
}
FORMAT_OF_FIRST_BYTE: dict[int, Format] = {
    0x00: Format.CDR,
    **dict.fromkeys((*range(0x80, 0x90), 0xDE, 0xDF), Format.MSGPACK),
    **dict.fromkeys(b"{ \t\r\n", Format.JSON),
}

_DECODERS_LOCK = RLock()
"""Lock for making decoders: while msgspec describes a type, other threads see half of it."""

_WRITE_MSGPACK = msgspec.msgpack.Encoder().encode
_WRITE_JSON = msgspec.json.Encoder().encode


def encode(message: msgspec.Struct, format: Format) -> bytes:
    """Encode a message.

    NaN and infinity become null in JSON, which `decode` rejects for a number.

    Raises:
        TypeError: The format is CDR, and the type is not expressible in it.
        ValueError: A value does not fit its field.
    """
    try:
        if format is Format.CDR:
            return cdr.encode(message)
        return _WRITE_JSON(message) if format is Format.JSON else _WRITE_MSGPACK(message)
    except OverflowError as error:
        raise ValueError(
            f"{_find_type_name(type(message))} does not fit {format.name}: {error}"
        ) from error


def decode(message_type: type[Message], payload: bytes, encoding: str = "") -> Message:
    """Decode a message; the Zenoh Encoding, else the first byte, selects the format.

    An empty payload is the message with default fields. JSON has no other fields.

    Raises:
        MalformedPayload: The bytes do not encode this type, or do not fit the Encoding.
    """
    format_ = detect_format(payload, encoding)
    try:
        if not payload:
            return _make_default(message_type)
        if format_ is Format.CDR:
            return _from_cdr(message_type, payload, encoding)
        if format_ is Format.JSON:
            return _from_json(message_type, payload)
        return cast("Message", _msgpack_decoder(message_type).decode(payload))
    except (ValueError, RecursionError) as error:
        detail = " ".join(str(error).split())[:MAX_DETAIL]
        raise MalformedPayload(
            f"not {_find_type_name(message_type)} in {format_.name}: {detail}"
        ) from error


def detect_format(payload: bytes, encoding: str = "") -> Format:
    """Detect the format by the Zenoh Encoding, else by the first byte; MessagePack if empty.

    Raises:
        MalformedPayload: The first byte is of no format, or not of that of the Encoding.
    """
    declared = FORMAT_OF_ENCODING.get(encoding.partition(";")[0])
    if not payload:
        return declared or Format.MSGPACK
    found = FORMAT_OF_FIRST_BYTE.get(payload[0])
    if found is None:
        raise MalformedPayload(
            f"first byte 0x{payload[0]:02x} is of no known format; use CDR (0x00), a MessagePack "
            "map or a JSON object"
        )
    if declared in (None, found):
        return found
    raise MalformedPayload(f"Encoding is {encoding[:80]!r}, but the bytes begin as {found.name}")


def parse_schema_name(encoding: str) -> str:
    """Return the ROS type in a CDR Encoding; empty if there is none."""
    format_, _, schema = encoding.partition(";")
    return schema if format_ == Format.CDR.value else ""


def make_encoding(message: msgspec.Struct | type[msgspec.Struct], format: Format) -> str:
    """Write the Zenoh Encoding of a message or type; for CDR with the ROS type."""
    if format is not Format.CDR:
        return str(format.value)
    return _cdr_encoding(message if isinstance(message, type) else type(message))


def supports_format(message_type: type[msgspec.Struct], format: Format) -> bool:
    """Whether the type can be encoded in a format; MessagePack and JSON support all types."""
    return format is not Format.CDR or cdr.is_expressible(message_type)


def _make_default(message_type: type[Message]) -> Message:
    try:
        return message_type()
    except TypeError as error:
        raise MalformedPayload(f"the payload is empty: {error}") from error


def _from_cdr(message_type: type[Message], payload: bytes, encoding: str) -> Message:
    if not cdr.is_expressible(message_type):
        raise MalformedPayload("the type is not expressible in CDR; use MessagePack or JSON")
    if encoding != _cdr_encoding(message_type):
        schema = parse_schema_name(encoding)
        if schema not in ("", _find_type_name(message_type)):
            raise MalformedPayload(f"the Encoding names {schema}; use this type or none")
    return cdr.decode(message_type, payload)


def _from_json(message_type: type[Message], payload: bytes) -> Message:
    message = _json_decoder(message_type).decode(payload)
    # People write JSON; programs, which may be of another version, write the other formats.
    if unknown := describe_unknown_field(message_type, msgspec.json.decode(payload)):
        raise MalformedPayload(unknown)
    try:
        _WRITE_MSGPACK(message)  # Only JSON has integers beyond 64 bits.
    except OverflowError as error:
        raise MalformedPayload("an integer is beyond 64 bits") from error
    return cast("Message", message)


@cache
def _cdr_encoding(message_type: type[msgspec.Struct]) -> str:
    return f"{Format.CDR.value};{_find_type_name(message_type)}"


@cache
def _msgpack_decoder(message_type: type[Message]) -> msgspec.msgpack.Decoder[Message]:
    with _DECODERS_LOCK:
        return msgspec.msgpack.Decoder(message_type)


@cache
def _json_decoder(message_type: type[Message]) -> msgspec.json.Decoder[Message]:
    with _DECODERS_LOCK:
        return msgspec.json.Decoder(message_type)


def _find_type_name(message_type: type[msgspec.Struct]) -> str:
    """Return the ROS type, else the class name."""
    return str(getattr(message_type, "ros_type", message_type.__name__))
