"""Progress bars on standard error, and the spawn report as a table or as aligned columns."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Table
from rich.text import Text

from zensim.deploy.cli.command_session import progress_console
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.proto.printable_text import printable

STATUS_COLOURS = {
    "applied": "green",
    "ignored": "dim",
    "unknown": "cyan",
    "predicted": "magenta",
    "suspicious": "bold yellow",
}
"""Colours in the order of the table: suspicious entries come last, next to the prompt."""
REPORT_COLUMNS = ("", "tag or plug-in", "why")


def print_report(entries: Sequence[ReportEntry], console: Console) -> None:
    """Print the status of each tag and plug-in; nothing if there are none."""
    if not entries:
        return
    ranks = list(STATUS_COLOURS)
    ordered = sorted(entries, key=lambda entry: ranks.index(entry.status))
    if console.is_terminal:
        console.print(_make_table(ordered))
    else:
        for line in align_entries(ordered):
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def align_entries(entries: Sequence[ReportEntry]) -> list[str]:
    """Format each entry as one line with aligned columns."""
    width = max(len(entry.subject) for entry in entries)
    return [
        f"{entry.status:<10}  {entry.subject:<{min(width, 60)}}  {entry.reason}".rstrip()
        for entry in entries
    ]


def _make_table(entries: Sequence[ReportEntry]) -> Table:
    table = Table(*REPORT_COLUMNS, box=None, pad_edge=False)
    for entry in entries:
        # As Text: untrusted descriptions must not be parsed as markup.
        cells = [Text(printable(cell)) for cell in (entry.status, entry.subject, entry.reason)]
        table.add_row(*cells, style=STATUS_COLOURS[entry.status])
    return table


@contextmanager
def upload_progress() -> Iterator[Callable[[int, int], None]]:
    """Show the number of uploaded bytes; nothing before the first."""
    with _make_progress(DownloadColumn()) as progress:
        task = progress.add_task("uploading meshes", total=None, visible=False)

        def advance(count: int, total: int) -> None:
            progress.update(task, advance=count, total=total, visible=True)

        yield advance


@contextmanager
def step_progress(total: int) -> Iterator[Callable[[StepsProgress], None]]:
    """Show the number of completed steps."""
    with _make_progress(MofNCompleteColumn()) as progress:
        task = progress.add_task("stepping", total=total)
        yield lambda status: progress.update(task, completed=status.completed_steps)


def _make_progress(figures: ProgressColumn) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        figures,
        TimeElapsedColumn(),
        console=progress_console,
        disable=not progress_console.is_terminal,
        transient=True,
    )
