"""`zensim journal`: show, verify or export a server's journal, with or without a running server."""

import json
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from zensim.proto.exit_codes import exit_on_failure
from zensim.sim_server.cli import MissingServerExtra, server_extra
from zensim.sim_server.journal.sqlite_store import JournalError, open_store_read_only
from zensim.spawner.cli.command_session import AsJson

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class JournalAction(str, Enum):
    """What to do with a journal."""

    SHOW = "show"
    VERIFY = "verify"
    EXPORT = "export"


@app.command()
def journal(
    action: Annotated[
        JournalAction,
        typer.Argument(help="List its entities, look for damage, or print all of it as JSON."),
    ],
    folder: Annotated[Path, typer.Argument(help="The folder given to zensim serve --journal.")],
    *,
    as_json: AsJson = False,
) -> None:
    """Show, verify or export what a server keeps."""
    with exit_on_failure("journal", JournalError, MissingServerExtra):
        with server_extra():
            from zensim.sim_server.journal.journal_contents import (
                export_journal,
                format_summary,
                read_contents,
                summarize_journal,
            )
        with open_store_read_only(folder) as ledger:
            contents = read_contents(ledger)
            found = summarize_journal(ledger, contents)
            everything = (
                export_journal(ledger, contents) if action is JournalAction.EXPORT else found
            )
        if action is JournalAction.EXPORT or as_json:
            typer.echo(json.dumps(everything, indent=None if as_json else 2))
        elif action is JournalAction.SHOW:
            typer.echo(format_summary(found))
        else:
            typer.echo(f"{folder}: whole, up to change {found['position']}")
        if action is JournalAction.VERIFY and ledger.lost:
            raise JournalError(
                f"{folder} was cut short: its last {ledger.lost} changes are lost; "
                f"a server would go on from change {ledger.position}"
            )
