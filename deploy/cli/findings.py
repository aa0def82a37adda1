"""Results of the checks of `zensim doctor`: marks, table and exit status."""

from collections.abc import Sequence
from typing import Literal

import msgspec
from rich.table import Table
from rich.text import Text

from zensim.proto.exit_codes import ExitCode

FindingMark = Literal["ok", "note", "wrong"]
MARK_STYLES: dict[FindingMark, str] = {"ok": "green", "note": "yellow", "wrong": "bold red"}


class Finding(msgspec.Struct, frozen=True):
    """Result of one check."""

    mark: FindingMark
    what: str
    """Subject of the check."""
    found: str
    advice: str = ""
    status: ExitCode = ExitCode.OK
    """Exit status of the command if this finding is wrong."""


def choose_exit_status(findings: Sequence[Finding]) -> ExitCode:
    """Choose the exit status: that of the first wrong finding."""
    return next((one.status for one in findings if one.mark == "wrong"), ExitCode.OK)


def make_findings_table(findings: Sequence[Finding]) -> Table:
    """Make a table of one row for each finding, with its advice below it."""
    table = Table(box=None, show_header=False)
    for one in findings:
        advice = f"\n{one.advice}" if one.advice else ""
        table.add_row(Text(one.mark, MARK_STYLES[one.mark]), one.what, f"{one.found}{advice}")
    return table
