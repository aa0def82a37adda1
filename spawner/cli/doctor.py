"""`zensim doctor`."""

from importlib.metadata import version
from typing import Annotated

import msgspec
import typer
from rich.table import Table
from rich.text import Text

from zensim.proto.bus import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.names import check_name
from zensim.spawner.cli.session import AsJson, Connect, WorldName, data_console
from zensim.spawner.doctor import Finding, Mark, examine, worst

STYLES: dict[Mark, str] = {"ok": "green", "note": "yellow", "wrong": "bold red"}

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def doctor(
    *,
    as_json: AsJson = False,
    connect: Connect = "",
    world_name: WorldName = "default",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say only what is wrong.")] = False,
) -> None:
    """Say what is wrong when nothing answers, from the endpoint up to the robots."""
    with exit_on_failure("doctor"):
        check_name(world_name, "world name")
        found = list(examine(connect or DEFAULT_ENDPOINT, world_name, version("zensim")))
    shown = [one for one in found if one.mark == "wrong"] if quiet else found
    if as_json:
        typer.echo(msgspec.json.encode(shown).decode())
    elif shown:
        data_console.print(_table(shown))
    if (status := worst(found)) is not ExitCode.OK:
        raise typer.Exit(int(status))


def _table(findings: list[Finding]) -> Table:
    table = Table(box=None, show_header=False)
    for one in findings:
        advice = f"\n{one.advice}" if one.advice else ""
        table.add_row(Text(one.mark, STYLES[one.mark]), one.what, f"{one.found}{advice}")
    return table
