"""Records of MCAP files: layout, values, and conversion to bytes and back.

Source: https://mcap.dev/spec, version 0.
"""

import struct
import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Final

import msgspec

MAGIC: Final = b"\x89MCAP0\r\n"
"""First and last bytes of a file."""
RECORD_HEAD: Final = struct.Struct("<BQ")
"""Opcode, and number of bytes that follow."""
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""Record head, then channel, sequence, log time [ns], publish time [ns]."""
MESSAGE_FIELDS_BYTES: Final = MESSAGE_HEAD.size - RECORD_HEAD.size
CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""Start and end [ns], bytes and CRC-32 of the records, length of the name of the compression."""
FOOTER: Final = struct.Struct("<QQI")
"""Start of summary and of summary offsets, CRC-32 of the summary."""
FOOTER_BYTES: Final = RECORD_HEAD.size + FOOTER.size + len(MAGIC)
"""Footer record and magic."""
STATISTICS: Final = struct.Struct("<QHIIIIQQ")
"""Messages, schemas, channels, attachments, metadata, chunks, first and last log time [ns]."""
TIMES: Final = struct.Struct("<QQ")
LENGTH: Final = struct.Struct("<I")
LONG_LENGTH: Final = struct.Struct("<Q")


class Opcode(IntEnum):
    """Kind of a record."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


class MalformedRecord(ValueError):
    """The bytes are not a record of this kind."""


class Schema(msgspec.Struct, frozen=True):
    """Type of the messages of channels."""

    number: int
    name: str
    encoding: str
    text: bytes


class Channel(msgspec.Struct, frozen=True):
    """A topic with one type of messages."""

    number: int
    schema: int
    topic: str
    encoding: str
    metadata: dict[str, str]


class Chunk(msgspec.Struct, frozen=True):
    """Compressed records, with first and last log time [ns]."""

    start_ns: int
    end_ns: int
    size: int
    """Bytes before compression."""
    crc: int
    compression: str
    content: bytes


class ChunkIndex:
    """Messages of a chunk."""

    def __init__(self) -> None:
        self.positions: defaultdict[int, list[int]] = defaultdict(list)
        """Log time [ns] and offset in the uncompressed chunk of each message, by channel."""

    @property
    def counts(self) -> dict[int, int]:
        """Number of messages by channel."""
        return {channel: len(found) // 2 for channel, found in self.positions.items()}

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time [ns] of the messages, of which there is at least one."""
        times = [one[::2] for one in self.positions.values()]
        return min(map(min, times)), max(map(max, times))


class AttachedFile(msgspec.Struct, frozen=True):
    """A file in a recording."""

    name: str
    media_type: str
    content: bytes
    log_time_ns: int = 0
    create_time_ns: int = 0


class Metadata(msgspec.Struct, frozen=True):
    """Named texts."""

    name: str
    texts: dict[str, str]


def write_record(opcode: Opcode, body: bytes) -> bytes:
    """Write a record."""
    return RECORD_HEAD.pack(opcode, len(body)) + body


def write_text(text: str) -> bytes:
    """Write a string."""
    raw = text.encode()
    return LENGTH.pack(len(raw)) + raw


def write_texts(texts: Mapping[str, str]) -> bytes:
    """Write a map of strings."""
    raw = b"".join(write_text(key) + write_text(value) for key, value in texts.items())
    return LENGTH.pack(len(raw)) + raw


def write_numbers(code: str, pairs: Iterable[tuple[int, int]]) -> bytes:
    """Write a map or an array of pairs of numbers, whose formats in `struct` are the code."""
    pack = struct.Struct(f"<{code}").pack
    raw = b"".join(pack(*pair) for pair in pairs)
    return LENGTH.pack(len(raw)) + raw


def write_header(profile: str, library: str) -> bytes:
    """Write the first record."""
    return write_record(Opcode.HEADER, write_text(profile) + write_text(library))


def write_schema(schema: Schema) -> bytes:
    """Write a schema."""
    body = struct.pack("<H", schema.number) + write_text(schema.name) + write_text(schema.encoding)
    return write_record(Opcode.SCHEMA, body + LENGTH.pack(len(schema.text)) + schema.text)


def write_channel(channel: Channel) -> bytes:
    """Write a channel."""
    body = struct.pack("<HH", channel.number, channel.schema)
    body += write_text(channel.topic) + write_text(channel.encoding)
    return write_record(Opcode.CHANNEL, body + write_texts(channel.metadata))


def write_chunk(chunk: Chunk) -> bytes:
    """Write a chunk."""
    name = chunk.compression.encode()
    head = CHUNK_HEAD.pack(chunk.start_ns, chunk.end_ns, chunk.size, chunk.crc, len(name))
    body = b"".join((head, name, LONG_LENGTH.pack(len(chunk.content)), chunk.content))
    return write_record(Opcode.CHUNK, body)


def write_attachment(attachment: AttachedFile) -> bytes:
    """Write an attachment."""
    body = b"".join(
        (
            TIMES.pack(attachment.log_time_ns, attachment.create_time_ns),
            write_text(attachment.name),
            write_text(attachment.media_type),
            LONG_LENGTH.pack(len(attachment.content)),
            attachment.content,
        )
    )
    return write_record(Opcode.ATTACHMENT, body + LENGTH.pack(zlib.crc32(body)))


def write_metadata(metadata: Metadata) -> bytes:
    """Write named texts."""
    return write_record(Opcode.METADATA, write_text(metadata.name) + write_texts(metadata.texts))


class FieldReader:
    """Reads the fields of a record one after the other.

    Raises:
        MalformedRecord: A field does not end within the record.
    """

    def __init__(self, body: bytes) -> None:
        self._body = body
        self._at = 0

    def numbers(self, layout: struct.Struct) -> tuple[int, ...]:
        """Read numbers."""
        return layout.unpack(self.take(layout.size))

    def text(self) -> str:
        """Read a string."""
        try:
            return self.take(*self.numbers(LENGTH)).decode()
        except UnicodeDecodeError as error:
            raise MalformedRecord("a text is not UTF-8") from error

    def texts(self) -> dict[str, str]:
        """Read a map of strings."""
        inner = FieldReader(self.take(*self.numbers(LENGTH)))
        found = {}
        while not inner.is_at_end:
            key = inner.text()
            found[key] = inner.text()
        return found

    def take(self, count: int) -> bytes:
        """Read bytes."""
        end = self._at + count
        if end > len(self._body):
            raise MalformedRecord(f"{count} bytes are expected at byte {self._at} of a record")
        found, self._at = self._body[self._at : end], end
        return found

    @property
    def is_at_end(self) -> bool:
        """Whether all was read."""
        return self._at >= len(self._body)


def read_schema(body: bytes) -> Schema:
    """Read a schema.

    Raises:
        MalformedRecord: A field does not end within the record.
    """
    fields = FieldReader(body)
    (number,) = fields.numbers(struct.Struct("<H"))
    return Schema(number, fields.text(), fields.text(), fields.take(*fields.numbers(LENGTH)))


def read_channel(body: bytes) -> Channel:
    """Read a channel.

    Raises:
        MalformedRecord: A field does not end within the record.
    """
    fields = FieldReader(body)
    number, schema = fields.numbers(struct.Struct("<HH"))
    return Channel(number, schema, fields.text(), fields.text(), fields.texts())


def read_chunk(body: bytes) -> Chunk:
    """Read a chunk, without a check of its content.

    Raises:
        MalformedRecord: A field does not end within the record, or bytes follow the content.
    """
    fields = FieldReader(body)
    start_ns, end_ns, size, crc, name_length = fields.numbers(CHUNK_HEAD)
    name = fields.take(name_length)
    content = fields.take(*fields.numbers(LONG_LENGTH))
    if not (fields.is_at_end and name.isascii()):
        raise MalformedRecord("a chunk does not end with its content")
    return Chunk(start_ns, end_ns, size, crc, name.decode(), content)


def read_attachment(body: bytes) -> AttachedFile:
    """Read an attachment, and check its content.

    Raises:
        MalformedRecord: A field does not end within the record, or the checksum is wrong.
    """
    fields = FieldReader(body)
    log_ns, create_ns = fields.numbers(TIMES)
    name, media_type = fields.text(), fields.text()
    content = fields.take(*fields.numbers(LONG_LENGTH))
    (crc,) = fields.numbers(LENGTH)
    if crc and crc != zlib.crc32(body[: -LENGTH.size]):
        raise MalformedRecord(f"attachment {name[:40]!r} is damaged")
    return AttachedFile(name, media_type, content, log_ns, create_ns)


def read_metadata(body: bytes) -> Metadata:
    """Read named texts.

    Raises:
        MalformedRecord: A field does not end within the record.
    """
    fields = FieldReader(body)
    return Metadata(fields.text(), fields.texts())
