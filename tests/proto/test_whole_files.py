"""Files appear whole or not at all."""

import os
import stat
import time
from pathlib import Path

import pytest

from zensim.proto.whole_files import ABANDONED_AFTER_S, remove_abandoned, writing_whole


def write_and_fail(file: Path) -> None:
    with writing_whole(file) as stream:
        stream.write(b"ne")
        raise OSError("disk full")


def test_file_is_replaced_at_the_end_of_the_block(tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    file.write_bytes(b"old")

    with writing_whole(file) as stream:
        stream.write(b"new")
        during = file.read_bytes()

    assert (during, file.read_bytes()) == (b"old", b"new")
    assert list(tmp_path.iterdir()) == [file]


def test_file_stays_as_it_was_when_writing_fails(tmp_path: Path) -> None:
    file = tmp_path / "a.json"
    file.write_bytes(b"old")

    with pytest.raises(OSError, match="full"):
        write_and_fail(file)

    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


def test_file_has_its_mode(tmp_path: Path) -> None:
    with writing_whole(tmp_path / "secret", mode=0o600) as stream:
        stream.write(b"x")

    assert stat.S_IMODE((tmp_path / "secret").stat().st_mode) == 0o600


def test_only_files_that_were_abandoned_are_removed(tmp_path: Path) -> None:
    names = [".a.json.0123456789abcdef.part", ".b.json.0123456789abcdef.part", "download.part"]
    before_s = time.time() - ABANDONED_AFTER_S - 60.0
    for name in names:
        (tmp_path / name).touch()
    for name in (names[0], names[2]):
        os.utime(tmp_path / name, (before_s, before_s))

    remove_abandoned(tmp_path)

    assert sorted(one.name for one in tmp_path.iterdir()) == names[1:]
