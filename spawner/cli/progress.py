"""Progress bars on standard error; silent when that is no terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)

from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.spawner.cli.session import progress_console


@contextmanager
def upload_progress() -> Iterator[Callable[[int, int], None]]:
    """Show how many bytes of how many have gone; nothing as long as none goes."""
    with _progress(DownloadColumn()) as progress:
        task = progress.add_task("sending meshes", total=None, visible=False)

        def advance(count: int, total: int) -> None:
            progress.update(task, advance=count, total=total, visible=True)

        yield advance


@contextmanager
def step_progress(total: int) -> Iterator[Callable[[StepsProgress], None]]:
    """Show how many steps of how many are made."""
    with _progress(MofNCompleteColumn()) as progress:
        task = progress.add_task("stepping", total=total)
        yield lambda told: progress.update(task, completed=told.completed_steps)


def _progress(figures: ProgressColumn) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        figures,
        TimeElapsedColumn(),
        console=progress_console,
        disable=not progress_console.is_terminal,
        transient=True,
    )
