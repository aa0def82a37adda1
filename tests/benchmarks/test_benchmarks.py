"""Each benchmark runs, briefly; how fast anything is, is not judged here."""

import subprocess
import sys

import pytest

from benchmarks.__main__ import PAGE
from benchmarks.benchmark_report import NAMES, Section, measure, page
from benchmarks.machine import ROOT, Work, others_cores


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
@pytest.mark.parametrize("name", NAMES)
def test_benchmark_fills_a_table_when_it_is_short(name: str) -> None:
    text = measure(name, is_short=True).text

    head, _, rows = text.partition("---|\n")
    assert head.startswith("## ")
    assert f"`.venv/bin/python -m benchmarks {name}`" in head
    assert rows.startswith("| ")


def test_command_prints_what_was_named_and_leaves_the_page_alone() -> None:
    before = PAGE.read_bytes()

    done = run("codec", "--short")

    assert done.returncode == 0, done.stderr
    assert done.stdout.count("## ") == 1
    assert PAGE.read_bytes() == before


def test_command_refuses_a_name_that_it_does_not_know() -> None:
    done = run("codec", "fast")

    assert done.returncode == 2
    assert f"unknown: fast; there are {', '.join(NAMES)}" in done.stderr


def test_page_names_the_machine_and_what_was_missed() -> None:
    sections = [Section("## One\n", ("way: asked",)), Section("## Two\n", ())]

    text = page(sections, "0.10, 0.20, 0.30")

    assert "| load average before | 0.10, 0.20, 0.30 (1, 5, 15 min) |" in text
    assert "## Missed\n\n- way: asked\n" in text
    assert text.index("## One") < text.index("## Two")


def test_page_says_that_nothing_was_missed() -> None:
    assert "## Missed\n\nNothing.\n" in page([Section("## One\n", ())], "")


def test_others_cores_are_what_was_used_and_not_by_this_program() -> None:
    before = Work(wall_s=100.0, all_s=50.0, own_s=5.0)

    assert others_cores(before, Work(wall_s=110.0, all_s=65.0, own_s=15.0)) == pytest.approx(0.5)
    assert others_cores(before, Work(wall_s=110.0, all_s=59.9, own_s=15.0)) == 0.0
