"""CDR: messages as ROS 2 writes them, from the struct types alone.

A 4-byte header, then the fields, each aligned to its own size counted from the end of the header.
Little endian is written; both byte orders are read. Source: OMG DDS-RTPS and DDS-XTypes, XCDR1.
"""

from functools import cache
from typing import TypeVar, cast

import msgspec

from zensim.proto.cdr_read import MalformedPayload, reader
from zensim.proto.cdr_write import writer

HEADER = b"\x00\x01\x00\x00"
MAX_PADDING = 3
"""Bytes that some writers add after the last field."""

Message = TypeVar("Message", bound=msgspec.Struct)


def encode(message: msgspec.Struct) -> bytes:
    """Write a message.

    Raises:
        TypeError: Its type is not expressible in CDR.
        ValueError: A value does not fit its field.
    """
    out = bytearray(HEADER)
    writer(type(message))(message, out)
    return bytes(out)


def decode(message_type: type[Message], payload: bytes) -> Message:
    """Read a message.

    Raises:
        TypeError: The type is not expressible in CDR.
        MalformedPayload: The bytes are not that message.
    """
    message, end = reader(message_type, _byte_order(payload))(payload, len(HEADER))
    if len(payload) - end > MAX_PADDING:
        raise MalformedPayload(
            f"the last field ends at byte {end}, but the payload has {len(payload)} bytes"
        )
    return cast("Message", message)


@cache
def is_expressible(message_type: type[msgspec.Struct]) -> bool:
    """Whether CDR has a form for this type."""
    try:
        writer(message_type)
    except TypeError:
        return False
    return True


def _byte_order(payload: bytes) -> str:
    # The last two bytes of the header are options that every reader ignores.
    if len(payload) >= len(HEADER) and payload[0] == 0 and payload[1] <= 1:
        return "<" if payload[1] else ">"
    raise MalformedPayload(f"the header is '{payload[: len(HEADER)].hex(' ')}'; use '00 01 00 00'")
