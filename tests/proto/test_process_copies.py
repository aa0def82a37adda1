"""Copies of a process, and children that were adopted."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tests.integration.processes import eventually
from zensim.proto.child_process import end_processes
from zensim.proto.parent_death import PARENT_PID_VARIABLE, set_subreaper
from zensim.proto.process_copies import AdoptedProcess

ENDS_S = 40.0
COPY = """
import json, os, signal, sys
from zensim.proto.process_copies import copy_process
if (number := copy_process(2, os.environ)) is not None:
    facts = {"pid": os.getpid(), "parent": os.getppid(), "session": os.getsid(0)}
    with open(f"{sys.argv[1]}/{number}.new", "w") as file:
        json.dump(facts, file)
    os.rename(file.name, f"{sys.argv[1]}/{number}")
    signal.pause()
"""
SLEEP = (sys.executable, "-c", "import signal; signal.pause()")


def copy(folder: Path, parent: int) -> list[int]:
    """Make copies that write what they are into a folder; return their process ids."""
    with (folder / "errors").open("w") as errors:  # a pipe would be open while they run
        done = subprocess.run(
            [sys.executable, "-c", COPY, str(folder)],
            stdout=subprocess.PIPE,
            stderr=errors,
            check=True,
            env={**os.environ, PARENT_PID_VARIABLE: str(parent)},
        )
    return [int(pid) for pid in done.stdout.split()]


@pytest.fixture
def adopted() -> Iterator[AdoptedProcess]:
    child = subprocess.Popen(SLEEP)
    found = AdoptedProcess(child.pid)
    yield found
    found.kill()
    child.returncode = found.wait()


@pytest.fixture
def _subreaper() -> Iterator[None]:
    set_subreaper(is_one=True)
    yield
    set_subreaper(is_one=False)


@pytest.mark.usefixtures("_subreaper")
def test_copies_become_children_of_the_process_that_started_the_original(tmp_path: Path) -> None:
    copies = [AdoptedProcess(pid) for pid in copy(tmp_path, os.getpid())]

    files = [tmp_path / "0", tmp_path / "1"]
    eventually(lambda: all(one.exists() for one in files), ENDS_S, "copies")
    facts = [json.loads(one.read_text()) for one in files]

    assert [one["pid"] for one in facts] == [one.pid for one in copies]
    assert [one["session"] for one in facts] == [one.pid for one in copies]
    assert {one["parent"] for one in facts} == {os.getpid()}
    end_processes(dict.fromkeys(copies, ENDS_S))
    assert [one.returncode for one in copies] == [-signal.SIGTERM] * 2


def test_copies_end_when_their_parent_is_gone(tmp_path: Path) -> None:
    pids = copy(tmp_path, 2**22)

    eventually(lambda: not any(map(psutil.pid_exists, pids)), ENDS_S, "their end")
    assert [one.name for one in tmp_path.iterdir()] == ["errors"]
    assert (tmp_path / "errors").read_text().count("has ended") == len(pids)


def test_adopted_process_is_watched_and_ended_as_a_child(adopted: AdoptedProcess) -> None:
    running = adopted.poll()

    adopted.terminate()

    assert running is None
    assert adopted.wait() == adopted.poll() == -signal.SIGTERM
    adopted.terminate()


def test_adopted_process_that_others_have_reaped_counts_as_ended(adopted: AdoptedProcess) -> None:
    adopted.terminate()
    os.waitpid(adopted.pid, 0)

    assert adopted.poll() == 0


@pytest.mark.parametrize(("count", "is_shown"), [(2, True), (999, False)])
def test_process_shows_a_command_line_that_fits(count: int, *, is_shown: bool) -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; from zensim.proto.process_copies import name_process;"
            f"name_process(['b c'] * {count});"
            "sys.stdout.write(open('/proc/self/cmdline').read())",
        ],
        capture_output=True,
        text=True,
        check=True,
    )

    shown = done.stdout.rstrip("\0").split("\0")

    assert (shown == ["b c"] * count) == is_shown
