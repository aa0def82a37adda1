"""A file of a stranger or with one damaged bit costs its damaged part, not the reader."""

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer

from tests.recording.recordings import define_topics, write_recording
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Odometry
from zensim.recording import chunk_compression, recording_reader
from zensim.recording.chunk_compression import (
    FREE_BYTES,
    MAX_CHUNK_BYTES,
    DamagedChunk,
    compress,
    decompress,
)
from zensim.recording.file_index import MAX_METADATA_BYTES, read_index
from zensim.recording.mcap_records import FOOTER_BYTES, MAGIC, RECORD_HEAD, Metadata, Opcode
from zensim.recording.mcap_scan import ScanReport, TooCompressed, scan_file
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.message_tables import LOG_TIME, PUBLISH_TIME, read_tables
from zensim.recording.output_file import OutputFile
from zensim.recording.recording_reader import LAST_NS, RecordingReader
from zensim.recording.recovery import recover_file

MESSAGES = 1000
IN_A_CHUNK = 100
CHUNK_NAME = b"\x04\x00\x00\x00zstd"
SIZE_BEFORE_NAME = 12
"""From the size of the records to the name of the compression [bytes]."""


@pytest.fixture(params=[True, False], ids=["closed", "unclosed"])
def recording(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES, is_closed=request.param)
    return path


def overwrite(path: Path, at: int, replacement: bytes) -> None:
    """Replace bytes of a file."""
    content = bytearray(path.read_bytes())
    content[at : at + len(replacement)] = replacement
    path.write_bytes(content)


@pytest.mark.parametrize("size", [MAX_CHUNK_BYTES + 1, (1 << 63) - 1, (1 << 64) - 1])
def test_chunk_that_claims_too_many_bytes_is_left_out(recording: Path, size: int) -> None:
    at = recording.read_bytes().index(CHUNK_NAME) - SIZE_BEFORE_NAME
    overwrite(recording, at, struct.pack("<Q", size))

    reader = RecordingReader(recording)
    found = list(reader.messages())
    recovered = recover_file(recording, recording.with_name("whole.mcap"))

    assert (len(found), reader.damaged) == (MESSAGES - IN_A_CHUNK, 1)
    assert recovered.messages == MESSAGES - IN_A_CHUNK


def test_chunk_is_not_decompressed_beyond_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunk_compression, "MAX_CHUNK_BYTES", 1000)

    assert decompress(compress(bytes(1000)), "zstd", 1000) == bytes(1000)
    with pytest.raises(DamagedChunk):
        decompress(compress(bytes(1001)), "zstd", 1001)


def write_bombs(path: Path, count: int, mebibytes: int) -> None:
    """Write a file without index whose chunks have zeros only."""
    records = bytes(mebibytes << 20)
    content = compress(records)
    fields = struct.pack("<QQQI", 0, 1, len(records), 0) + CHUNK_NAME
    body = fields + struct.pack("<Q", len(content)) + content
    header = RECORD_HEAD.pack(Opcode.HEADER, 8) + bytes(8)
    path.write_bytes(MAGIC + header + (RECORD_HEAD.pack(Opcode.CHUNK, len(body)) + body) * count)


def test_chunk_of_far_more_bytes_than_the_file_is_not_decompressed(tmp_path: Path) -> None:
    write_bombs(tmp_path / "run.mcap", 1, (FREE_BYTES >> 20) + 8)

    assert read_index(tmp_path / "run.mcap").damaged == 1


def test_chunks_of_far_more_bytes_than_a_file_without_index_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_bombs(path, 40, 16)

    with pytest.raises(TooCompressed):
        read_index(path)
    with pytest.raises(TooCompressed):
        recover_file(path, tmp_path / "whole.mcap")
    assert not (tmp_path / "whole.mcap").exists()


def test_file_whose_chunks_have_far_more_bytes_is_recovered_on_demand(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_bombs(path, 40, 4)

    found = recover_file(path, tmp_path / "whole.mcap", is_any_size=True)

    assert (found.chunks, found.damaged) == (40, 0)


FAR_OFFSETS = [1 << 30, 1 << 50, (1 << 63) + 9, (1 << 64) - 1]


@pytest.mark.parametrize("offset", FAR_OFFSETS)
def test_index_that_names_a_chunk_beyond_the_file_costs_that_chunk(
    tmp_path: Path, offset: int
) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)
    place = read_index(path).chunks[-1]
    at = path.read_bytes().rindex(struct.pack("<QQ", place.at, place.length))
    overwrite(path, at, struct.pack("<Q", offset))

    reader = RecordingReader(path)

    assert len(list(reader.messages())) == MESSAGES - IN_A_CHUNK
    assert reader.damaged == 1


@pytest.mark.parametrize("offset", FAR_OFFSETS)
def test_file_whose_index_names_metadata_beyond_it_is_read_in_whole(
    tmp_path: Path, offset: int
) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, 1, metadata=[Metadata("zensim", {"world": "main"})])
    content = path.read_bytes()
    # Opcode and length of the record, offset, length, length of the name.
    at = content.rindex(b"\x06\x00\x00\x00zensim") - 16
    overwrite(path, at, struct.pack("<Q", offset))

    assert RecordingReader(path).metadata == {"zensim": {"world": "main"}}


def repeat_summary_record(path: Path, opcode: int, times: int) -> None:
    """Write the first record of this kind in a summary some times more."""
    content = path.read_bytes()
    footer = len(content) - FOOTER_BYTES
    (start,) = struct.unpack_from("<Q", content, footer + RECORD_HEAD.size)
    at = start
    while content[at] != opcode:
        at += RECORD_HEAD.size + RECORD_HEAD.unpack_from(content, at)[1]
    end = at + RECORD_HEAD.size + RECORD_HEAD.unpack_from(content, at)[1]
    path.write_bytes(content[:start] + content[at:end] * times + content[start:])


@pytest.mark.parametrize(
    "opcode", [Opcode.CHUNK_INDEX, Opcode.METADATA_INDEX, Opcode.ATTACHMENT_INDEX]
)
def test_file_whose_index_names_a_place_twice_is_read_in_whole(
    tmp_path: Path, opcode: Opcode
) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES, metadata=[Metadata("zensim", {"world": "main"})])
    repeat_summary_record(path, opcode, 50)

    index = read_index(path)

    assert (len(index.chunks), len(index.metadata), len(index.attachments)) == (10, 1, 1)
    assert len(list(RecordingReader(path).messages())) == MESSAGES


def test_chunk_of_another_length_than_its_index_says_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)
    place = read_index(path).chunks[0]
    at = path.read_bytes().rindex(struct.pack("<QQ", place.at, place.length))
    overwrite(path, at + 8, struct.pack("<Q", place.length - 1))

    reader = RecordingReader(path)

    assert len(list(reader.messages())) == MESSAGES - IN_A_CHUNK
    assert reader.damaged == 1


@pytest.mark.parametrize("is_closed", [True, False])
def test_metadata_beyond_the_limit_are_left_out(tmp_path: Path, *, is_closed: bool) -> None:
    path = tmp_path / "run.mcap"
    long = Metadata("long", {"text": "x" * (MAX_METADATA_BYTES - 1000)})
    write_recording(
        path, 1, is_closed=is_closed, metadata=[long, Metadata("b", long.texts), Metadata("c", {})]
    )

    reader = RecordingReader(path)

    assert (set(reader.metadata), reader.damaged) == ({"long", "c"}, 1)


def test_chunks_whose_times_overlap_are_kept_up_to_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES)
    monkeypatch.setattr(recording_reader, "MAX_WAITING_BYTES", 120_000)
    assert len(list(RecordingReader(path).messages())) == MESSAGES
    content = path.read_bytes()
    for place in read_index(path).chunks:
        at = content.rindex(struct.pack("<QQQ", place.start_ns, place.end_ns, place.at))
        overwrite(path, at, struct.pack("<Q", 0))

    with pytest.raises(ValueError, match="overlap"):
        list(RecordingReader(path).messages())


@pytest.mark.parametrize(
    "options",
    [
        {"use_statistics": False},
        {"use_statistics": False, "index_types": IndexType.NONE},
        {"repeat_channels": False},
        {"repeat_schemas": False},
    ],
)
def test_what_a_summary_lacks_is_found_in_the_file(tmp_path: Path, options: dict[str, Any]) -> None:
    path = tmp_path / "run.mcap"
    write_words(path, **options)

    reader = RecordingReader(path)

    assert (reader.start_ns, reader.end_ns) == (5, 104)
    assert list(reader.counts.values()) == [100]
    assert len(list(reader.messages())) == 100
    assert reader.unclosed == ()
    assert [one.ros_type for one in reader.topics] == ["std_msgs/msg/String"]


def test_chunk_with_a_damaged_name_of_its_compression_is_left_out(recording: Path) -> None:
    overwrite(recording, recording.read_bytes().index(CHUNK_NAME) + 4, b"zsud")

    reader = RecordingReader(recording)

    assert len(list(reader.messages())) == MESSAGES - IN_A_CHUNK
    assert reader.damaged == 1


def test_compression_that_is_not_supported_is_refused() -> None:
    with pytest.raises(ValueError, match="lz4") as caught:
        decompress(b"", "lz4", 0)

    assert not isinstance(caught.value, DamagedChunk)


@pytest.mark.parametrize("is_closed", [True, False])
def test_message_that_is_cut_by_the_end_of_its_chunk_is_left_out(
    tmp_path: Path, *, is_closed: bool
) -> None:
    path = tmp_path / "run.mcap"
    write_words(path, compression=CompressionType.NONE, enable_crcs=False)
    content = path.read_bytes()
    last = content.rindex(struct.pack("<BQ", Opcode.MESSAGE, 24))
    overwrite(path, last + 1, struct.pack("<Q", 25))
    if not is_closed:
        path.write_bytes(path.read_bytes()[:-FOOTER_BYTES])

    found = [payload for *_, payload in RecordingReader(path).messages()]

    assert found == [b"%d" % number for number in range(99)]


def test_damaged_definition_in_a_chunk_without_checksum_costs_no_other(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_words(path, compression=CompressionType.NONE, enable_crcs=False, chunk_size=1000)
    content = path.read_bytes()
    # A length within the definition of the type, which every chunk but the first lacks.
    at = content.index(b"std_msgs/msg/String") - 4
    path.write_bytes(content[:at] + b"\xff\xff" + content[at + 2 : -FOOTER_BYTES])

    reader = RecordingReader(path)

    assert [payload for *_, payload in reader.messages()] == [b"%d" % one for one in range(100)]
    assert reader.damaged == 1


def write_words(path: Path, **options: Any) -> None:  # noqa: ANN401
    """Write a hundred messages with another writer."""
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/words", "cdr", schema)
        for number in range(100):
            writer.add_message(channel, 5 + number, b"%d" % number, 5 + number)
        writer.finish()  # type: ignore[no-untyped-call]


def test_times_beyond_63_bits_are_in_a_table(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    output = OutputFile(path)
    writer = McapWriter(output)
    (odom,) = define_topics(writer)
    writer.write_message(odom, 5, 6, encode(Odometry(), Format.CDR))
    writer.write_message(odom, LAST_NS, LAST_NS, encode(Odometry(), Format.CDR))
    writer.flush()
    writer.close()
    output.close()

    (table,) = read_tables(RecordingReader(path))

    times = [np.asarray(table.columns[path]).tolist() for path in (LOG_TIME, PUBLISH_TIME)]
    assert times == [[5, LAST_NS], [6, LAST_NS]]


def count_read_bytes(monkeypatch: pytest.MonkeyPatch, path: Path) -> int:
    """Count the bytes that a scan reads of a file."""
    counted = []

    class CountedFile(io.FileIO):
        def read(self, size: int | None = -1) -> bytes:
            found = super().read(-1 if size is None else size)
            counted.append(len(found))
            return found

    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", lambda file, _mode: CountedFile(str(file)))
        list(scan_file(path, ScanReport()))
    return sum(counted)


def make_nested_heads(size: int) -> bytes:
    """Make starts of chunks of which each claims all that follows it."""
    step = 53
    heads = []
    for at in range(0, size, step):
        content = size - at - step
        head = RECORD_HEAD.pack(Opcode.CHUNK, step - 9 + content)
        head += struct.pack("<QQQII", 0, 0, content, 1, 4) + b"zstd" + struct.pack("<Q", content)
        heads.append(head)
    return b"".join(heads)


def test_search_in_a_damaged_file_reads_it_a_few_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, IN_A_CHUNK, is_closed=False)
    whole = path.read_bytes()
    size = 4000 * 53
    path.write_bytes(whole + make_nested_heads(size))

    read = count_read_bytes(monkeypatch, path)

    assert read < 40 * path.stat().st_size


def test_search_finds_chunks_behind_starts_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_recording(path, 2 * IN_A_CHUNK, is_closed=False)
    content = path.read_bytes()
    noise = (b"\x06" + bytes(36) + CHUNK_NAME + bytes(8)) * 1000
    path.write_bytes(content[:-100] + noise + content[200:])
    target = tmp_path / "whole.mcap"

    assert recover_file(path, target).messages >= 3 * IN_A_CHUNK
