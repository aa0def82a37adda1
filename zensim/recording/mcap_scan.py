"""Reads the records of an MCAP file in turn, also of one that was never closed or is damaged."""

import math
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

import msgspec

from zensim.proto.bounded_files import open_regular_file
from zensim.recording.chunk_compression import MAX_RATIO, DamagedChunk, decompress, find_most_bytes
from zensim.recording.mcap_records import (
    MAGIC,
    MESSAGE_FIELDS_BYTES,
    MESSAGE_HEAD,
    RECORD_HEAD,
    AttachedFile,
    Channel,
    Chunk,
    ChunkIndex,
    MalformedRecord,
    Metadata,
    Opcode,
    Schema,
    read_attachment,
    read_channel,
    read_chunk,
    read_metadata,
    read_schema,
)

WINDOW_BYTES: Final = 1 << 20
CHUNK_PATTERN: Final = re.compile(
    rb"\x06.{36}(?:\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4|\x00\x00\x00\x00).{8}", re.DOTALL
)
"""Start of a chunk: opcode, length, times, size, checksum, compression, length of the content."""
CHUNK_OPCODE: Final = re.compile(rb"\x06")
CHUNK_START_BYTES: Final = 53
WASTE_SHARE: Final = 4
"""Most bytes read in search of chunks inside damaged records, over the size of the file."""
MAX_RECORD_BYTES: Final = 1 << 30
MAX_OTHERS: Final = 1 << 17
"""Records of a chunk that are no messages: a definition for each number of a schema and a channel.
What follows more of them is not read: a megabyte of zeros has a hundred thousand."""
LIMITS_OF_OPCODE: Final = {Opcode.HEADER: 1 << 16, Opcode.SCHEMA: 1 << 20, Opcode.CHANNEL: 1 << 20}
"""Longer ones are damaged."""
ENDS: Final = (Opcode.DATA_END, Opcode.FOOTER)
OPCODES: Final = frozenset(Opcode)

ScannedMessage = tuple[int, int, int, bytes]
"""Channel, log time [ns], publish time [ns], payload."""


class TooCompressed(ValueError):
    """The chunks of a file without index have far more bytes than the file."""

    slug = "recording.size"

    def __init__(self, path: Path, most: int) -> None:
        super().__init__(
            f"the chunks of {path} have more than {most >> 20} MiB, {MAX_RATIO} times its size; if "
            "you know where it is from, 'zensim bag recover --any-size' writes its index"
        )


class OpenChunk(msgspec.Struct, frozen=True):
    """A chunk whose content has the right checksum."""

    chunk: Chunk
    records: bytes


class ChunkContents(msgspec.Struct, frozen=True):
    """What the records of a chunk are."""

    definitions: tuple[Schema | Channel, ...]
    damaged: int
    """Definitions that are not whole."""
    index: ChunkIndex


class LooseMessage(msgspec.Struct, frozen=True):
    """A message that is in no chunk."""

    message: ScannedMessage


Scanned: TypeAlias = OpenChunk | Schema | Channel | AttachedFile | Metadata | LooseMessage


class ScanReport(msgspec.Struct):
    """What was found besides records."""

    is_closed: bool = False
    """Whether the end of the data was found."""
    damaged: int = 0
    """Number of places where bytes were skipped."""
    skipped_bytes: int = 0
    cut_bytes: int = 0
    """Bytes after the last whole record."""


class ScannedPlace(msgspec.Struct, frozen=True):
    """A record and the bytes of the file that it takes."""

    at: int
    """Offset of its first byte."""
    end: int
    found: Scanned


def scan_file(path: Path, report: ScanReport, *, is_any_size: bool = False) -> Iterator[Scanned]:
    """Read the records as `scan_places` does, without their places."""
    return (one.found for one in scan_places(path, report, is_any_size=is_any_size))


def scan_places(
    path: Path, report: ScanReport, *, is_any_size: bool = False
) -> Iterator[ScannedPlace]:
    """Read the records up to the end of the data; skip what is damaged.

    Args:
        path: File.
        report: Is completed.
        is_any_size: Whether chunks may have any number of bytes in all.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is not an MCAP file, or its compression is not supported.
        TooCompressed: Its chunks have more bytes in all than `find_most_bytes` allows.
    """
    with open_regular_file(path) as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise ValueError(f"{path} is not an MCAP file")
        yield from _Scan(stream, path, report, is_any_size=is_any_size).run()


class _Scan:
    """Position in a file."""

    def __init__(
        self, stream: BinaryIO, path: Path, report: ScanReport, *, is_any_size: bool
    ) -> None:
        self._stream = stream
        self._path = path
        self._size = path.stat().st_size
        self._left = math.inf if is_any_size else find_most_bytes(self._size)
        """Bytes that chunks may still have."""
        self._report = report
        self._window_at, self._window = 0, b""
        self._wasted = 0
        """Bytes of records that were read, and are damaged."""

    def run(self) -> Iterator[ScannedPlace]:
        at = len(MAGIC)
        while at < self._size:
            opcode, length = self._read_head(at)
            end = at + RECORD_HEAD.size + length
            if opcode in ENDS and self._is_start(at):
                self._report.is_closed = True
                return
            if opcode is None or end > self._size:
                found, is_good = None, False
            else:
                found, is_good = self._read_record(opcode, at + RECORD_HEAD.size, length)
            follows = end <= self._size and self._is_start(end)
            if is_good and (follows or isinstance(found, OpenChunk)):
                if found is not None:
                    yield ScannedPlace(at, end, found)
                at = end if follows else self._find_chunk(end)
            elif opcode is not None and (follows or self._is_hopeless(end)):
                self._skip(end - at)
                at = end
            else:
                at = self._find_chunk(at)

    def _read_head(self, at: int) -> tuple[Opcode | None, int]:
        """Read opcode and length; no opcode where there is no record."""
        self._stream.seek(at)
        head = self._stream.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size or head[0] not in OPCODES:
            return None, 0
        code, length = RECORD_HEAD.unpack(head)
        opcode = Opcode(code)
        is_possible = length <= LIMITS_OF_OPCODE.get(opcode, MAX_RECORD_BYTES)
        return (opcode, length) if is_possible else (None, 0)

    def _is_start(self, at: int) -> bool:
        """Whether a record may begin here, or the file ends."""
        if at == self._size:
            return True
        opcode, length = self._read_head(at)
        end = at + RECORD_HEAD.size + length
        if opcode is None:
            return self._size - at < RECORD_HEAD.size
        if opcode is Opcode.CHUNK:
            return self._has_lengths(at, length)
        if opcode in ENDS:
            return length in (4, 20)
        # The last record of a file that was never closed may be cut.
        return end <= self._size or length <= WINDOW_BYTES

    def _has_lengths(self, at: int, length: int) -> bool:
        """Whether the lengths in the start of a chunk agree."""
        self._stream.seek(at)
        start = self._stream.read(CHUNK_START_BYTES)
        found = CHUNK_PATTERN.match(start)
        if found is None:
            return len(start) < CHUNK_START_BYTES
        (content,) = struct.unpack("<Q", start[found.end() - 8 : found.end()])
        return bool(length == found.end() - RECORD_HEAD.size + content)

    def _is_hopeless(self, end: int) -> bool:
        """Whether so much was read in vain that a damaged record is skipped, not searched.

        Else a file whose records claim to have each other inside would be read again and again.
        """
        return self._wasted > WASTE_SHARE * self._size and end <= self._size

    def _read_record(self, opcode: Opcode, at: int, length: int) -> tuple[Scanned | None, bool]:
        """Read a record; return whether it is undamaged, as far as its checksum can show."""
        if opcode is Opcode.CHUNK and not self._has_lengths(at - RECORD_HEAD.size, length):
            return None, False
        if opcode is Opcode.MESSAGE_INDEX:
            return None, True
        self._stream.seek(at)
        body = self._stream.read(length)
        try:
            return self._parse_record(opcode, body), True
        except (MalformedRecord, DamagedChunk):
            self._wasted += length
            return None, False

    def _parse_record(self, opcode: Opcode, body: bytes) -> Scanned | None:
        if opcode is Opcode.CHUNK:
            return self._open_chunk(read_chunk(body))
        parse = PARSERS.get(opcode)
        return parse(body) if parse is not None else None

    def _open_chunk(self, chunk: Chunk) -> OpenChunk:
        """Read the records of a chunk, as long as those of all are not too many."""
        opened = open_chunk(chunk)
        self._left -= len(opened.records)
        if self._left < 0:
            raise TooCompressed(self._path, find_most_bytes(self._size))
        return opened

    def _find_chunk(self, at: int) -> int:
        """Find the next chunk whose lengths agree; the end of the file if there is none."""
        start = at + 1
        while start < self._size:
            self._read_window(start)
            first = start - self._window_at
            for found in CHUNK_OPCODE.finditer(self._window, first, WINDOW_BYTES):
                place = self._window_at + found.start()
                match = CHUNK_PATTERN.match(self._window, found.start())
                if match is not None and self._is_start(place):
                    self._skip(place - at)
                    return place
            start = self._window_at + WINDOW_BYTES
        self._report.cut_bytes += self._size - at
        return self._size

    def _read_window(self, at: int) -> None:
        """Read the part of the file that is searched from here, unless it was read before."""
        if not (self._window and self._window_at <= at < self._window_at + WINDOW_BYTES):
            self._stream.seek(at)
            self._window_at = at
            self._window = self._stream.read(WINDOW_BYTES + CHUNK_START_BYTES)

    def _skip(self, count: int) -> None:
        self._report.damaged += 1
        self._report.skipped_bytes += count


def open_chunk(chunk: Chunk) -> OpenChunk:
    """Read the records of a chunk, and check them.

    Raises:
        DamagedChunk: They are not what was written, or too many.
        ValueError: The compression is not supported.
    """
    records = decompress(chunk.content, chunk.compression, chunk.size)
    if chunk.crc and chunk.crc != zlib.crc32(records):
        raise DamagedChunk("the checksum of a chunk is wrong")
    return OpenChunk(chunk, records)


def _read_message(body: bytes) -> ScannedMessage:
    if len(body) < MESSAGE_FIELDS_BYTES:
        raise MalformedRecord("a message is cut")
    channel, _, log_ns, publish_ns = struct.unpack_from("<HIQQ", body)
    return channel, log_ns, publish_ns, body[MESSAGE_FIELDS_BYTES:]


DEFINITIONS: Final[dict[int, Callable[[bytes], Schema | Channel]]] = {
    int(Opcode.SCHEMA): read_schema,
    int(Opcode.CHANNEL): read_channel,
}
PARSERS: Final[dict[Opcode, Callable[[bytes], Scanned]]] = {
    Opcode.SCHEMA: read_schema,
    Opcode.CHANNEL: read_channel,
    Opcode.ATTACHMENT: read_attachment,
    Opcode.METADATA: read_metadata,
    Opcode.MESSAGE: lambda body: LooseMessage(_read_message(body)),
}


def read_contents(records: bytes) -> ChunkContents:
    """Read the definitions in a chunk, and where its messages are, in one walk."""
    places: list[tuple[int, int, int]] = []
    index = ChunkIndex()
    positions = index.positions
    others = 0
    unpack, head, message = MESSAGE_HEAD.unpack_from, RECORD_HEAD.size, int(Opcode.MESSAGE)
    # Other records may be shorter than the head of a message.
    padded, at, size = records + bytes(MESSAGE_HEAD.size), 0, len(records)
    while at + head <= size:
        opcode, length, channel, _, log_ns, _ = unpack(padded, at)
        end = at + head + length
        if end > size or others > MAX_OTHERS:
            break
        if opcode == message and length >= MESSAGE_FIELDS_BYTES:
            positions[channel] += (log_ns, at)
        else:
            others += 1
            if opcode in DEFINITIONS:
                places.append((opcode, at + head, end))
        at = end
    definitions = [_read_definition(opcode, records[start:end]) for opcode, start, end in places]
    whole = tuple(one for one in definitions if one is not None)
    return ChunkContents(whole, len(definitions) - len(whole), index)


def _read_definition(opcode: int, body: bytes) -> Schema | Channel | None:
    try:
        return DEFINITIONS[opcode](body)
    except MalformedRecord:
        return None


def read_messages(records: bytes) -> Iterator[tuple[int, ScannedMessage]]:
    """Read the messages in a chunk, each with its offset there."""
    for opcode, start, end in _walk(records):
        if opcode == Opcode.MESSAGE and end - start >= MESSAGE_FIELDS_BYTES:
            yield start - RECORD_HEAD.size, _read_message(records[start:end])


def _walk(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Walk over records: opcode, start and end of each body."""
    unpack, head, at, others = RECORD_HEAD.unpack_from, RECORD_HEAD.size, 0, 0
    while at + head <= len(records) and others <= MAX_OTHERS:
        opcode, length = unpack(records, at)
        others += opcode != Opcode.MESSAGE
        start = at + head
        at = start + length
        if at > len(records):
            return
        yield opcode, start, at
