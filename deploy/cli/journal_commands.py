"""`zensim journal`: show, verify or export a server's journal, with or without a running server."""

import json
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from zensim.proto.cli_options import JsonOption, expand_options, make_app
from zensim.proto.exit_codes import exit_on_failure
from zensim.sim_server.journal.sqlite_store import JournalError, open_store_read_only
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

app = make_app()


class JournalAction(str, Enum):
    """Operation on a journal."""

    SHOW = "show"
    VERIFY = "verify"
    EXPORT = "export"


@app.command(
    epilog="""Examples:
  zensim journal show ./journal
  zensim journal export ./journal > journal.json"""
)
@expand_options
def journal(
    action: Annotated[
        JournalAction,
        typer.Argument(
            metavar="ACTION",
            help="show: list the entities; verify: check for damage; export: print all as JSON.",
        ),
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder of 'zensim serve --journal'.")
    ],
    *,
    as_json: JsonOption = False,
) -> None:
    """Show, verify or export a server journal; the server may be running."""
    with exit_on_failure("journal", JournalError, MissingServerExtra):
        with server_extra():
            from zensim.sim_server.journal.journal_contents import (
                export_journal,
                format_summary,
                read_contents,
                summarize_journal,
            )
        with open_store_read_only(folder) as store:
            contents = read_contents(store)
            summary = summarize_journal(store, contents)
            output = export_journal(store, contents) if action is JournalAction.EXPORT else summary
        if action is JournalAction.EXPORT or as_json:
            typer.echo(json.dumps(output, indent=None if as_json else 2))
        elif action is JournalAction.SHOW:
            typer.echo(format_summary(summary))
        else:
            typer.echo(f"{folder}: intact, up to change {summary['position']}")
        if action is JournalAction.VERIFY and store.lost:
            raise JournalError(
                f"{folder} is truncated: its last {store.lost} changes are lost; "
                f"a server would continue from change {store.position}"
            )
