"""Each benchmark runs, briefly; how fast anything is, is not judged here."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import PAGE
from benchmarks.benchmark_report import NAMES, Section, measure
from benchmarks.document_command import Document
from benchmarks.machine import ROOT, Work, others_cores
from zensim.proto.parent_death import PARENT_PID_VARIABLE


def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "benchmarks", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )


@pytest.mark.short_form
# Peers are installed from an index first: they run by hand.
@pytest.mark.parametrize("name", [name for name in NAMES if name != "peers"])
def test_benchmark_fills_a_table_when_it_is_short(name: str) -> None:
    text = measure(name, is_short=True).text

    head, _, rows = text.partition("---|\n")
    assert head.startswith("## ")
    assert f"`.venv/bin/python -m benchmarks {name}`" in head
    assert rows.startswith("| ")


def test_command_prints_what_was_named_and_leaves_the_page_alone() -> None:
    before = PAGE.read_bytes()

    done = run("reading", "--short")

    assert done.returncode == 0, done.stderr
    assert done.stdout.count("## ") == 1
    assert PAGE.read_bytes() == before


def test_command_refuses_a_name_that_it_does_not_know() -> None:
    done = run("reading", "fast")

    assert done.returncode == 2
    assert f"unknown: fast; there are {', '.join(NAMES)}" in done.stderr


def make_section(name: str, *, is_short: bool) -> Section:
    return Section(f"## {name}\n\n`python -m trial {name}`\n\nshort: {is_short}\n", ())


def test_what_was_measured_at_full_length_goes_to_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = Document(
        program="trial",
        names=("one", "two"),
        make=make_section,
        short="less",
        path=tmp_path / "page.md",
        head="# Trial\n",
    )

    def written(*arguments: str) -> list[str]:
        monkeypatch.setattr(sys, "argv", ["trial", *arguments])
        document.path.write_text("# Trial\n\n## Two\n\n`python -m trial two`\n\nas before\n")
        document.write()
        text = document.path.read_text()
        return [name for name in ("one", "two", "as before", "Measured") if name in text]

    monkeypatch.setenv(PARENT_PID_VARIABLE, "")
    assert written("one", "--short") == ["two", "as before"]
    assert written("one") == ["two", "as before"]
    assert written("one", "--write") == ["one", "two", "as before", "Measured"]
    assert written() == ["one", "two", "Measured"]


def test_others_cores_are_what_was_used_and_not_by_this_program() -> None:
    before = Work(wall_s=100.0, all_s=50.0, own_s=5.0)

    assert others_cores(before, Work(wall_s=110.0, all_s=65.0, own_s=15.0)) == pytest.approx(0.5)
    assert others_cores(before, Work(wall_s=110.0, all_s=59.9, own_s=15.0)) == 0.0
