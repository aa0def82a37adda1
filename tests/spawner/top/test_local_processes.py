"""Descendants of processes, from a folder as /proc is."""

import os
import subprocess
import sys
from pathlib import Path

from zensim.spawner.top.local_processes import list_descendants


def add_process(proc: Path, number: int, parent: int, command: str = "") -> None:
    folder = proc / str(number)
    folder.mkdir()
    fields = ["S", str(parent), *["0"] * 9, "100", "50", *["0"] * 8, "25", "0"]
    (folder / "stat").write_text(f"{number} (a (b) c) {' '.join(fields)}")
    (folder / "cmdline").write_bytes(command.replace(" ", "\0").encode())


def test_descendants_are_listed_with_figures_and_names(tmp_path: Path) -> None:
    add_process(tmp_path, 1, 0)
    add_process(tmp_path, 5, 1, "python -m zensim agent r1")
    add_process(tmp_path, 6, 5)
    add_process(tmp_path, 7, 2)
    (tmp_path / "meminfo").write_text("")

    child, grandchild = list_descendants([1], tmp_path)

    assert (child.process_id, child.parent_id, child.name) == (5, 1, "zensim agent")
    assert child.cpu_s == 150 / os.sysconf("SC_CLK_TCK")
    assert child.memory_bytes == 25 * os.sysconf("SC_PAGE_SIZE")
    assert (grandchild.process_id, grandchild.name) == (6, "a (b) c")


def test_process_that_ends_meanwhile_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "5").mkdir()

    assert list_descendants([1], tmp_path) == []


def test_system_without_proc_has_none(tmp_path: Path) -> None:
    assert list_descendants([1], tmp_path / "proc") == []


def test_real_child_is_found() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", "input()"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
    ) as child:
        found = [one.process_id for one in list_descendants([os.getpid()])]
        child.kill()

    assert child.pid in found
