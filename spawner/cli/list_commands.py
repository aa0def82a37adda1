"""`zensim list`."""

import time
from collections.abc import Callable
from functools import partial
from typing import Annotated

import msgspec
import typer
from msgspec.structs import astuple
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from zensim.proto.bus import NoServer
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.entity_messages import EntityFilters
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time
from zensim.proto.rigid_transforms import find_yaw
from zensim.spawner.cli.command_session import (
    AsJson,
    Connect,
    Timeout,
    WorldName,
    data_console,
    open_client,
    print_table,
)
from zensim.spawner.cli.info_commands import make_filters
from zensim.spawner.client.sim_client import SimClient

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

COLUMNS = ("name", "namespace", "agent", "x [m]", "y [m]", "yaw [rad]")
WATCH_TIMEOUT_S = 2.0
"""Of a call while watching: who watches wants to see soon that nobody answers."""


class ListedEntity(msgspec.Struct, frozen=True):
    """One entity as a line."""

    name: str
    namespace: str
    agent: str
    x: float
    y: float
    z: float
    yaw: float


class EntityListing(msgspec.Struct, frozen=True):
    """All lines, of one step; the simulation time [s] is None when there are none."""

    rows: tuple[ListedEntity, ...]
    sim_time_s: float | None


FetchListing = Callable[[], EntityListing]
ShowListing = Callable[[EntityListing], None]


@app.command("list")
def list_entities(
    *,
    pattern: Annotated[
        str, typer.Option("--filter", metavar="REGEX", help="Found anywhere in the name.")
    ] = "",
    category: Annotated[
        list[str] | None, typer.Option("--category", help="robot, object, …; repeatable: any.")
    ] = None,
    tag: Annotated[list[str] | None, typer.Option("--tag", help="Repeatable: any of them.")] = None,
    watch: Annotated[bool, typer.Option("--watch", "-w", help="Go on until Ctrl-C.")] = False,
    every: Annotated[
        float, typer.Option(min=0.05, max=3600.0, help="Seconds between looks.")
    ] = 0.5,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """List the entities of the world, all of them or those that pass every filter."""
    with exit_on_failure("list"):
        filters = make_filters(pattern, category or (), tag or ())
    timeout = min(timeout, WATCH_TIMEOUT_S) if watch else timeout
    with open_client("list", connect, world_name, timeout) as client:
        ask = partial(fetch_listing, client, filters)
        show = _print_json if as_json else _print_table
        if not watch:
            show(ask())
        elif as_json or not data_console.is_terminal:
            _poll_listing(ask, show, _note_silence, every)
        else:
            _redraw_live(ask, every)


def fetch_listing(client: SimClient, filters: EntityFilters) -> EntityListing:
    """Ask where entities are, and who drives them."""
    states = client.entity_states(filters)
    if not states:
        return EntityListing((), None)
    # Asked second: of what has gone in between there is nothing to tell.
    models = {model.entity: model for model in client.models().entities}
    rows = tuple(
        ListedEntity(
            name,
            models[name].namespace,
            models[name].agent,
            (place := state.pose.position).x,
            place.y,
            place.z,
            find_yaw(astuple(state.pose.orientation), FLOAT_MATH),
        )
        for name, state in states.items()
        if name in models
    )
    (first, *_) = states.values()
    return EntityListing(rows, ns_from_time(first.header.stamp) / NANOSECONDS)


def _poll_listing(
    ask: FetchListing, show: ShowListing, note: Callable[[], None], every_s: float
) -> None:
    """Ask for ever; a server that went away after the first answer may come back."""
    show(ask())
    was_there = True
    while True:
        time.sleep(every_s)
        try:
            found = ask()
        except (NoServer, TimeoutError):
            if was_there:
                note()
            was_there = False
        else:
            was_there = True
            show(found)


def _redraw_live(ask: FetchListing, every_s: float) -> None:
    shown: list[EntityListing] = []
    with Live(console=data_console, auto_refresh=False) as live:

        def show(found: EntityListing) -> None:
            shown[:] = [found]
            live.update(Group(_listing_table(found), _footer(found)), refresh=True)

        def note() -> None:
            silence = Text("no server answers; this is the last that was heard", "bold yellow")
            live.update(Group(_listing_table(shown[0]), silence), refresh=True)

        _poll_listing(ask, show, note, every_s)


def _note_silence() -> None:
    typer.echo("zensim list: note: no server answers; waiting for it", err=True)


def _print_json(found: EntityListing) -> None:
    typer.echo(msgspec.json.encode(found.rows).decode())


def _print_table(found: EntityListing) -> None:
    print_table(_listing_table(found))


def _footer(found: EntityListing) -> Text:
    when = "" if found.sim_time_s is None else f" at {found.sim_time_s:.2f} s"
    noun = "entity" if len(found.rows) == 1 else "entities"
    return Text(f"{len(found.rows)} {noun}{when}; Ctrl-C ends", "dim")


def _listing_table(found: EntityListing) -> Table:
    table = Table(*COLUMNS[:3], box=None)
    for title in COLUMNS[3:]:
        table.add_column(title, justify="right")
    for row in found.rows:
        numbers = (f"{number:.3f}" for number in (row.x, row.y, row.yaw))
        table.add_row(row.name, row.namespace, row.agent or "-", *numbers)
    return table
