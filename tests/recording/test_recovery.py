"""Recordings that were cut or damaged give their whole chunks back."""

import random
from pathlib import Path

import pytest

from tests.recording.recordings import count_by_rosbags, write_recording
from zensim.recording.bag_info import read_info
from zensim.recording.mcap_records import Opcode
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.output_file import find_reserve
from zensim.recording.recovery import recover_file

MESSAGES = 1000
IN_A_CHUNK = 100


@pytest.fixture
def unclosed(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    write_recording(path, MESSAGES, is_closed=False)
    return path


def test_recovery_gives_all_chunks_of_a_file_that_was_never_closed(unclosed: Path) -> None:
    target = unclosed.with_name("whole.mcap")
    find_reserve(unclosed).touch()

    result = recover_file(unclosed, target)

    assert (result.messages, result.damaged, result.was_closed) == (MESSAGES, 0, False)
    assert sum(count_by_rosbags(target).values()) == MESSAGES
    assert not find_reserve(unclosed).exists()


@pytest.mark.parametrize("seed", range(5))
def test_recovery_of_a_cut_file_loses_what_follows_the_cut(unclosed: Path, seed: int) -> None:
    content = unclosed.read_bytes()
    length = random.Random(seed).randrange(len(content) // 4, len(content))
    unclosed.write_bytes(content[:length])
    target = unclosed.with_name("whole.mcap")

    result = recover_file(unclosed, target)

    assert result.messages % IN_A_CHUNK == 0
    assert sum(count_by_rosbags(target).values()) == result.messages == read_info(target).messages


@pytest.mark.parametrize("seed", range(15))
def test_recovery_loses_at_most_one_chunk_by_one_damaged_bit(unclosed: Path, seed: int) -> None:
    content = bytearray(unclosed.read_bytes())
    generator = random.Random(seed)
    content[generator.randrange(8, len(content))] ^= 1 << generator.randrange(8)
    unclosed.write_bytes(content)
    target = unclosed.with_name("whole.mcap")

    result = recover_file(unclosed, target)

    assert result.messages >= MESSAGES - IN_A_CHUNK
    assert sum(count_by_rosbags(target).values()) == result.messages


def test_recovery_passes_a_damaged_length(unclosed: Path) -> None:
    content = bytearray(unclosed.read_bytes())
    place = content.index(b"\x04\x00\x00\x00zstd") - 37
    assert content[place] == Opcode.CHUNK
    content[place + 1 + 6] ^= 0x10
    unclosed.write_bytes(content)

    result = recover_file(unclosed, unclosed.with_name("whole.mcap"))

    assert result.messages == MESSAGES - IN_A_CHUNK
    assert result.damaged == 1


def test_recovery_refuses_other_files_and_existing_targets(unclosed: Path) -> None:
    other = unclosed.with_name("notes.txt")
    other.write_text("no recording")
    target = unclosed.with_name("whole.mcap")

    with pytest.raises(ValueError, match="MCAP"):
        recover_file(other, target)
    assert not target.exists()
    with pytest.raises(FileExistsError):
        recover_file(unclosed, other)


def test_info_of_an_unclosed_file_equals_that_of_the_closed_one(tmp_path: Path) -> None:
    for name, is_closed in (("closed.mcap", True), ("open.mcap", False)):
        write_recording(tmp_path / name, MESSAGES, is_closed=is_closed)

    closed, unclosed = read_info(tmp_path / "closed.mcap"), read_info(tmp_path / "open.mcap")

    assert closed.unclosed == ()
    assert unclosed.unclosed == (str(tmp_path / "open.mcap"),)
    assert closed.messages == unclosed.messages == MESSAGES
    assert (closed.start_ns, closed.end_ns) == (unclosed.start_ns, unclosed.end_ns)
    assert [one for one in closed.topics if one.messages] == [
        one for one in unclosed.topics if one.messages
    ]
    assert closed.attachments == unclosed.attachments == ("world.sdf",)


def test_info_of_a_folder_adds_its_files(tmp_path: Path) -> None:
    write_recording(tmp_path / "a_0.mcap", 100)
    write_recording(tmp_path / "a_1.mcap", 200)

    found = read_info(tmp_path)

    assert found.messages == 300
    assert [Path(name).name for name in found.files] == ["a_0.mcap", "a_1.mcap"]


def test_recovery_that_fails_leaves_no_file(
    unclosed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = unclosed.with_name("whole.mcap")

    def fail(_writer: McapWriter) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapWriter, "close", fail)
    with pytest.raises(OSError, match="No space"):
        recover_file(unclosed, target)

    assert not target.exists()
    assert unclosed.exists()
