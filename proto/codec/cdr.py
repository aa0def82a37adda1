"""CDR messages: header and body, as ROS 2 has them."""

from functools import cache
from typing import TypeVar, cast

import msgspec

from zensim.proto.codec.cdr_reader import MalformedPayload, compile_reader
from zensim.proto.codec.cdr_writer import compile_writer

HEADER = b"\x00\x01\x00\x00"
MAX_PADDING = 3
"""Bytes that some writers append to the last field."""

Message = TypeVar("Message", bound=msgspec.Struct)


def encode(message: msgspec.Struct) -> bytes:
    """Encode a message.

    Raises:
        TypeError: Its type is not expressible in CDR.
        ValueError: A value does not fit its field.
    """
    out = bytearray(HEADER)
    compile_writer(type(message))(message, out)
    return bytes(out)


def decode(message_type: type[Message], payload: bytes) -> Message:
    """Decode a message.

    Raises:
        TypeError: The type is not expressible in CDR.
        MalformedPayload: The bytes do not encode this type.
    """
    message, end = compile_reader(message_type, _parse_byte_order(payload))(payload, len(HEADER))
    if len(payload) - end > MAX_PADDING:
        raise MalformedPayload(
            f"the last field ends at byte {end}, but the payload has {len(payload)} bytes"
        )
    return cast("Message", message)


@cache
def is_expressible(message_type: type[msgspec.Struct]) -> bool:
    """Whether the type can be encoded as CDR."""
    try:
        compile_writer(message_type)
    except TypeError:
        return False
    return True


def _parse_byte_order(payload: bytes) -> str:
    # The last two bytes of the header are options that every reader ignores.
    if len(payload) >= len(HEADER) and payload[0] == 0 and payload[1] <= 1:
        return "<" if payload[1] else ">"
    raise MalformedPayload(f"the header is '{payload[: len(HEADER)].hex(' ')}'; use '00 01 00 00'")
