"""The report of a spawn, on a terminal and in a file."""

from io import StringIO

import pytest
from rich.console import Console

from zensim.proto.messages.model_messages import ReportEntry
from zensim.spawner.cli.terminal_output import print_report

ENTRIES = (
    ReportEntry("suspicious", "joint 'a'", "no such joint"),
    ReportEntry("applied", "plugin '[red]d[/red]'", "drive"),
    ReportEntry("ignored", "gazebo 'x': <kp>"),
)


def printed(entries: tuple[ReportEntry, ...], *, is_terminal: bool) -> list[str]:
    out = StringIO()
    console = Console(file=out, force_terminal=is_terminal, width=80, color_system=None)
    print_report(entries, console)
    return out.getvalue().splitlines()


@pytest.mark.parametrize("is_terminal", [False, True])
def test_report_ends_with_what_needs_a_look(is_terminal: bool) -> None:
    lines = printed(ENTRIES, is_terminal=is_terminal)

    assert [line.split()[0] for line in lines[-3:]] == ["applied", "ignored", "suspicious"]


@pytest.mark.parametrize("is_terminal", [False, True])
def test_report_shows_what_a_stranger_wrote_as_it_is(is_terminal: bool) -> None:
    assert "[red]d[/red]" in "\n".join(printed(ENTRIES, is_terminal=is_terminal))


def test_report_is_aligned_where_there_is_no_terminal() -> None:
    lines = printed(ENTRIES, is_terminal=False)

    assert lines[0].index("drive") == lines[2].index("no such joint")


def test_report_that_is_empty_prints_nothing() -> None:
    assert printed((), is_terminal=True) == []
