"""Files of the writer are read by other readers, and failed writes count nothing."""

import errno
import os
from pathlib import Path

import pytest

from tests.recording.recordings import (
    count_by_mcap,
    count_by_rosbags,
    define_topics,
    write_recording,
)
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Odometry
from zensim.recording.chunk_compression import CompressedLog
from zensim.recording.mcap_writer import CHUNK_BYTES, McapWriter
from zensim.recording.output_file import OutputFile, find_reserve


class FullDisk(OutputFile):
    """A disk that takes a number of bytes, and writes less than asked without an error."""

    room = 1 << 40

    def write(self, content: bytes) -> None:
        if self.position + len(content) > self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().write(content)


def test_readers_find_the_same_messages(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    write_recording(path, 150)

    assert count_by_rosbags(path) == count_by_mcap(path)
    assert sum(count_by_mcap(path).values()) == 150


def test_writer_ends_a_chunk_at_its_size(tmp_path: Path) -> None:
    output = OutputFile(tmp_path / "run.mcap")
    writer = McapWriter(output)
    (channel,) = define_topics(writer)
    before = output.position

    for number in range(3):
        writer.write_message(channel, number, number, bytes(CHUNK_BYTES // 2))

    assert output.position > before
    assert writer.messages == 2
    output.close()


def test_failed_chunk_is_not_counted_and_the_file_closes(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    output = FullDisk(path)
    writer = McapWriter(output)
    (channel,) = define_topics(writer)
    payload = encode(Odometry(), Format.CDR)
    writer.write_message(channel, 1, 1, payload)
    writer.flush()
    output.room = output.position
    for number in range(100):
        writer.write_message(channel, 2 + number, 1, payload)

    with pytest.raises(OSError, match="space"):
        writer.flush()
    output.room = 1 << 40
    writer.close()
    output.close()

    assert writer.messages == 1
    assert count_by_mcap(path) == count_by_rosbags(path) == {"/r0/odom": 1}


def test_output_appends_all_bytes_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run"
    output = OutputFile(path)
    output.write(b"head")
    whole = os.write
    written: list[int] = []

    def write_a_little(descriptor: int, content: bytes) -> int:
        if len(written) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(whole(descriptor, bytes(content)[:5]))
        return written[-1]

    monkeypatch.setattr(os, "write", write_a_little)
    with pytest.raises(OSError, match="space"):
        output.write(b"x" * 100)
    monkeypatch.undo()
    output.write(b"tail")
    output.close()

    assert path.read_bytes() == b"headtail"


DESCRIPTORS = Path("/proc/self/fd")


def measure_reserves(path: Path) -> list[int]:
    """Measure the reserves of a file: they are open, and have no name."""
    wanted = f"{find_reserve(path)} (deleted)"
    return [
        one.stat().st_size
        for one in DESCRIPTORS.iterdir()
        if one.is_symlink() and str(one.readlink()) == wanted
    ]


def test_reserve_without_a_name_grows_and_is_freed(tmp_path: Path) -> None:
    output = OutputFile(tmp_path / "run")

    output.reserve(10)
    (first,) = measure_reserves(tmp_path / "run")
    output.reserve(first + 1)

    assert measure_reserves(tmp_path / "run") == [2 * first]
    assert [one.name for one in tmp_path.iterdir()] == ["run"]
    output.close()
    assert measure_reserves(tmp_path / "run") == []


def test_compressed_log_returns_what_was_appended() -> None:
    log = CompressedLog()
    parts = [bytes([number % 251]) * (number * 37) for number in range(500)]
    for part in parts:
        log.append(part)

    content = b"".join(log.read())

    assert content == b"".join(parts)
    assert log.size == len(content)
