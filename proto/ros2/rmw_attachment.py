"""The 33-byte attachment of rmw_zenoh: sequence number, source time, gid."""

import struct
from typing import Final

import msgspec

GID_BYTES: Final = 16
ATTACHMENT_STRUCT: Final = struct.Struct(f"<qqB{GID_BYTES}s")


class Attachment(msgspec.Struct, frozen=True):
    """Which message of whom this is."""

    sequence_number: int
    """A publisher's first is 1; ROS takes a gap for messages lost."""
    source_time_ns: int
    """Wall time since 1970."""
    gid: bytes
    """16 bytes that name the sender; an answer has those of who asked."""


def write_attachment(attachment: Attachment) -> bytes:
    """Write the 33 bytes."""
    return ATTACHMENT_STRUCT.pack(
        attachment.sequence_number, attachment.source_time_ns, GID_BYTES, attachment.gid
    )


def read_attachment(raw: bytes) -> Attachment | None:
    """Read the 33 bytes; None when they are not that."""
    if len(raw) != ATTACHMENT_STRUCT.size:
        return None
    sequence_number, source_time_ns, length, gid = ATTACHMENT_STRUCT.unpack(raw)
    if length != GID_BYTES:
        return None
    return Attachment(sequence_number, source_time_ns, gid)
