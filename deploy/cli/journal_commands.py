"""`zensim journal`: show, verify, export or copy a server's journal, even while it is in use."""

import json
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import JsonOption
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.sim_server.journal.sqlite_store import (
    DATABASE,
    FILES,
    JournalError,
    SqliteStore,
    open_store,
    open_store_read_only,
)
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

app = make_app()


class JournalAction(str, Enum):
    """Operation on a journal."""

    SHOW = "show"
    VERIFY = "verify"
    EXPORT = "export"
    BACKUP = "backup"


AcceptLossOption = Annotated[
    bool,
    typer.Option(
        "--accept-loss",
        help="With verify: let a server continue a copy that lacks its newest changes.",
    ),
]


@app.command(
    epilog="""Examples:
  zensim journal show ./journal
  zensim journal export ./journal > journal.json
  zensim journal backup ./journal ./copy"""
)
def journal(
    action: Annotated[
        JournalAction,
        typer.Argument(
            metavar="ACTION",
            help="show: list the entities; verify: check for damage; export: print all as JSON; "
            "backup: copy it to TARGET.",
        ),
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder of 'zensim serve --journal'.")
    ],
    target: Annotated[
        Path | None, typer.Argument(metavar="TARGET", help="Empty or new folder for a backup.")
    ] = None,
    *,
    accept_loss: AcceptLossOption = False,
    as_json: JsonOption = False,
) -> None:
    """Show, verify, export or copy a server journal; the server may be running."""
    with exit_on_failure("journal", JournalError, MissingServerExtra):
        with server_extra():
            from zensim.sim_server.journal.journal_contents import format_summary

        if accept_loss:
            _accept_loss(action, folder)
        with open_store_read_only(folder) as store:
            summary, output, damaged = _read(store, action, folder, target)
        if action is JournalAction.EXPORT or as_json:
            print_lines(json.dumps(output, indent=None if as_json else 2))
        elif action is JournalAction.SHOW:
            print_lines(format_summary(summary))
        if store.loss:
            raise JournalError(store.loss)
        if action in (JournalAction.VERIFY, JournalAction.BACKUP) and not as_json:
            _report(action, folder, summary, damaged)


def _read(
    store: SqliteStore, action: JournalAction, folder: Path, target: Path | None
) -> tuple[dict[str, object], dict[str, object], tuple[str, ...]]:
    """Return summary, what `--json` prints, and the damaged files; copy the journal for BACKUP."""
    from zensim.sim_server.journal.journal_contents import (
        backup_journal,
        export_journal,
        find_damaged_files,
        read_contents,
        summarize_journal,
    )

    if store.loss and action is JournalAction.BACKUP:
        raise JournalError(store.loss)
    contents = read_contents(store)
    summary = summarize_journal(store, contents)
    if action is JournalAction.BACKUP:
        backup_journal(store, contents, _require_target(target))
    damaged: tuple[str, ...] = ()
    if action is JournalAction.VERIFY and contents is not None:
        damaged = find_damaged_files(contents, folder / FILES)
    output = export_journal(store, contents) if action is JournalAction.EXPORT else summary
    return summary, output, damaged


def _accept_loss(action: JournalAction, folder: Path) -> None:
    """Let servers continue a copy that was made without its log."""
    if action is not JournalAction.VERIFY:
        raise JournalError("--accept-loss needs the action verify")
    if not (folder / DATABASE).is_file():
        return  # what reads it says that it is none
    open_store(folder, accepts_loss=True).close()


def _require_target(target: Path | None) -> Path:
    if target is None:
        raise JournalError("backup needs a second folder: zensim journal backup FOLDER TARGET")
    return target


def _report(
    action: JournalAction, folder: Path, summary: dict[str, object], damaged: tuple[str, ...]
) -> None:
    """Print the result of a check or a copy.

    Raises:
        JournalError: Files are damaged.
    """
    if damaged:
        raise JournalError(
            f"{folder}: {len(damaged)} meshes are damaged or missing, as {FILES}/{damaged[0]}; "
            "restore them from a copy, or a server sets their entities aside"
        )
    what = "copied" if action is JournalAction.BACKUP else "intact"
    print_lines(f"{folder}: {what}, up to change {summary['position']}")
