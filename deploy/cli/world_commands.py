"""`zensim world load`, `list`, `current`, `poses` and `unload`."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from zensim.deploy.cli.command_session import (
    complete_world_names,
    data_console,
    open_client,
    print_json,
    print_table,
)
from zensim.deploy.cli.terminal_output import print_report
from zensim.proto.bounded_files import read_text_file
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.entity_messages import TagsFilter
from zensim.proto.messages.world_messages import WorldResource
from zensim.proto.network_protocols import MAX_REQUEST_BYTES
from zensim.proto.options.command_options import ClientOptions, JsonOption, TimeoutOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.settings.path_completion import WORLD_SUFFIXES
from zensim.proto.verbosity import CURRENT
from zensim.spawner.spawn.spawn_poses import find_heading

app = make_app("world")


@dataclass(frozen=True, kw_only=True)
class LoadClientOptions(ClientOptions):
    """Client options with a timeout that suffices for hundreds of meshes."""

    timeout: TimeoutOption = 60.0


@app.command(
    "load",
    epilog="""Examples:
  zensim world load warehouse
  zensim world load ./my_world.sdf --strict""",
)
def load_world(
    world: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="World of the server, or path of an SDF file on this host.",
            autocompletion=complete_world_names,
        ),
    ],
    *,
    strict: Annotated[bool, flag("--strict", help="Fail if the world has warnings.")] = False,
    allow_missing: Annotated[
        bool, flag("--allow-missing", help="Leave out missing and unreadable models and meshes.")
    ] = False,
    as_json: JsonOption = False,
    server: LoadClientOptions,
) -> None:
    """Replace the current world, and delete all entities."""
    with exit_on_failure("world load"):
        text = _read_world_file(world)
    with open_client("world load", server) as client:
        before = client.info_when_restored().entities
        reply = client.load_world(
            "" if text else world, text, is_strict=strict, may_lack_assets=allow_missing
        )
    if as_json:
        print_json(reply)
        return
    fate = f"{before} entities deleted; " if before else ""
    print_lines(f"loaded {_label_world(reply.world)}; {fate}start it with 'zensim play'")
    print_report(reply.report, data_console)


def _read_world_file(word: str) -> str:
    """Read a world file of this host; empty if the word is a name for the server.

    Raises:
        OSError: The path cannot be read.
        ValueError: The file is not UTF-8.
    """
    path = Path(word)
    is_path = path.is_absolute() or word.startswith((f".{os.sep}", f"..{os.sep}", "~"))
    if is_path or (path.suffix in WORLD_SUFFIXES and path.is_file()):
        try:
            return read_text_file(path.expanduser(), MAX_REQUEST_BYTES)
        except UnicodeDecodeError as error:
            raise ValueError(f"{word} is not UTF-8: {error.reason}; use an SDF file") from error
    return ""


@app.command("list")
def list_worlds(*, as_json: JsonOption = False, server: ClientOptions) -> None:
    """List the worlds that the server can load."""
    with open_client("world list", server) as client:
        worlds = client.available_worlds()
    if as_json:
        print_json(worlds)
    elif CURRENT.is_quiet:
        print_lines("\n".join(map(_label_world, worlds)))
    else:
        print_table(_make_table(worlds))


@app.command("current")
def current_world(*, as_json: JsonOption = False, server: ClientOptions) -> None:
    """Print the name of the current world."""
    with open_client("world current", server) as client:
        world = client.current_world()
    if as_json:
        print_json(world)
    else:
        print_lines(_label_world(world))


@app.command("poses")
def named_poses(
    *,
    tag: Annotated[
        list[str] | None,
        typer.Option("--tag", metavar="TAG", help="Only poses with this tag; repeatable."),
    ] = None,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """List the named poses of the current world."""
    with open_client("world poses", server) as client:
        poses = client.named_poses(TagsFilter(tuple(tag or ())))
    if as_json:
        print_json(poses)
        return
    table = Table("name", "tags", "x [m]", "y [m]", "z [m]", "yaw [rad]", "what it is", box=None)
    for one in poses:
        position, yaw = one.pose.position, find_heading(one.pose.orientation)
        numbers = (f"{number:.3f}" for number in (position.x, position.y, position.z, yaw))
        table.add_row(one.name, ", ".join(one.tags) or "-", *numbers, one.description)
    print_table(table)


@app.command("unload")
def unload_world(*, as_json: JsonOption = False, server: ClientOptions) -> None:
    """Unload the current world, and delete all entities."""
    with open_client("world unload", server) as client:
        before = client.info_when_restored().entities
        client.unload_world()
    if as_json:
        print_json({"deleted": before})
    else:
        print_lines(f"unloaded; {before} entities deleted" if before else "unloaded")


def _label_world(world: WorldResource) -> str:
    """Choose the name to load a world by, or the name in the file if it was sent as text."""
    return world.world_resource.uri or world.name


def _make_table(worlds: Sequence[WorldResource]) -> Table:
    table = Table("name", "tags", "what it is", box=None)
    for world in worlds:
        table.add_row(_label_world(world), ", ".join(world.tags) or "-", world.description)
    return table
