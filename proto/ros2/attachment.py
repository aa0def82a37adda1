"""What rmw_zenoh attaches to each sample, request and reply: 33 bytes, little endian.

A sequence number (int64), the source's time (int64), the length 16, and the sender's gid.
"""

import struct
from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

GID_BYTES: Final = 16
FORM: Final = struct.Struct(f"<qqB{GID_BYTES}s")
COLUMNS: Final = np.dtype(
    [
        ("sequence_number", "<i8"),
        ("source_time_ns", "<i8"),
        ("length", "u1"),
        ("gid", "u1", GID_BYTES),
    ]
)


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
    return FORM.pack(
        attachment.sequence_number, attachment.source_time_ns, GID_BYTES, attachment.gid
    )


def read_attachment(raw: bytes) -> Attachment | None:
    """Read the 33 bytes; None when they are not that."""
    if len(raw) != FORM.size:
        return None
    sequence_number, source_time_ns, length, gid = FORM.unpack(raw)
    if length != GID_BYTES:
        return None
    return Attachment(sequence_number, source_time_ns, gid)


class Attachments:
    """Those of many publishers, a row each, written for many at once."""

    def __init__(self) -> None:
        self._rows = np.zeros(0, dtype=COLUMNS)
        self._free: list[int] = []

    def add(self, gid: bytes) -> int:
        """Take a publisher in that has sent nothing; return its row."""
        if not self._free:
            count = len(self._rows)
            self._rows = np.concatenate([self._rows, np.zeros(count + 1, dtype=COLUMNS)])
            self._free = list(range(len(self._rows) - 1, count - 1, -1))
        row = self._free.pop()
        self._rows[row] = (0, 0, GID_BYTES, np.frombuffer(gid, dtype=np.uint8))
        return row

    def remove(self, row: int) -> None:
        """Let a publisher go."""
        self._free.append(row)

    def following(self, rows: Sequence[int], time_ns: int) -> list[bytes]:
        """Write what goes with the next message of each of some rows, none of them twice."""
        at = np.array(rows, dtype=np.intp)
        self._rows["sequence_number"][at] += 1
        self._rows["source_time_ns"][at] = time_ns
        raw = self._rows[at].tobytes()
        return [raw[start : start + FORM.size] for start in range(0, len(raw), FORM.size)]
