"""`zensim world load`, `list`, `current`, `poses` and `unload`."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from msgspec.structs import astuple
from rich.table import Table

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.entity_messages import TagsFilter
from zensim.proto.messages.world_messages import WorldResource
from zensim.proto.rigid_transforms import find_yaw
from zensim.spawner.cli.command_session import (
    AsJson,
    Connect,
    Timeout,
    WorldName,
    complete_world_names,
    data_console,
    open_client,
    print_table,
)
from zensim.spawner.cli.terminal_output import print_report

app = typer.Typer(
    name="world", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)

LOAD_TIMEOUT_S = 60.0
"""A world may have hundreds of meshes to read."""
WORLD_SUFFIXES = (".world", ".sdf", ".xml")


@app.command("load")
def load_world(
    world: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="World that the server knows, or an SDF file of this host.",
            autocompletion=complete_world_names,
        ),
    ],
    *,
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse what is not carried out.")
    ] = False,
    allow_missing: Annotated[
        bool, typer.Option("--allow-missing", help="Leave out what is missing or unreadable.")
    ] = False,
    as_json: AsJson = False,
    timeout: Timeout = LOAD_TIMEOUT_S,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Put another world in the place of this one, which goes with everything in it."""
    with exit_on_failure("world load"):
        text = _read_world_file(world)
    with open_client("world load", connect, world_name, timeout) as client:
        loaded = client.load_world(
            "" if text else world, text, is_strict=strict, may_lack_assets=allow_missing
        )
    if as_json:
        typer.echo(msgspec.json.encode(loaded).decode())
        return
    typer.echo(f"loaded {_label_world(loaded.world)}; 'zensim play' lets time run")
    print_report(loaded.report, data_console)


def _read_world_file(word: str) -> str:
    """Read a file of this host; empty when the word is a name for the server.

    Raises:
        OSError: It is a path, and cannot be read.
        ValueError: It is no text.
    """
    path = Path(word)
    is_path = path.is_absolute() or word.startswith((f".{os.sep}", f"..{os.sep}", "~"))
    if is_path or (path.suffix in WORLD_SUFFIXES and path.is_file()):
        try:
            return path.expanduser().read_text(encoding="utf-8")
        except UnicodeDecodeError as error:
            raise ValueError(f"{word} is no text: {error.reason}; use an SDF file") from error
    return ""


@app.command("list")
def list_worlds(
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """List the worlds that the server can load."""
    with open_client("world list", connect, world_name, timeout) as client:
        found = client.available_worlds()
    if as_json:
        typer.echo(msgspec.json.encode(found).decode())
    else:
        print_table(_worlds_table(found))


@app.command("current")
def current_world(
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Tell which world is there."""
    with open_client("world current", connect, world_name, timeout) as client:
        found = client.current_world()
    if as_json:
        typer.echo(msgspec.json.encode(found).decode())
    else:
        typer.echo(_label_world(found))


@app.command("poses")
def named_poses(
    *,
    tag: Annotated[list[str] | None, typer.Option("--tag", help="Repeatable: any of them.")] = None,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """List the named poses of the world: where robots may be put."""
    with open_client("world poses", connect, world_name, timeout) as client:
        found = client.named_poses(TagsFilter(tuple(tag or ())))
    if as_json:
        typer.echo(msgspec.json.encode(found).decode())
        return
    table = Table("name", "tags", "x [m]", "y [m]", "z [m]", "yaw [rad]", "what it is", box=None)
    for one in found:
        place, yaw = one.pose.position, find_yaw(astuple(one.pose.orientation), FLOAT_MATH)
        numbers = (f"{number:.3f}" for number in (place.x, place.y, place.z, yaw))
        table.add_row(one.name, ", ".join(one.tags) or "-", *numbers, one.description)
    print_table(table)


@app.command("unload")
def unload_world(
    *,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Take the world away with everything in it; another can be loaded then."""
    with open_client("world unload", connect, world_name, timeout) as client:
        client.unload_world()
    typer.echo("unloaded")


def _label_world(world: WorldResource) -> str:
    """Name a world as it is loaded, or as it names itself when it came as text."""
    return world.world_resource.uri or world.name


def _worlds_table(worlds: Sequence[WorldResource]) -> Table:
    table = Table("name", "tags", "what it is", box=None)
    for world in worlds:
        table.add_row(_label_world(world), ", ".join(world.tags) or "-", world.description)
    return table
