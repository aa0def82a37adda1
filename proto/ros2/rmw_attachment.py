"""The 33-byte attachment of rmw_zenoh: sequence number, source time, gid."""

import struct
from typing import Final

import msgspec

GID_BYTES: Final = 16
ATTACHMENT_STRUCT: Final = struct.Struct(f"<qqB{GID_BYTES}s")


class Attachment(msgspec.Struct, frozen=True):
    """Identifies a message of a publisher."""

    sequence_number: int
    """Starts with 1 per publisher; ROS 2 interprets a gap as lost messages."""
    source_time_ns: int
    """Unix time."""
    gid: bytes
    """16 bytes: id of the publisher; a response has that of the client."""


def write_attachment(attachment: Attachment) -> bytes:
    """Write the 33 bytes."""
    return ATTACHMENT_STRUCT.pack(
        attachment.sequence_number, attachment.source_time_ns, GID_BYTES, attachment.gid
    )


def read_attachment(raw: bytes) -> Attachment | None:
    """Read the 33 bytes; None if they are not an attachment."""
    if len(raw) != ATTACHMENT_STRUCT.size:
        return None
    sequence_number, source_time_ns, length, gid = ATTACHMENT_STRUCT.unpack(raw)
    if length != GID_BYTES:
        return None
    return Attachment(sequence_number, source_time_ns, gid)


def answer_attachment(raw: bytes, time_ns: int) -> bytes:
    """Write the attachment of a response: that of its request with another time.

    Args:
        raw: Attachment of the request; the response has none if this is not of ROS 2.
        time_ns: Unix time of the response.
    """
    request = read_attachment(raw)
    if request is None:
        return b""
    return write_attachment(msgspec.structs.replace(request, source_time_ns=time_ns))
