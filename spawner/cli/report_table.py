"""A spawn report for people: a table on a terminal, aligned columns elsewhere."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from zensim.proto.messages.model_messages import ReportEntry

COLOURS = {"applied": "green", "ignored": "dim", "unknown": "cyan", "suspicious": "bold yellow"}
"""In the order of the table: what needs a look comes last, next to the prompt."""
HEAD = ("", "tag or plug-in", "why")


def print_report(entries: Sequence[ReportEntry], console: Console) -> None:
    """Print what became of each tag and plug-in; nothing when there is nothing to say."""
    if not entries:
        return
    ranks = list(COLOURS)
    in_order = sorted(entries, key=lambda entry: ranks.index(entry.status))
    if console.is_terminal:
        console.print(_table(in_order))
    else:
        for line in aligned(in_order):
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def aligned(entries: Sequence[ReportEntry]) -> list[str]:
    """Lay entries out in columns, a line each."""
    width = max(len(entry.subject) for entry in entries)
    return [
        f"{entry.status:<10}  {entry.subject:<{min(width, 60)}}  {entry.reason}".rstrip()
        for entry in entries
    ]


def _table(entries: Sequence[ReportEntry]) -> Table:
    table = Table(*HEAD, box=None, pad_edge=False)
    for entry in entries:
        # As Text, for what a stranger wrote must not be read as markup.
        cells = [Text(cell) for cell in (entry.status, entry.subject, entry.reason)]
        table.add_row(*cells, style=COLOURS[entry.status])
    return table
