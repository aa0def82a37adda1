"""Writes an MCAP file: messages in compressed chunks, their index, attachments and a summary."""

import struct
import zlib
from collections.abc import Iterable
from typing import Final, Protocol

import msgspec

from zensim.recording.chunk_compression import LEVEL, compress
from zensim.recording.chunk_index_log import ChunkIndexLog
from zensim.recording.mcap_records import (
    FOOTER,
    LENGTH,
    LONG_LENGTH,
    MAGIC,
    MESSAGE_FIELDS_BYTES,
    MESSAGE_HEAD,
    RECORD_HEAD,
    STATISTICS,
    TIMES,
    AttachedFile,
    Channel,
    Chunk,
    ChunkIndex,
    Metadata,
    Opcode,
    Schema,
    write_attachment,
    write_channel,
    write_chunk,
    write_header,
    write_metadata,
    write_numbers,
    write_record,
    write_schema,
    write_text,
)

CHUNK_BYTES: Final = 1 << 20
"""Size of a chunk before compression. Smaller ones take a quarter more disk and time."""
PROFILE: Final = "ros2"
LIBRARY: Final = "zensim"
SPARE_BYTES: Final = 4096
"""Room for the records of a summary that are in every file."""


class Sink(Protocol):
    """A file that is appended to."""

    @property
    def position(self) -> int:
        """Bytes that were written."""

    def write(self, content: bytes) -> None:
        """Append all bytes, or none.

        Raises:
            OSError: None were appended.
        """


class ChunkSettings(msgspec.Struct, frozen=True):
    """Size and compression of chunks."""

    size: int = CHUNK_BYTES
    """Least size before compression [bytes]."""
    level: int = LEVEL
    """Level of Zstandard; 0 = no compression."""


DEFAULT_CHUNKS: Final = ChunkSettings()
DEFAULT_PRESET: Final = "zstd_fast"
PRESETS: Final = {
    "none": ChunkSettings(level=0),
    DEFAULT_PRESET: DEFAULT_CHUNKS,
    "zstd_small": ChunkSettings(size=4 * CHUNK_BYTES, level=19),
}
"""Storage presets of rosbag2, by name."""


class McapWriter:
    """Writes messages; what a failed write should have held counts as not written.

    A definition stands twice in the file: before the chunk of its first message, so that damage of
    that chunk does not take it away, and in the chunk, whose checksum covers it.
    """

    def __init__(self, sink: Sink, chunks: ChunkSettings = DEFAULT_CHUNKS) -> None:
        """Write the start of the file.

        Args:
            sink: The file.
            chunks: How chunks are written.

        Raises:
            OSError: The file cannot be written.
        """
        self._sink, self._settings = sink, chunks
        self._new: list[Schema | Channel] = []
        self._unwritten: list[Schema | Channel] = []
        self._written: list[Schema | Channel] = []
        self._records: list[bytes] = []
        """Records of the chunk that is not written yet."""
        self._size = 0
        """Bytes of these records."""
        self._index = ChunkIndex()
        self._chunk_indexes = ChunkIndexLog()
        self._attachment_indexes: list[bytes] = []
        self._metadata_indexes: list[bytes] = []
        self._chunks = self._definition_bytes = 0
        self._times: tuple[int, int] | None = None
        self.counts: dict[int, int] = {}
        """Messages in the file by channel."""
        sink.write(MAGIC + write_header(PROFILE, LIBRARY))

    @property
    def messages(self) -> int:
        """Number of messages in the file."""
        return sum(self.counts.values())

    @property
    def summary_bytes(self) -> int:
        """Number of bytes that `close` writes, at most."""
        others = sum(map(len, (*self._attachment_indexes, *self._metadata_indexes)))
        counts = 10 * len(self.counts)
        return self._chunk_indexes.size + self._definition_bytes + others + counts + SPARE_BYTES

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time [ns] of the messages in the file; zeros without any."""
        return self._times or (0, 0)

    def define(self, *definitions: Schema | Channel) -> None:
        """Define a schema, or a channel of a schema that was defined before."""
        self._new += definitions

    def write_message(self, channel: int, log_ns: int, publish_ns: int, payload: bytes) -> None:
        """Add a message to the chunk, and write the chunk if it is full.

        Raises:
            OSError: It could not be written; its messages are lost.
        """
        if self._new:
            self._add_definitions()
        # This runs for each message of a fleet: no calls but those that write.
        self._index.positions[channel] += (log_ns, self._size)
        length = MESSAGE_FIELDS_BYTES + len(payload)
        head = MESSAGE_HEAD.pack(Opcode.MESSAGE, length, channel, 0, log_ns, publish_ns)
        self._records += (head, payload)
        self._size += MESSAGE_HEAD.size + len(payload)
        if self._size >= self._settings.size:
            self.flush()

    def _add_definitions(self) -> None:
        """Add the new definitions to the chunk."""
        written = _write_definitions(self._new)
        self._records.append(written)
        self._size += len(written)
        self._unwritten += self._new
        self._new = []

    def flush(self) -> None:
        """Write the messages that wait.

        Raises:
            OSError: They could not be written, and are lost.
        """
        if not self._index.positions:
            return
        content, index, level = b"".join(self._records), self._index, self._settings.level
        self._records, self._size, self._index = [], 0, ChunkIndex()
        chunk = Chunk(
            *index.span_ns,
            len(content),
            zlib.crc32(content),
            "zstd" if level else "",
            compress(content, level) if level else content,
        )
        self.write_chunk(chunk, index)

    def write_chunk(self, chunk: Chunk, index: ChunkIndex) -> None:
        """Write a chunk with its index, and before it the definitions that are not written yet.

        Raises:
            OSError: It could not be written.
        """
        unwritten, self._unwritten = [*self._unwritten, *self._new], []
        self._new = []
        before, record = _write_definitions(unwritten), write_chunk(chunk)
        start, counts = self._sink.position + len(before), index.counts
        indexes = map(_write_message_index, index.positions, index.positions.values())
        self._sink.write(b"".join((before, record, *indexes)))
        self._written += unwritten
        self._definition_bytes += len(before)
        self._count(chunk, counts)
        self._chunk_indexes.append(chunk, start, len(record), counts)

    def attach(self, attachment: AttachedFile) -> None:
        """Write a file into the recording.

        Raises:
            OSError: It could not be written.
        """
        record, at = write_attachment(attachment), self._sink.position
        self._sink.write(record)
        one = attachment
        body = struct.pack("<QQ", at, len(record)) + TIMES.pack(one.log_time_ns, one.create_time_ns)
        body += LONG_LENGTH.pack(len(one.content)) + write_text(one.name)
        body += write_text(one.media_type)
        self._attachment_indexes.append(write_record(Opcode.ATTACHMENT_INDEX, body))

    def add_metadata(self, metadata: Metadata) -> None:
        """Write named texts.

        Raises:
            OSError: They could not be written.
        """
        record, at = write_metadata(metadata), self._sink.position
        self._sink.write(record)
        body = struct.pack("<QQ", at, len(record)) + write_text(metadata.name)
        self._metadata_indexes.append(write_record(Opcode.METADATA_INDEX, body))

    def close(self) -> None:
        """Write the summary; call `flush` before.

        Raises:
            OSError: It could not be written; the file is as one that was never closed.
        """
        self._sink.write(write_record(Opcode.DATA_END, LENGTH.pack(0)))
        start = at = self._sink.position
        crc, offsets = 0, []
        for opcode, pieces in self._list_groups():
            for piece in pieces:
                crc = zlib.crc32(piece, crc)
                self._sink.write(piece)
            if (end := self._sink.position) > at:
                body = struct.pack("<BQQ", opcode, at, end - at)
                offsets.append(write_record(Opcode.SUMMARY_OFFSET, body))
            at = end
        tail = b"".join(offsets) + RECORD_HEAD.pack(Opcode.FOOTER, FOOTER.size)
        tail += struct.pack("<QQ", start, at)
        self._sink.write(tail + LENGTH.pack(zlib.crc32(tail, crc)) + MAGIC)

    def _count(self, chunk: Chunk, counts: dict[int, int]) -> None:
        for channel, count in counts.items():
            self.counts[channel] = self.counts.get(channel, 0) + count
        first, last = self._times or (chunk.start_ns, chunk.end_ns)
        self._times = min(first, chunk.start_ns), max(last, chunk.end_ns)
        self._chunks += 1

    def _list_groups(self) -> Iterable[tuple[Opcode, Iterable[bytes]]]:
        schemas = [one for one in self._written if isinstance(one, Schema)]
        channels = [one for one in self._written if isinstance(one, Channel)]
        counts = write_numbers("HQ", self.counts.items())
        numbers = STATISTICS.pack(
            self.messages,
            len(schemas),
            len(channels),
            len(self._attachment_indexes),
            len(self._metadata_indexes),
            self._chunks,
            *self.span_ns,
        )
        statistics = write_record(Opcode.STATISTICS, numbers + counts)
        yield Opcode.SCHEMA, map(write_schema, schemas)
        yield Opcode.CHANNEL, map(write_channel, channels)
        yield Opcode.STATISTICS, (statistics,)
        yield Opcode.CHUNK_INDEX, self._chunk_indexes.read()
        yield Opcode.ATTACHMENT_INDEX, self._attachment_indexes
        yield Opcode.METADATA_INDEX, self._metadata_indexes


def _write_definitions(definitions: Iterable[Schema | Channel]) -> bytes:
    return b"".join(
        write_schema(one) if isinstance(one, Schema) else write_channel(one) for one in definitions
    )


def _write_message_index(channel: int, positions: list[int]) -> bytes:
    raw = struct.pack(f"<{len(positions)}Q", *positions)
    return write_record(
        Opcode.MESSAGE_INDEX, struct.pack("<H", channel) + LENGTH.pack(len(raw)) + raw
    )
