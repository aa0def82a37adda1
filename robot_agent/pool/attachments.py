"""What goes with the messages of many publishers in ROS 2, written for many at once."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from zensim.proto.ros2.rmw_attachment import ATTACHMENT_STRUCT, GID_BYTES

COLUMNS: Final = np.dtype(
    [
        ("sequence_number", "<i8"),
        ("source_time_ns", "<i8"),
        ("length", "u1"),
        ("gid", "u1", GID_BYTES),
    ]
)
"""See `zensim.proto.ros2.rmw_attachment`."""


class Attachments:
    """A row a publisher."""

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
        return [
            raw[start : start + ATTACHMENT_STRUCT.size]
            for start in range(0, len(raw), ATTACHMENT_STRUCT.size)
        ]
