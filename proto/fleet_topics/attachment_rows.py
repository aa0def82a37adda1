"""ROS 2 attachments of many publishers, a row each."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from zensim.proto.ros2.rmw_attachment import ATTACHMENT_STRUCT, GID_BYTES

ATTACHMENT_DTYPE: Final = np.dtype(
    [
        ("sequence_number", "<i8"),
        ("source_time_ns", "<i8"),
        ("length", "u1"),
        ("gid", "u1", GID_BYTES),
    ]
)
"""Layout of `zensim.proto.ros2.rmw_attachment`."""


class AttachmentRows:
    """ROS 2 attachments of many publishers, a row each."""

    def __init__(self) -> None:
        self._rows = np.zeros(0, dtype=ATTACHMENT_DTYPE)
        self._free: list[int] = []

    def add(self, gid: bytes) -> int:
        """Add a publisher that has sent nothing; return its row."""
        if not self._free:
            count = len(self._rows)
            self._rows = np.concatenate([self._rows, np.zeros(count + 1, dtype=ATTACHMENT_DTYPE)])
            self._free = list(range(len(self._rows) - 1, count - 1, -1))
        row = self._free.pop()
        self._rows[row] = (0, 0, GID_BYTES, np.frombuffer(gid, dtype=np.uint8))
        return row

    def remove(self, row: int) -> None:
        """Remove a publisher."""
        self._free.append(row)

    def write_next(self, rows: Sequence[int], time_ns: int) -> list[bytes]:
        """Write the attachments of the next messages of some rows, without duplicates."""
        at = np.array(rows, dtype=np.intp)
        self._rows["sequence_number"][at] += 1
        self._rows["source_time_ns"][at] = time_ns
        raw = self._rows[at].tobytes()
        return [
            raw[start : start + ATTACHMENT_STRUCT.size]
            for start in range(0, len(raw), ATTACHMENT_STRUCT.size)
        ]
