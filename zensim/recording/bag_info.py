"""Contents of a recording: times, topics, counts, files; also of one that was never closed."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec

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
    Opcode,
    Schema,
    read_channel,
    read_schema,
)
from zensim.recording.mcap_scan import (
    LooseMessage,
    OpenChunk,
    ScanReport,
    index_messages,
    read_definitions,
    scan_file,
)

PAIR = struct.Struct("<HQ")
MAX_SUMMARY_BYTES = 1 << 30


class BagTopic(msgspec.Struct, frozen=True):
    """A topic of a recording."""

    name: str
    ros_type: str
    messages: int


class BagInfo(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of a file, or of all files of a recording."""

    files: tuple[str, ...]
    size: int
    """Bytes."""
    messages: int
    start_ns: int
    """First log time: simulation time, unless it was recorded otherwise."""
    end_ns: int
    chunks: int
    compressions: tuple[str, ...]
    topics: tuple[BagTopic, ...]
    attachments: tuple[str, ...]
    unclosed: tuple[str, ...]
    """Files that were read in whole, since they have no summary."""
    damaged: int = 0
    """Number of places where bytes were skipped."""

    @property
    def duration_s(self) -> float:
        """Time from the first to the last message [s]."""
        return (self.end_ns - self.start_ns) / 1e9


class Summary(msgspec.Struct):
    """What the summary of a file says, or what was counted in a file without one."""

    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    counts: dict[int, int] = {}
    times: tuple[int, int] | None = None
    chunks: int = 0
    compressions: set[str] = set()
    attachments: list[str] = []
    is_closed: bool = True
    damaged: int = 0


def read_info(path: Path) -> BagInfo:
    """Read the contents of a file, or of the files in a folder.

    Raises:
        OSError: A file cannot be read, or there is none.
        ValueError: A file is not an MCAP file.
    """
    files = list_files(path)
    summaries = [read_summary(file) for file in files]
    times = [one.times for one in summaries if one.times is not None]
    return BagInfo(
        files=tuple(map(str, files)),
        size=sum(file.stat().st_size for file in files),
        messages=sum(sum(one.counts.values()) for one in summaries),
        start_ns=min((start for start, _ in times), default=0),
        end_ns=max((end for _, end in times), default=0),
        chunks=sum(one.chunks for one in summaries),
        compressions=tuple(sorted({name for one in summaries for name in one.compressions})),
        topics=_merge_topics(summaries),
        attachments=tuple(sorted({name for one in summaries for name in one.attachments})),
        unclosed=tuple(
            str(file) for file, one in zip(files, summaries, strict=True) if not one.is_closed
        ),
        damaged=sum(one.damaged for one in summaries),
    )


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


def _merge_topics(summaries: list[Summary]) -> tuple[BagTopic, ...]:
    merged: dict[tuple[str, str], int] = {}
    for one in summaries:
        for number, channel in one.channels.items():
            schema = one.schemas.get(channel.schema)
            key = channel.topic, schema.name if schema is not None else ""
            merged[key] = merged.get(key, 0) + one.counts.get(number, 0)
    return tuple(BagTopic(*key, count) for key, count in sorted(merged.items()))


def read_summary(file: Path) -> Summary:
    """Read the summary of a file, or all of it if it has none.

    Raises:
        OSError: It cannot be read.
        ValueError: It is not an MCAP file.
    """
    with file.open("rb") as stream:
        try:
            return _read_closed(stream, file.stat().st_size)
        except MalformedRecord:
            pass
    return _count(file)


def _read_closed(stream: BinaryIO, size: int) -> Summary:
    if size < len(MAGIC) + FOOTER_BYTES:
        raise MalformedRecord("the file is shorter than its footer")
    stream.seek(size - FOOTER_BYTES)
    footer = stream.read(FOOTER_BYTES)
    start, _, _ = FOOTER.unpack_from(footer, RECORD_HEAD.size)
    end = size - FOOTER_BYTES
    is_possible = len(MAGIC) < start <= end and end - start <= MAX_SUMMARY_BYTES
    if footer[0] != Opcode.FOOTER or not footer.endswith(MAGIC) or not is_possible:
        raise MalformedRecord("the file was never closed")
    stream.seek(start)
    summary = Summary()
    for opcode, body in _walk(FieldReader(stream.read(end - start))):
        _add(summary, opcode, FieldReader(body), body)
    return summary


def _walk(fields: FieldReader) -> Iterator[tuple[int, bytes]]:
    while not fields.is_at_end:
        opcode, length = fields.numbers(RECORD_HEAD)
        yield opcode, fields.take(length)


def _add(summary: Summary, opcode: int, fields: FieldReader, body: bytes) -> None:
    match opcode:
        case Opcode.SCHEMA:
            schema = read_schema(body)
            summary.schemas[schema.number] = schema
        case Opcode.CHANNEL:
            channel = read_channel(body)
            summary.channels[channel.number] = channel
        case Opcode.STATISTICS:
            messages, *_, chunks, start, end = fields.numbers(STATISTICS)
            summary.chunks = chunks
            summary.times = (start, end) if messages else None
            counts = fields.take(*fields.numbers(LENGTH))
            summary.counts = dict(PAIR.iter_unpack(counts[: len(counts) // 10 * 10]))
        case Opcode.CHUNK_INDEX:
            fields.take(2 * TIMES.size)
            fields.take(*fields.numbers(LENGTH))
            fields.numbers(LONG_LENGTH)
            summary.compressions.add(fields.text())
        case Opcode.ATTACHMENT_INDEX:
            fields.take(2 * TIMES.size + LONG_LENGTH.size)
            summary.attachments.append(fields.text())


def _count(file: Path) -> Summary:
    """Read a file in whole."""
    report, summary = ScanReport(), Summary()
    for one in scan_file(file, report):
        if isinstance(one, OpenChunk):
            _count_chunk(summary, one)
        elif isinstance(one, Schema):
            summary.schemas.setdefault(one.number, one)
        elif isinstance(one, Channel):
            summary.channels.setdefault(one.number, one)
        elif isinstance(one, AttachedFile):
            summary.attachments.append(one.name)
        elif isinstance(one, LooseMessage):
            _count_message(summary, *one.message[:2])
    summary.is_closed, summary.damaged = False, report.damaged
    return summary


def _count_chunk(summary: Summary, one: OpenChunk) -> None:
    summary.chunks += 1
    summary.compressions.add(one.chunk.compression)
    for definition in read_definitions(one.records):
        known = summary.schemas if isinstance(definition, Schema) else summary.channels
        known[definition.number] = definition  # type: ignore[assignment]
    for channel, log_ns, _ in index_messages(one.records):
        _count_message(summary, channel, log_ns)


def _count_message(summary: Summary, channel: int, log_ns: int) -> None:
    summary.counts[channel] = summary.counts.get(channel, 0) + 1
    start, end = summary.times or (log_ns, log_ns)
    summary.times = min(start, log_ns), max(end, log_ns)
