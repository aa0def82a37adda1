"""Files of others are read if they are regular ones, and not beyond their limit."""

import hashlib
import os
from pathlib import Path

import pytest

from zensim.proto.bounded_files import (
    PIECE_BYTES,
    FileTooLarge,
    NotRegularFile,
    hash_file,
    open_regular_file,
    read_file,
    read_text_file,
)
from zensim.proto.exit_codes import format_failure


def test_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_bytes(b"12345")

    assert read_file(file, 5) == b"12345"
    with pytest.raises(FileTooLarge) as caught:
        read_file(file, 4)
    assert caught.value.slug == "file.size"
    assert str(file) in format_failure(caught.value)


def test_size_is_checked_before_anything_is_read(tmp_path: Path) -> None:
    file, pieces = tmp_path / "sparse", list[None]()
    file.touch()
    os.truncate(file, 1 << 40)

    with pytest.raises(FileTooLarge):
        read_file(file, PIECE_BYTES, lambda: pieces.append(None))
    assert pieces == []


def test_file_without_a_size_is_read_up_to_its_limit() -> None:
    assert read_text_file(Path("/proc/self/stat")).startswith(f"{os.getpid()} ")
    with pytest.raises(FileTooLarge):
        read_file(Path("/proc/self/stat"), 3)


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "/dev/urandom"])
def test_device_is_refused(device: str) -> None:
    with pytest.raises(NotRegularFile) as caught:
        read_text_file(Path(device))
    assert caught.value.slug == "file.kind"


def test_pipe_without_a_writer_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")

    with pytest.raises(NotRegularFile):
        open_regular_file(tmp_path / "pipe")


def test_folder_is_called_a_folder(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError):
        read_file(tmp_path, 1)


def test_line_ends_of_other_systems_are_line_ends(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"a\r\nb\rc\n")

    assert read_text_file(tmp_path / "a") == "a\nb\nc\n"


def test_hash_is_that_of_all_pieces(tmp_path: Path) -> None:
    data = os.urandom(2 * PIECE_BYTES + 1)
    (tmp_path / "a").write_bytes(data)

    assert hash_file(tmp_path / "a") == (hashlib.sha256(data).hexdigest(), len(data))
