"""Index of an MCAP file: definitions, chunks, files; from its summary, or by reading all of it."""

import os
import struct
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from zensim.proto.bounded_files import open_regular_file
from zensim.recording.mcap_records import (
    FOOTER,
    FOOTER_BYTES,
    LENGTH,
    LONG_LENGTH,
    MAGIC,
    RECORD_HEAD,
    STATISTICS,
    TIMES,
    AttachedFile,
    Channel,
    FieldReader,
    MalformedRecord,
    Metadata,
    Opcode,
    Schema,
    read_channel,
    read_metadata,
    read_schema,
)
from zensim.recording.mcap_scan import (
    MAX_RECORD_BYTES,
    LooseMessage,
    OpenChunk,
    ScannedPlace,
    ScanReport,
    read_contents,
    scan_places,
)

PAIR: Final = struct.Struct("<HQ")
PLACE: Final = struct.Struct("<QQ")
"""Offset and length of a record [bytes]."""
CHUNK_INDEX_HEAD: Final = struct.Struct("<QQQQI")
"""First and last log time [ns], offset and length of the chunk, bytes of the map of offsets."""
MAX_LOOSE_BYTES: Final = 1 << 20
"""Messages outside of chunks are read in groups of this size."""
MAX_METADATA_BYTES: Final = 16 << 20
"""Most bytes of all metadata of a file."""


class ChunkPlace(msgspec.Struct, frozen=True, gc=False):
    """Where messages are in a file, and which."""

    at: int
    """Offset of the first record."""
    length: int
    start_ns: int
    """First and last log time."""
    end_ns: int
    compression: str
    channels: bytes
    """Numbers of the channels, two bytes each, little-endian; empty = unknown."""
    is_loose: bool = False
    """Whether these are messages one after the other, not a chunk."""

    def has_any(self, channels: AbstractSet[int]) -> bool:
        """Whether there may be messages of any of these channels."""
        if not self.channels:
            return True
        numbers = struct.unpack(f"<{len(self.channels) // 2}H", self.channels)
        return not channels.isdisjoint(numbers)


class AttachmentPlace(msgspec.Struct, frozen=True):
    """Where an attached file is."""

    at: int
    length: int
    """Length of its record [bytes]."""
    name: str
    media_type: str
    size: int
    """Bytes of the attached file."""


class FileIndex(msgspec.Struct):
    """What an MCAP file has, and where."""

    path: Path
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    counts: dict[int, int] = {}
    """Messages by channel."""
    times: tuple[int, int] | None = None
    """First and last log time [ns]; None without messages."""
    has_statistics: bool = False
    """Whether the summary has counts and times."""
    chunks: list[ChunkPlace] = []
    attachments: list[AttachmentPlace] = []
    metadata: list[Metadata] = []
    is_closed: bool = True
    """Whether it has a summary; else all of it was read."""
    damaged: int = 0
    """Number of places where bytes were skipped."""


def read_index(file: Path) -> FileIndex:
    """Read the summary of a file, or all of it if it has none.

    Raises:
        OSError: It cannot be read.
        ValueError: It is not an MCAP file, or its compression is not supported.
    """
    with open_regular_file(file) as stream:
        try:
            found = _read_closed(stream, file)
        except (MalformedRecord, struct.error):
            return _scan(file, is_closed=False)
    return found if _is_complete(found) else _scan(file, is_closed=True)


def _is_complete(index: FileIndex) -> bool:
    """Whether a summary has all that is optional: statistics, index, definitions."""
    channels = [index.channels.get(number) for number in index.counts]
    are_defined = all(
        one is not None and (not one.schema or one.schema in index.schemas) for one in channels
    )
    return index.has_statistics and are_defined and bool(index.times) == bool(index.chunks)


def _read_closed(stream: BinaryIO, file: Path) -> FileIndex:
    size = file.stat().st_size
    if size < len(MAGIC) + FOOTER_BYTES:
        raise MalformedRecord("the file is shorter than its footer")
    stream.seek(size - FOOTER_BYTES)
    footer = stream.read(FOOTER_BYTES)
    start, _, _ = FOOTER.unpack_from(footer, RECORD_HEAD.size)
    end = size - FOOTER_BYTES
    if footer[0] != Opcode.FOOTER or not footer.endswith(MAGIC) or not len(MAGIC) < start <= end:
        raise MalformedRecord("the file was never closed")
    index = FileIndex(file)
    places: list[tuple[int, ...]] = []
    for opcode, body in _read_records(stream, start, end):
        if opcode == Opcode.METADATA_INDEX:
            places.append(PLACE.unpack_from(body))
        else:
            _add(index, opcode, body)
    chunks = ((one.at, one.length) for one in index.chunks)
    _require_apart(*places, *chunks, *((one.at, one.length) for one in index.attachments))
    reading = _MetadataLimit(index)
    for at, length in places:
        if reading.has_room(length):
            index.metadata.append(read_metadata(read_record_of(stream, at, length)[1]))
    return index


def _require_apart(*places: tuple[int, ...]) -> None:
    """Refuse an index by which a small file has the same bytes many times."""
    end = 0
    for at, length in sorted(places):
        if at < end or length < RECORD_HEAD.size:
            raise MalformedRecord("records overlap that the summary names")
        end = at + length


class _MetadataLimit:
    """Counts the bytes of metadata, all of which are kept; what is beyond the limit is damage."""

    def __init__(self, index: FileIndex) -> None:
        self._index = index
        self._left = MAX_METADATA_BYTES

    def has_room(self, length: int) -> bool:
        """Whether a record of this length [bytes] may be kept."""
        if length > self._left:
            self._index.damaged += 1
            return False
        self._left -= length
        return True


def _read_records(stream: BinaryIO, at: int, end: int) -> Iterator[tuple[int, bytes]]:
    """Read the records in a part of a file, one at a time: a summary may have 100 MB."""
    while at < end:
        opcode, body = read_record(stream, at)
        at += RECORD_HEAD.size + len(body)
        yield opcode, body


def read_record(stream: BinaryIO, at: int) -> tuple[int, bytes]:
    """Read opcode and body of the record at an offset.

    Raises:
        MalformedRecord: It is not whole, or is not in the file.
    """
    left = os.fstat(stream.fileno()).st_size - RECORD_HEAD.size - at
    if left >= 0:
        if stream.tell() != at:
            stream.seek(at)
        opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
        if length <= min(left, MAX_RECORD_BYTES):
            body = stream.read(length)
            if len(body) == length:
                return opcode, body
    raise MalformedRecord(f"the record at byte {at} is not whole")


def read_record_of(stream: BinaryIO, at: int, length: int) -> tuple[int, bytes]:
    """Read opcode and body of the record at an offset, which has this length with its head.

    Raises:
        MalformedRecord: It is not whole, or has another length.
    """
    opcode, body = read_record(stream, at)
    if RECORD_HEAD.size + len(body) != length:
        raise MalformedRecord(f"the record at byte {at} has another length than {length}")
    return opcode, body


def _add(index: FileIndex, opcode: int, body: bytes) -> None:
    match opcode:
        case Opcode.CHUNK_INDEX:
            index.chunks.append(_read_chunk_index(body))
        case Opcode.SCHEMA:
            schema = read_schema(body)
            index.schemas[schema.number] = schema
        case Opcode.CHANNEL:
            channel = read_channel(body)
            index.channels[channel.number] = channel
        case Opcode.STATISTICS:
            fields = FieldReader(body)
            messages, *_, start, end = fields.numbers(STATISTICS)
            index.times, index.has_statistics = (start, end) if messages else None, True
            counts = fields.take(*fields.numbers(LENGTH))
            index.counts = dict(PAIR.iter_unpack(counts[: len(counts) // PAIR.size * PAIR.size]))
        case Opcode.ATTACHMENT_INDEX:
            index.attachments.append(_read_attachment_index(FieldReader(body)))


def _read_chunk_index(body: bytes) -> ChunkPlace:
    """Read the index of a chunk; a recording of hours has ten thousands."""
    start_ns, end_ns, at, length, size = CHUNK_INDEX_HEAD.unpack_from(body)
    first, last = CHUNK_INDEX_HEAD.size, CHUNK_INDEX_HEAD.size + size
    (count,) = LENGTH.unpack_from(body, last + LONG_LENGTH.size)
    name_at = last + LONG_LENGTH.size + LENGTH.size
    name = body[name_at : name_at + count]
    if size % PAIR.size or len(name) != count or not name.isascii():
        raise MalformedRecord("the index of a chunk is not whole")
    # Of each pair of a channel and an offset, the two bytes of the channel.
    channels = bytearray(size // PAIR.size * 2)
    channels[0::2] = body[first : last : PAIR.size]
    channels[1::2] = body[first + 1 : last : PAIR.size]
    return ChunkPlace(at, length, start_ns, end_ns, name.decode(), bytes(channels))


def _read_attachment_index(fields: FieldReader) -> AttachmentPlace:
    at, length = fields.numbers(PLACE)
    fields.numbers(TIMES)
    (size,) = fields.numbers(LONG_LENGTH)
    return AttachmentPlace(at, length, fields.text(), fields.text(), size)


def _scan(file: Path, *, is_closed: bool) -> FileIndex:
    """Read a file in whole."""
    report = ScanReport()
    scan = _ScannedIndex(file)
    for place in scan_places(file, report):
        scan.add(place)
    scan.end_group()
    scan.index.is_closed = is_closed
    scan.index.damaged += report.damaged
    return scan.index


class _ScannedIndex:
    """Index of the records that were read so far."""

    def __init__(self, file: Path) -> None:
        self.index = FileIndex(file)
        self._metadata = _MetadataLimit(self.index)
        self._group: ChunkPlace | None = None
        self._group_channels: set[int] = set()

    def add(self, place: ScannedPlace) -> None:
        one, index = place.found, self.index
        if isinstance(one, OpenChunk):
            self._add_chunk(place, one)
        elif isinstance(one, LooseMessage):
            self._add_message(place, *one.message[:2])
        elif isinstance(one, Schema):
            index.schemas.setdefault(one.number, one)
        elif isinstance(one, Channel):
            index.channels.setdefault(one.number, one)
        elif isinstance(one, AttachedFile):
            length = place.end - place.at
            index.attachments.append(
                AttachmentPlace(place.at, length, one.name, one.media_type, len(one.content))
            )
        elif self._metadata.has_room(place.end - place.at):
            index.metadata.append(one)

    def end_group(self) -> None:
        """End a group of messages outside of chunks."""
        if self._group is not None:
            channels = _write_channels(self._group_channels)
            self.index.chunks.append(msgspec.structs.replace(self._group, channels=channels))
        self._group, self._group_channels = None, set()

    def _add_chunk(self, place: ScannedPlace, one: OpenChunk) -> None:
        contents, file = read_contents(one.records), self.index
        file.damaged += contents.damaged
        for definition in contents.definitions:
            known = file.schemas if isinstance(definition, Schema) else file.channels
            known[definition.number] = definition  # type: ignore[assignment]
        # The times of the records count: those of the chunk have no checksum.
        index = contents.index
        # Without messages, no time is within the chunk.
        start_ns, end_ns = index.span_ns if index.positions else ((1 << 64) - 1, 0)
        for channel, count in index.counts.items():
            self._count(channel, count, start_ns, end_ns)
        numbers, length = _write_channels(index.positions.keys()), place.end - place.at
        file.chunks.append(
            ChunkPlace(place.at, length, start_ns, end_ns, one.chunk.compression, numbers)
        )

    def _add_message(self, place: ScannedPlace, channel: int, log_ns: int) -> None:
        self._count(channel, 1, log_ns, log_ns)
        group = self._group
        if group is not None and (
            group.at + group.length != place.at or group.length > MAX_LOOSE_BYTES
        ):
            self.end_group()
            group = None
        at = place.at if group is None else group.at
        start_ns = log_ns if group is None else min(group.start_ns, log_ns)
        end_ns = log_ns if group is None else max(group.end_ns, log_ns)
        self._group = ChunkPlace(at, place.end - at, start_ns, end_ns, "", b"", is_loose=True)
        self._group_channels.add(channel)

    def _count(self, channel: int, count: int, start_ns: int, end_ns: int) -> None:
        index = self.index
        index.counts[channel] = index.counts.get(channel, 0) + count
        first, last = index.times or (start_ns, end_ns)
        index.times = min(first, start_ns), max(last, end_ns)


def _write_channels(channels: AbstractSet[int]) -> bytes:
    return struct.pack(f"<{len(channels)}H", *sorted(channels))


def list_files(path: Path) -> list[Path]:
    """List a file, or the files of a recording in a folder, in the order of their numbers.

    Raises:
        FileNotFoundError: There is none.
    """
    if not path.is_dir():
        return [path]
    found = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    if not found:
        raise FileNotFoundError(f"no .mcap file in {path}")
    return found
