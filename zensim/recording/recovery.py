"""Copies what is whole of a recording that was never closed or is damaged to a new file."""

from itertools import chain, islice
from pathlib import Path

import msgspec

from zensim.recording.mcap_records import AttachedFile, Channel, Chunk, ChunkIndex, Metadata, Schema
from zensim.recording.mcap_scan import (
    LooseMessage,
    OpenChunk,
    Scanned,
    ScannedMessage,
    ScanReport,
    read_contents,
    read_messages,
    scan_file,
)
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.output_file import OutputFile, find_reserve


class RecoveryResult(msgspec.Struct, frozen=True, kw_only=True):
    """What was recovered."""

    file: str
    messages: int
    chunks: int
    was_closed: bool
    damaged: int
    """Number of places where bytes were skipped."""
    skipped_bytes: int
    cut_bytes: int
    """Bytes after the last whole record."""
    unknown_messages: int
    """Messages that are left out, since the definition of their channel is lost."""


def recover_file(source: Path, target: Path, *, is_any_size: bool = False) -> RecoveryResult:
    """Copy all whole records as they are, write index and summary, and free the source's reserve.

    Args:
        source: File to read.
        target: New file.
        is_any_size: See `scan_places`.

    Raises:
        OSError: A file cannot be read or written, or the target exists.
        ValueError: See `scan_places`.
    """
    report = ScanReport()
    scanned = scan_file(source, report, is_any_size=is_any_size)
    first = [*islice(scanned, 1)]  # before the target is created
    output = OutputFile(target)
    try:
        recovery = _Recovery(McapWriter(output))
        for one in chain(first, scanned):
            recovery.add(one)
        recovery.finish()
    except BaseException:
        target.unlink()
        raise
    finally:
        output.close()
    find_reserve(source).unlink(missing_ok=True)
    return RecoveryResult(
        file=str(target),
        messages=recovery.writer.messages,
        chunks=recovery.chunks,
        was_closed=report.is_closed,
        damaged=report.damaged,
        skipped_bytes=report.skipped_bytes,
        cut_bytes=report.cut_bytes,
        unknown_messages=recovery.unknown,
    )


class _Recovery:
    """Definitions that were read, and those that are in the new file."""

    def __init__(self, writer: McapWriter) -> None:
        self.writer = writer
        self.chunks = 0
        self.unknown = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._defined: set[int] = set()
        self._defined_schemas: set[int] = set()

    def add(self, one: Scanned) -> None:
        if isinstance(one, OpenChunk):
            self._add_chunk(one)
        elif isinstance(one, LooseMessage):
            self._add_message(one.message)
        elif isinstance(one, AttachedFile):
            self.writer.attach(one)
        elif isinstance(one, Metadata):
            self.writer.add_metadata(one)
        else:
            self._note(one, is_checked=False)

    def finish(self) -> None:
        self.writer.flush()
        self.writer.close()

    def _note(self, one: Schema | Channel, *, is_checked: bool) -> None:
        """Keep a definition; one in a chunk replaces that before it, which has no checksum."""
        if isinstance(one, Schema):
            if is_checked or one.number not in self._schemas:
                self._schemas[one.number] = one
        elif is_checked or one.number not in self._channels:
            self._channels[one.number] = one

    def _add_chunk(self, one: OpenChunk) -> None:
        self.writer.flush()
        contents = read_contents(one.records)
        if contents.damaged:
            return
        for definition in contents.definitions:
            self._note(definition, is_checked=True)
        index = contents.index
        # Not a generator: each channel is defined, also after one that is lost.
        are_known = tuple(map(self._define, index.positions))
        if all(are_known):
            self._copy(one.chunk, index)
            return
        for _, message in read_messages(one.records):
            self._add_message(message)

    def _copy(self, chunk: Chunk, index: ChunkIndex) -> None:
        # The times of the records count: those of the chunk have no checksum.
        start_ns, end_ns = index.span_ns if index.positions else (0, 0)
        whole = msgspec.structs.replace(chunk, start_ns=start_ns, end_ns=end_ns)
        self.writer.write_chunk(whole, index)
        self.chunks += 1

    def _add_message(self, message: ScannedMessage) -> None:
        if self._define(message[0]):
            self.writer.write_message(*message)
        else:
            self.unknown += 1

    def _define(self, number: int) -> bool:
        """Define a channel in the new file; False if its definition is lost."""
        if number in self._defined:
            return True
        channel = self._channels.get(number)
        schema = self._schemas.get(channel.schema) if channel is not None else None
        if channel is None or (schema is None and channel.schema != 0):
            return False
        if schema is not None and schema.number not in self._defined_schemas:
            self.writer.define(schema)
            self._defined_schemas.add(schema.number)
        self.writer.define(channel)
        self._defined.add(number)
        return True
