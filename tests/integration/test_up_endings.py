"""How `zensim up` ends, or goes on, when something fails: named at once, with a status."""

import os
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from tests.integration.processes import (
    children,
    eventually,
    free_endpoint,
    kill,
    read_json_line,
    running,
    zensim,
)
from zensim.deploy.local_runs import list_runs
from zensim.proto.exit_codes import ExitCode
from zensim.recording.bag_info import read_info

SMALL = ("--engine", "mujoco", "--no-viewer", "--robots", "1", "--behaviour", "none")
SOON_S = 30.0
LITTLE_SPACE = "32m"
FILE_HEAD_BYTES = 5_000
"""A file has begun when it has so many."""


@pytest.fixture(autouse=True)
def own_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the records of these runs apart from those of the user."""
    folder = tmp_path / "run"
    folder.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))


@contextmanager
def up(*arguments: str, prefix: Sequence[str] = ()) -> Iterator["subprocess.Popen[str]"]:
    given = ("--listen", free_endpoint(), "--json", *SMALL, *arguments)
    with running("up", *given, prefix=prefix) as process:
        read_json_line(process)
        yield process


def find_child(process: "subprocess.Popen[str]", verb: str) -> int | None:
    """Find the process id of the program that runs a verb."""
    return next((pid for pid in children(process.pid) if verb in read_words(pid)), None)


def read_words(pid: int) -> list[str]:
    """Read the command line of a process; empty if it has ended."""
    try:
        return psutil.Process(pid).cmdline()
    except psutil.NoSuchProcess:
        return []


def end_by(process: "subprocess.Popen[str]", number: signal.Signals | None) -> tuple[int, str]:
    """Wait for the end, after a signal if one is given; return status and standard error."""
    if number is not None:
        process.send_signal(number)
    _, errors = process.communicate(timeout=120.0)
    return process.returncode, errors


def has_messages(file: Path) -> bool:
    """Whether a file that is being written has some."""
    return file.exists() and file.stat().st_size > FILE_HEAD_BYTES and read_info(file).messages > 0


def test_recording_goes_on_in_a_new_part_when_its_recorder_was_killed(tmp_path: Path) -> None:
    folder = tmp_path / "rec"
    with up("--record", str(folder)) as process:
        first = eventually(lambda: find_child(process, "record"), SOON_S, "the recorder")
        part = folder / "rec_0.mcap"
        eventually(lambda: has_messages(part), SOON_S, "messages")

        kill(first, signal.SIGKILL)

        second = folder / "rec_1.mcap"
        eventually(lambda: has_messages(second), SOON_S, "a new part")
        status, errors = end_by(process, signal.SIGINT)

    assert status == ExitCode.NOT_RECORDED, errors
    assert sorted(one.name for one in folder.iterdir()) == [
        "metadata.yaml",
        "rec_0.mcap",
        "rec_1.mcap",
    ]
    counts = {one.name: one.messages for one in read_info(folder).topics}
    assert counts["/clock"] > 0
    assert sum(counts.values()) == read_info(part).messages + read_info(second).messages


def test_whole_recording_ends_with_status_0(tmp_path: Path) -> None:
    with up("--record", str(tmp_path / "rec.mcap")) as process:
        status, errors = end_by(process, signal.SIGINT)

    assert status == ExitCode.OK, errors


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system that is soon full."""
    folder = tmp_path / "disk"
    folder.mkdir()
    subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={LITTLE_SPACE}", "tmpfs", str(folder)], check=True
    )
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.fixture
def read_only_disk(small_disk: Path) -> Path:
    """A file system that nothing can be written to."""
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    return small_disk


def test_disk_that_fills_is_named_and_the_world_goes_on_until_its_end(small_disk: Path) -> None:
    # Less than --min-free of a recorder.
    with up("--record", str(small_disk / "rec")) as process:
        eventually(lambda: find_child(process, "record") is None, SOON_S, "its end")
        assert process.poll() is None
        status, errors = end_by(process, signal.SIGINT)

    assert status == ExitCode.NOT_RECORDED
    assert "--min-free" in errors
    assert str(small_disk) in errors


@pytest.mark.parametrize("option", ["--record", "--journal"])
def test_folder_that_cannot_be_written_is_named_at_the_start(
    option: str, read_only_disk: Path
) -> None:
    done = zensim("up", "--listen", free_endpoint(), *SMALL, option, str(read_only_disk / "it"))

    assert done.returncode == ExitCode.FAILED
    assert str(read_only_disk) in done.stderr
    assert os.strerror(30) in done.stderr
    assert "not ready" not in done.stderr


@pytest.mark.parametrize("has_journal", [False, True])
def test_killed_server_ends_up_with_the_way_to_get_the_world_back(
    *, has_journal: bool, tmp_path: Path
) -> None:
    journal = ("--journal", str(tmp_path / "journal")) if has_journal else ()
    with up(*journal) as process:
        server = eventually(lambda: find_child(process, "serve"), SOON_S, "the server")
        kill(server, signal.SIGKILL)
        status, errors = end_by(process, None)

    assert status == ExitCode.FAILED
    assert ("--journal FOLDER" in errors) != has_journal
    assert (str(tmp_path / "journal") in errors) == has_journal


def test_record_of_a_killed_up_is_removed_by_the_next_one(tmp_path: Path) -> None:
    records = tmp_path / "run"
    with up() as killed:
        killed.kill()
        killed.wait()
        assert list(records.rglob(f"{killed.pid}.json"))

        with up() as process:
            assert not list(records.rglob(f"{killed.pid}.json"))
            assert [one.process_id for one in list_runs()] == [process.pid]
