"""CDR images of one message with the transforms of many robots, of any of them at a time.

Numbers are aligned: what follows other transforms begins at a multiple of 8 bytes, what begins a
message does not. So each robot has an image for either place, and a message is put together.
"""

import struct
from collections.abc import Sequence

from zensim.proto.codec.cdr import encode
from zensim.proto.codec.cdr_layout import HEADER_BYTES
from zensim.proto.messages.standard_messages import TFMessage, TransformStamped
from zensim.robot_agent.pool.images import Images
from zensim.robot_agent.pool.rows import FloatArray, IntArray
from zensim.robot_agent.templates import tf_paths, tf_stamps

BLANK = TransformStamped()
"""Stands for the transforms of others."""
COUNT = struct.Struct("<I")
BEFORE_FIRST = HEADER_BYTES + COUNT.size
BEFORE_LATER = len(encode(TFMessage((BLANK,))))


class JoinedImages:
    """Transforms of a row each, as many in each row."""

    def __init__(self, templates: Sequence[TFMessage]) -> None:
        """Write the messages, one a row, with any numbers."""
        self._count = len(templates[0].transforms) if templates else 0
        self._first = Images(templates, tf_paths(self._count), tf_stamps(self._count))
        shifted = [TFMessage((BLANK, *one.transforms)) for one in templates]
        blank = len(tf_paths(1))
        self._later = Images(
            shifted, tf_paths(self._count + 1)[blank:], tf_stamps(self._count + 1)[1:]
        )

    def message(self, rows: IntArray, poses: FloatArray, times_ns: IntArray) -> bytes:
        """Write the transforms of some rows, at least one.

        Args:
            rows: In the order of the message, none twice; (m,).
            poses: (m, 7 * transforms of a row).
            times_ns: Stamps, (m,).
        """
        self._first.fill(rows[:1], poses[:1], times_ns[:1])
        self._later.fill(rows[1:], poses[1:], times_ns[1:])
        first = self._first.payload(int(rows[0]))
        parts = [first[:HEADER_BYTES], COUNT.pack(self._count * len(rows)), first[BEFORE_FIRST:]]
        parts += [later[BEFORE_LATER:] for later in self._later.payloads(rows[1:])]
        return b"".join(parts)

    def size(self, row: int) -> int:
        """Tell how many bytes a row takes."""
        return len(self._later.payload(row)) - BEFORE_LATER
