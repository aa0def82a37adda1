"""`zensim list`, `inspect` and `delete`."""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import msgspec
import typer
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from zensim.deploy.cli.command_session import (
    EntityName,
    complete_entity_names,
    data_console,
    open_client,
    print_json,
    print_table,
)
from zensim.deploy.cli.info_options import CATEGORIES, format_category, make_filters
from zensim.deploy.cli.state_options import FrameOption
from zensim.deploy.cli.terminal_output import print_report
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.exit_codes import ExitCode, choose_exit_code, exit_on_failure, print_failure
from zensim.proto.messages.entity_messages import Bounds, BoundsType, EntityFilters
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.standard_messages import NANOSECONDS, ns_from_time
from zensim.proto.options.command_options import ClientOptions, JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.verbosity import CURRENT, print_note
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.spawn_poses import find_heading

app = make_app()

COLUMNS = ("name", "namespace", "agent", "x [m]", "y [m]", "z [m]", "yaw [rad]", "status")
FALLING = "falls out of the world"
WATCH_TIMEOUT_S = 2.0
"""Longest service timeout while watching, so that a lost server shows soon."""


class ListedEntity(msgspec.Struct, frozen=True):
    """One row of the list; position [m] and yaw [rad] in the world frame."""

    name: str
    namespace: str
    agent: str
    x: float
    y: float
    z: float
    yaw: float
    status: str = ""
    """Empty, or what is wrong with it."""


class EntityListing(msgspec.Struct, frozen=True):
    """All rows, read at one step."""

    rows: tuple[ListedEntity, ...]
    sim_time_s: float | None
    """None if there are no rows."""


FetchListing = Callable[[], EntityListing]
ShowListing = Callable[[EntityListing], None]


@dataclass(frozen=True, kw_only=True)
class FilterOptions:
    """Which entities to list."""

    pattern: Annotated[
        str,
        typer.Option(
            "--filter", metavar="REGEX", help="Only names that contain a match of this expression."
        ),
    ] = ""
    category: Annotated[
        list[str] | None,
        typer.Option(
            "--category",
            metavar="CATEGORY",
            help=f"Only entities of this category: {CATEGORIES}; repeatable.",
        ),
    ] = None
    tag: Annotated[
        list[str] | None,
        typer.Option("--tag", metavar="TAG", help="Only entities with this tag; repeatable."),
    ] = None


@app.command(
    "list",
    epilog="""Examples:
  zensim list
  zensim list --filter '^box_bot' --category robot --json
  zensim list --watch --every 1""",
)
def list_entities(
    *,
    filtering: FilterOptions,
    watch: Annotated[bool, flag("--watch", "-w", help="Repeat until Ctrl-C.")] = False,
    every: Annotated[
        float,
        typer.Option(min=0.05, max=3600.0, metavar="SECONDS", help=r"Period of --watch \[s]."),
    ] = 0.5,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """List entities.

    Filters of different kinds must all match; of several categories or tags, one must match.
    """
    with exit_on_failure("list"):
        filters = make_filters(filtering.pattern, filtering.category or (), filtering.tag or ())
    if watch:
        server = replace(server, timeout=min(server.timeout, WATCH_TIMEOUT_S))
    with open_client("list", server) as client:
        fetch = partial(fetch_listing, client, filters)
        show = _print_json_rows if as_json else _print_rows
        if not watch:
            show(fetch())
        elif as_json or not data_console.is_terminal:
            _poll_listing(fetch, show, _print_silence, every)
        else:
            _redraw_live(fetch, every)


def fetch_listing(client: SimClient, filters: EntityFilters) -> EntityListing:
    """Fetch the poses, namespaces and agents of the entities that pass the filters."""
    states = client.entity_states(filters)
    if not states:
        return EntityListing((), None)
    # Fetched second: an entity that was deleted in between is left out.
    models = {model.entity: model for model in client.models().entities}
    rows = tuple(
        ListedEntity(
            name,
            models[name].namespace,
            models[name].agent,
            (position := state.pose.position).x,
            position.y,
            position.z,
            find_heading(state.pose.orientation),
            FALLING if models[name].is_falling else "",
        )
        for name, state in states.items()
        if name in models
    )
    (first, *_) = states.values()
    return EntityListing(rows, ns_from_time(first.header.stamp) / NANOSECONDS)


def _poll_listing(
    fetch: FetchListing, show: ShowListing, on_silence: Callable[[], None], period_s: float
) -> None:
    """Fetch forever; after the first reply, a server may be lost and come back."""
    show(fetch())
    is_connected = True
    while True:
        time.sleep(period_s)
        try:
            listing = fetch()
        except (NoServer, TimeoutError):
            if is_connected:
                on_silence()
            is_connected = False
        else:
            is_connected = True
            show(listing)


def _redraw_live(fetch: FetchListing, period_s: float) -> None:
    last: list[EntityListing] = []
    with Live(console=data_console, auto_refresh=False) as live:

        def show(listing: EntityListing) -> None:
            last[:] = [listing]
            live.update(Group(_make_table(listing), _make_footer(listing)), refresh=True)

        def show_silence() -> None:
            note = Text("no server replies; this is the last known state", "bold yellow")
            live.update(Group(_make_table(last[0]), note), refresh=True)

        _poll_listing(fetch, show, show_silence, period_s)


def _print_silence() -> None:
    print_note("list", "no server replies; waiting for one")


def _print_json_rows(listing: EntityListing) -> None:
    print_json(listing.rows)


def _print_rows(listing: EntityListing) -> None:
    if CURRENT.is_quiet:
        for row in listing.rows:
            print_lines(row.name)
        return
    print_table(_make_table(listing))


def _make_footer(listing: EntityListing) -> Text:
    when = "" if listing.sim_time_s is None else f" at {listing.sim_time_s:.2f} s"
    noun = "entity" if len(listing.rows) == 1 else "entities"
    return Text(f"{len(listing.rows)} {noun}{when}; Ctrl-C to exit", "dim")


def _make_table(listing: EntityListing) -> Table:
    table = Table(*COLUMNS[:3], box=None)
    for title in COLUMNS[3:-1]:
        table.add_column(title, justify="right")
    table.add_column(COLUMNS[-1])
    for row in listing.rows:
        numbers = (f"{number:.3f}" for number in (row.x, row.y, row.z, row.yaw))
        table.add_row(row.name, row.namespace, row.agent or "-", *numbers, row.status)
    return table


@app.command()
def inspect(
    name: EntityName, *, frame: FrameOption = "", as_json: JsonOption = False, server: ClientOptions
) -> None:
    """Show pose, category, bounds, agent, links, joints and spawn report of an entity."""
    with open_client("inspect", server) as client:
        models = client.models((name,))
        model, entity = models.models[0], models.entities[0]
        facts = {**_fetch_pose(client, name, frame), **_fetch_info(client, name)}
    facts.update(
        namespace=entity.namespace,
        agent=entity.agent,
        model=model.name,
        mass_kg=model.mass_kg,
        links=[link.name for link in model.links],
        joints=[joint.name for joint in model.joints],
        drive=msgspec.to_builtins(model.drive),
    )
    if as_json:
        print_json({**facts, "report": msgspec.to_builtins(model.report)})
        return
    drive = (facts["drive"] or {}).get("kind")
    for key, value in {**facts, "drive": drive}.items():
        print_lines(f"{key}: {_format_value(value)}")
    print_report(model.report, data_console)


def _fetch_pose(client: SimClient, name: str, frame: str) -> dict[str, Any]:
    state = client.entity_state(name, frame)
    position = state.pose.position
    return {
        "name": name,
        "x": position.x,
        "y": position.y,
        "z": position.z,
        "yaw": find_heading(state.pose.orientation),
        "twist": msgspec.to_builtins(state.twist),
    }


def _fetch_info(client: SimClient, name: str) -> dict[str, Any]:
    info, bounds = client.entity_info(name), client.entity_bounds(name)
    return {
        "category": format_category(info.category),
        "tags": info.tags,
        "description": info.description,
        "bounds": _to_corners(bounds),
    }


def _to_corners(bounds: Bounds) -> dict[str, list[float]] | None:
    """Convert a box to its corners [m], in the frame of the base link."""
    if bounds.type != BoundsType.BOX:
        return None
    upper, lower = ([point.x, point.y, point.z] for point in bounds.points)
    return {"lower": lower, "upper": upper}


def _format_value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return "  ".join(f"{key} {_format_value(part)}" for key, part in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_format_value, value)) or "-"
    return "-" if value in (None, "") else str(value)


class NoMatch(Exception):
    """No entity has a name that matches."""

    code = ResultCode.NOT_FOUND


class DeletionOutcome(msgspec.Struct, frozen=True):
    """Result of one deletion."""

    name: str
    code: int = ResultCode.OK
    message: str = ""


@app.command(
    epilog="""Examples:
  zensim delete r1 r2
  zensim delete --filter '^box_bot'
  zensim delete --all --yes"""
)
def delete(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME", help="Entities to delete.", autocompletion=complete_entity_names
        ),
    ] = None,
    *,
    everything: Annotated[bool, flag("--all", help="Delete all entities.")] = False,
    pattern: Annotated[
        str,
        typer.Option(
            "--filter",
            metavar="REGEX",
            help="Delete the entities whose names contain a match of this expression.",
        ),
    ] = "",
    yes: Annotated[bool, flag("--yes", "-y", help="Do not ask for confirmation of --all.")] = False,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Delete entities: by name, by a filter of names, or all of them."""
    with exit_on_failure("delete"):
        if sum(map(bool, (names, everything, pattern))) != 1:
            raise ValueError("give names, --filter REGEX or --all; one of them")
    with open_client("delete", server) as client:
        names = list(dict.fromkeys(names or ()))
        if not names:
            names = list(client.entities(EntityFilters(pattern)))
            if everything and names and not yes:
                _confirm(len(names))
        failures = _delete_each(client, names, as_json=as_json)
    if pattern and not names:
        with exit_on_failure("delete", NoMatch):
            raise NoMatch(f"no name matches {pattern!r}; 'zensim list' lists all")
    if failures:
        raise typer.Exit(_choose_status(failures, len(names)))


def _choose_status(failures: Sequence[ServiceError], count: int) -> ExitCode:
    """Choose the exit status: partial, or the one that all failures share."""
    if len(failures) < count:
        return ExitCode.PARTIAL
    statuses = {choose_exit_code(error) for error in failures}
    return statuses.pop() if len(statuses) == 1 else ExitCode.FAILED


def _confirm(count: int) -> None:
    """Ask for confirmation on a terminal only."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return
    try:
        is_confirmed = typer.confirm(f"Delete all {count} entities?", err=True)
    except typer.Abort:
        raise KeyboardInterrupt from None
    if not is_confirmed:
        print_lines("nothing was deleted", err=True)
        raise typer.Exit(ExitCode.FAILED)


def _delete_each(client: SimClient, names: Sequence[str], *, as_json: bool) -> list[ServiceError]:
    """Delete entities one after another, print each result, and return the failures."""
    outcomes, failures = [], []
    for name in names:
        if (error := _try_delete(client, name)) is not None:
            failures.append(error)
            outcomes.append(DeletionOutcome(name, error.code, error.message))
            print_failure("delete", error)
        else:
            outcomes.append(DeletionOutcome(name))
            if not as_json:
                print_lines(f"deleted {name}")
    if as_json:
        print_json(outcomes)
    return failures


def _try_delete(client: SimClient, name: str) -> ServiceError | None:
    try:
        client.delete(name)
    except ServiceError as error:
        return error
    return None
