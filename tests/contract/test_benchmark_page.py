"""docs/benchmarks.md is what its results make of it, and limits are what docs/limits.md says."""

import ast
import re
from pathlib import Path

import pytest

from benchmarks.__main__ import PAGE as RESULTS
from benchmarks.benchmark_report import NAMES
from benchmarks.figures import Figure, Limit
from benchmarks.limits import judge, read_limits
from benchmarks.measured_page import list_judged, read_sections
from benchmarks.overview_page import PAGE, find_cause, make_page
from tests.contract.repository import ROOT, shown, text_of

MOST_LIMITS = 60
MOST_LINES = 8000
IN_TOLERANCE = {"mechanics_joints.py", "mechanics_scene.py"}
"""Modules whose figures have tolerances, which one figure counts."""


def test_page_is_made_from_the_results() -> None:
    assert text_of(PAGE) == make_page(text_of(RESULTS)), "python -m benchmarks.overview_page"


def test_each_judged_figure_of_the_results_has_a_limit_and_each_limit_a_figure() -> None:
    found = {
        (name, one.figure, one.asked)
        for name, section in read_sections(text_of(RESULTS)).items()
        for one in list_judged(section)
    }

    assert found == {
        (name, figure, str(one.limit))
        for name, limits in read_limits().items()
        for figure, one in limits.items()
    }


def test_there_are_few_limits_and_each_says_why_a_user_notices() -> None:
    limits = [one for section in read_limits().values() for one in section.values()]

    assert len(limits) <= MOST_LIMITS
    assert [one for one in limits if not one.why] == []
    assert set(read_limits()) <= set(NAMES)


def test_what_is_missed_has_a_named_cause_and_nothing_else_has() -> None:
    judged = [one for text in read_sections(text_of(RESULTS)).values() for one in list_judged(text)]

    assert [one.figure for one in judged if one.is_missed != bool(find_cause(one.figure))] == []


def test_documents_name_benchmarks_that_are_there() -> None:
    """Decisions keep the names of their time."""
    pages = [*(ROOT / "docs").glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    named = {
        (name, shown(page))
        for page in pages
        for name in re.findall(r"python -m\s+benchmarks\s+([a-z_0-9]+)", text_of(page))
    }

    assert named
    assert [one for one in sorted(named) if one[0] not in NAMES] == []


def list_benchmark_modules() -> list[Path]:
    return sorted((ROOT / "benchmarks").rglob("*.py"))


def test_benchmarks_have_no_limits_of_their_own() -> None:
    makers = [
        path.name
        for path in list_benchmark_modules()
        for node in ast.walk(ast.parse(text_of(path)))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "Limit"
    ]

    assert set(makers) <= IN_TOLERANCE


def test_benchmarks_are_few_lines() -> None:
    lines = sum(text_of(path).count("\n") for path in list_benchmark_modules())

    assert lines <= MOST_LINES


def test_figures_get_the_limits_of_their_benchmark_only() -> None:
    figure = Figure(what="10 robots, with page: exec to ready", unit="s", samples=(7.0,))

    (judged,) = judge("start", [figure])

    assert judged.is_missed
    assert list(judge("cli", [figure])) == [figure]


def test_limit_is_read_as_it_is_written() -> None:
    assert str(Limit.parse("p99 <= 50")) == "p99 <= 50"
    with pytest.raises(ValueError, match="abc"):
        Limit.parse("p99 <= abc")
