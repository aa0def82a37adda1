"""Spawn reports on a terminal and in a file."""

from io import StringIO

import pytest
from rich.console import Console

from zensim.deploy.cli.terminal_output import print_report
from zensim.proto.messages.model_messages import ReportEntry

ENTRIES = (
    ReportEntry("suspicious", "joint 'a'", "no such joint"),
    ReportEntry("applied", "plugin '[red]d[/red]'", "drive"),
    ReportEntry("ignored", "gazebo 'x': <kp>"),
)


def print_lines(entries: tuple[ReportEntry, ...], *, is_terminal: bool) -> list[str]:
    out = StringIO()
    console = Console(file=out, force_terminal=is_terminal, width=80, color_system=None)
    print_report(entries, console)
    return out.getvalue().splitlines()


@pytest.mark.parametrize("is_terminal", [False, True])
def test_report_ends_with_suspicious_entries(is_terminal: bool) -> None:
    lines = print_lines(ENTRIES, is_terminal=is_terminal)

    assert [line.split()[0] for line in lines[-3:]] == ["applied", "ignored", "suspicious"]


@pytest.mark.parametrize("is_terminal", [False, True])
def test_report_does_not_parse_markup(is_terminal: bool) -> None:
    assert "[red]d[/red]" in "\n".join(print_lines(ENTRIES, is_terminal=is_terminal))


def test_report_is_aligned_without_a_terminal() -> None:
    lines = print_lines(ENTRIES, is_terminal=False)

    assert lines[0].index("drive") == lines[2].index("no such joint")


def test_empty_report_prints_nothing() -> None:
    assert print_lines((), is_terminal=True) == []
