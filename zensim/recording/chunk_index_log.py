"""The index of the chunks of a file until its summary is written, in little memory."""

import struct
from collections.abc import Iterator, Mapping
from typing import Final

from zensim.recording.chunk_compression import CompressedLog
from zensim.recording.mcap_records import (
    LENGTH,
    LONG_LENGTH,
    RECORD_HEAD,
    TIMES,
    Chunk,
    Opcode,
    write_numbers,
    write_record,
    write_text,
)

FACTS: Final = struct.Struct("<QQQQQQ4sI")
"""Times, position, bytes of record, content and uncompressed content, compression, channels."""
COUNT: Final = struct.Struct("<HI")
"""Channel, and number of its messages."""
POSITION_BYTES: Final = 16
"""Log time and offset of a message in a message index."""
MESSAGE_INDEX_BYTES: Final = RECORD_HEAD.size + 2 + LENGTH.size
"""Size of a message index without messages."""


class ChunkIndexLog:
    """Chunk indexes, kept as counts of messages: positions of message indexes do not compress."""

    def __init__(self) -> None:
        self._log = CompressedLog()
        self.size = 0
        """Bytes of the records."""

    def append(self, chunk: Chunk, at: int, length: int, counts: Mapping[int, int]) -> None:
        """Append the index of a chunk.

        Args:
            chunk: Its message indexes follow it in the file, in the order of the counts.
            at: Position of its record.
            length: Of its record [bytes].
            counts: Messages by channel.
        """
        facts = FACTS.pack(
            chunk.start_ns,
            chunk.end_ns,
            at,
            length,
            len(chunk.content),
            chunk.size,
            chunk.compression.encode(),
            len(counts),
        )
        kept = facts + b"".join(COUNT.pack(*one) for one in counts.items())
        self._log.append(kept)
        self.size += len(_write_index(kept))

    def read(self) -> Iterator[bytes]:
        """Read the records in turn; nothing can be appended then."""
        waiting = b""
        for piece in self._log.read():
            waiting += piece
            start = 0
            while (end := _find_end(waiting, start)) <= len(waiting):
                yield _write_index(waiting[start:end])
                start = end
            waiting = waiting[start:]


def _find_end(kept: bytes, start: int) -> int:
    """Find the end of the facts of a chunk that begin there."""
    facts_end = start + FACTS.size
    if facts_end > len(kept):
        return facts_end
    (channels,) = LENGTH.unpack_from(kept, facts_end - LENGTH.size)
    return facts_end + int(channels) * COUNT.size


def _write_index(kept: bytes) -> bytes:
    start_ns, end_ns, start, length, content, size, compression, _ = FACTS.unpack_from(kept)
    at, offsets = start + length, []
    for channel, count in COUNT.iter_unpack(kept[FACTS.size :]):
        offsets.append((channel, at))
        at += MESSAGE_INDEX_BYTES + POSITION_BYTES * count
    body = TIMES.pack(start_ns, end_ns) + struct.pack("<QQ", start, length)
    body += write_numbers("HQ", offsets) + LONG_LENGTH.pack(at - start - length)
    body += write_text(compression.rstrip(b"\0").decode()) + struct.pack("<QQ", content, size)
    return write_record(Opcode.CHUNK_INDEX, body)
