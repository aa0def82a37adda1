"""The options of `zensim spawn` and `zensim fleet`, and the checked requests made of them."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import msgspec
import typer

from zensim.proto.bus import Bus
from zensim.proto.messages.model_messages import Dynamics
from zensim.proto.messages.spawn_messages import Compat, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Header, PoseStamped
from zensim.proto.names import check_name, check_namespace
from zensim.spawner.cli.command_session import AsJson, Connect, Timeout, WorldName
from zensim.spawner.spawn.description_sources import (
    RobotDescription,
    find_model_by_name,
    parse_xacro_arguments,
    read_description_file,
    read_description_stream,
    read_model_argument,
    receive_description,
    to_model_uris,
)
from zensim.spawner.spawn.search_paths import SearchPaths, collect_search_paths
from zensim.spawner.spawn.spawn_client import make_pose

ModelArgument = Annotated[
    str, typer.Argument(help="Shipped model, path of a URDF, xacro or SDF file, or - for stdin.")
]
DynamicsOption = Annotated[
    str,
    typer.Option(
        "--dynamics",
        help="full, kinematic, or auto: full only where need be.",
        show_default="the world's",
    ),
]
WaitOption = Annotated[float, typer.Option("--wait", help="Seconds to wait for a server.")]


@dataclass(frozen=True, kw_only=True)
class NetworkOptions:
    """Which server, and how long to wait for it."""

    wait: WaitOption = 10.0
    timeout: Timeout = 10.0
    as_json: AsJson = False
    connect: Connect = ""
    world_name: WorldName = "default"


@dataclass(frozen=True, kw_only=True)
class DescriptionOptions:
    """How a description and its files are read."""

    package_path: Annotated[
        list[Path] | None,
        typer.Option("--package-path", help="Folder of packages, models or meshes; repeatable."),
    ] = None
    xacro_arg: Annotated[
        list[str] | None,
        typer.Option("--xacro-arg", help="key:=value for a xacro file; repeatable."),
    ] = None
    allow_missing: Annotated[
        bool, typer.Option("--allow-missing", help="Leave out collisions whose mesh is missing.")
    ] = False
    strict: Annotated[
        bool, typer.Option("--strict", help="Refuse what the report calls suspicious.")
    ] = False
    compat: Annotated[
        str,
        typer.Option("--compat", help="fixed, or gazebo11 for drives with GazeboOptions's quirks."),
    ] = "fixed"
    package_to_model: Annotated[
        bool, typer.Option("-package_to_model", "--package-to-model", hidden=True)
    ] = False


@dataclass(frozen=True, kw_only=True)
class PlacementOptions:
    """What the entity is called and where it stands."""

    name: Annotated[
        str, typer.Option("-n", "--name", "--robot_name", help="The model's if none.")
    ] = ""
    # Spelt as the tutorial's spawner spells them, and as people write them.
    robot_namespace: Annotated[
        str,
        typer.Option("-ns", "--robot_namespace", help="Namespace; the name unless given."),
    ] = ""
    namespace: Annotated[
        str,
        typer.Option(
            "-namespace", "--namespace", help="Namespace, or False for the entity's name."
        ),
    ] = ""
    x: Annotated[float, typer.Option("-x", help="Metres.")] = 0.0
    y: Annotated[float, typer.Option("-y", help="Metres.")] = 0.0
    z: Annotated[float | None, typer.Option("-z", help="Metres; on the ground unless given.")] = (
        None
    )
    roll: Annotated[float, typer.Option("-R", help="Radians.")] = 0.0
    pitch: Annotated[float, typer.Option("-P", help="Radians.")] = 0.0
    yaw: Annotated[float, typer.Option("-Y", help="Radians.")] = 0.0
    frame: Annotated[str, typer.Option("--reference-frame", help="Entity that the pose is in.")] = (
        ""
    )
    dynamics: DynamicsOption = ""
    allow_renaming: Annotated[
        bool, typer.Option("--allow-renaming", help="Number the name if taken.")
    ] = False
    snap_to_ground: Annotated[
        bool, typer.Option("--snap-to-ground", help="Onto the ground, whatever -z is.")
    ] = False
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check everything and spawn nothing.")
    ] = False
    bond: Annotated[
        bool, typer.Option("-b", "--bond", help="Stay, and take the entity along at the end.")
    ] = False


@dataclass(frozen=True, kw_only=True)
class GazeboOptions:
    """What else spawn_entity.py is told, in its spelling."""

    urdf: Annotated[str, typer.Option("-urdf", "--robot_urdf", help="The same as MODEL.")] = ""
    entity: Annotated[str, typer.Option("-entity", hidden=True)] = ""
    file: Annotated[str, typer.Option("-file", hidden=True)] = ""
    topic: Annotated[str, typer.Option("-topic", hidden=True)] = ""
    database: Annotated[str, typer.Option("-database", hidden=True)] = ""
    stdin: Annotated[bool, typer.Option("-stdin", hidden=True)] = False
    gazebo_robot_namespace: Annotated[str, typer.Option("-robot_namespace", hidden=True)] = ""
    gazebo_namespace: Annotated[str, typer.Option("-gazebo_namespace", hidden=True)] = ""
    gazebo_timeout: Annotated[
        float | None, typer.Option("-timeout", "-spawn_service_timeout", hidden=True)
    ] = None
    unpause: Annotated[bool, typer.Option("-unpause", "--unpause", hidden=True)] = False
    wait_entity: Annotated[str, typer.Option("-wait", hidden=True)] = ""
    reference_frame: Annotated[str, typer.Option("-reference_frame", hidden=True)] = ""
    joint: Annotated[tuple[str, str], typer.Option("-J", hidden=True)] = ("", "")


@dataclass(frozen=True, kw_only=True)
class SpawnOptions(NetworkOptions, DescriptionOptions, GazeboOptions, PlacementOptions):
    """All options of `zensim spawn`."""

    model: ModelArgument = ""


@dataclass(frozen=True, kw_only=True)
class FleetOptions(NetworkOptions, DescriptionOptions):
    """All options of `zensim fleet`."""

    model: ModelArgument
    count: Annotated[int, typer.Option("--count", "-c", min=1, help="How many.")] = 10
    layout: Annotated[str, typer.Option(help="row, grid or circle.")] = "row"
    spacing: Annotated[float, typer.Option(help="Metres between neighbours.")] = 1.0
    prefix: Annotated[str, typer.Option(help="Names are PREFIX0, PREFIX1, …")] = ""
    dynamics: DynamicsOption = ""
    partial: Annotated[
        bool, typer.Option("--partial", help="Spawn those that can be, not all or none.")
    ] = False


COMPATS: tuple[Compat, ...] = get_args(Compat)
DYNAMICS: tuple[Dynamics, ...] = get_args(Dynamics)
STDIN = "-"
TRUE_WORDS, FALSE_WORDS = {"true", "1", "yes", "on"}, {"false", "0", "no", "off"}


class SpawnSource(msgspec.Struct, frozen=True):
    """The one place that a description comes from."""

    kind: str
    word: str = ""


def choose_source(given: SpawnOptions) -> SpawnSource:
    """Tell where the description comes from.

    Raises:
        ValueError: From nowhere, or from two places.
    """
    named = {
        "MODEL": given.model,
        "-urdf": given.urdf,
        "-file": given.file,
        "-topic": given.topic,
        "-database": given.database,
        "-stdin": STDIN if given.stdin else "",
    }
    sources = [SpawnSource(kind, word) for kind, word in named.items() if word]
    if len(sources) == 1:
        return sources[0]
    if sources:
        kinds = " and ".join(source.kind for source in sources)
        raise ValueError(f"{kinds} exclude one another; give one")
    raise ValueError(
        "no model was given; use 'zensim spawn box_bot', a path of a URDF or SDF file, "
        "-file, -topic, -database or -stdin"
    )


def make_search_paths(given: DescriptionOptions) -> SearchPaths:
    """Collect where to look for files.

    Raises:
        NotADirectoryError: A --package-path is no folder.
    """
    named = given.package_path or []
    for path in named:
        if not path.is_dir():
            raise NotADirectoryError(20, "--package-path is no folder", str(path))
    return collect_search_paths(named, os.environ)


def read_local_description(
    source: SpawnSource, given: DescriptionOptions, paths: SearchPaths
) -> RobotDescription:
    """Read a description on this host; empty when it comes from the network.

    Raises:
        OSError: There is no such file.
        ValueError: It cannot be read.
    """
    arguments = parse_xacro_arguments(given.xacro_arg or ())
    if source.kind == "-topic":
        return RobotDescription()
    if source.word == STDIN and source.kind in ("-stdin", "MODEL", "FILE"):
        found = read_description_stream(sys.stdin.buffer, arguments, paths)
    elif source.kind == "-database":
        found = find_model_by_name(source.word, arguments, paths)
    elif source.kind == "-file":
        found = read_description_file(Path(source.word), arguments, paths)
    else:
        found = read_model_argument(source.word, arguments, paths)
    return to_model_uris(found) if given.package_to_model else found


def make_spawn_order(given: SpawnOptions) -> SpawnEntityOrder:
    """Put the options into an order that lacks the description.

    Raises:
        ValueError: One cannot be had.
    """
    if given.joint != ("", ""):
        raise ValueError(
            f"-J {given.joint[0]} {given.joint[1]}: initial joint positions are not supported, "
            "nor are they by Gazebo; leave -J out"
        )
    name = given.name or given.entity
    frame = given.reference_frame or given.frame
    pose = make_pose((given.x, given.y, given.z or 0.0), (given.roll, given.pitch, given.yaw))
    return SpawnEntityOrder(
        check_name(name) if name else "",
        allow_renaming=given.allow_renaming or not name,
        entity_namespace=choose_namespace(given),
        initial_pose=PoseStamped(Header(frame_id=frame), pose),
        snap_to_ground=given.z is None or given.snap_to_ground,
        dry_run=given.dry_run,
        strict=given.strict,
        allow_missing=given.allow_missing,
        compat=parse_compat(given),
        dynamics=parse_dynamics(given.dynamics),
    )


def parse_compat(given: DescriptionOptions) -> Compat:
    """Read `--compat`.

    Raises:
        ValueError: It is none.
    """
    for known in COMPATS:
        if given.compat == known:
            return known
    raise ValueError(f"--compat {given.compat[:40]!r} is unknown; use {' or '.join(COMPATS)}")


def parse_dynamics(word: str) -> Dynamics:
    """Read `--dynamics`; empty = as the world is.

    Raises:
        ValueError: It is none.
    """
    for known in DYNAMICS:
        if word == known:
            return known
    kinds = ", ".join(known for known in DYNAMICS if known)
    raise ValueError(f"--dynamics {word[:40]!r} is unknown; use {kinds}")


def choose_namespace(given: SpawnOptions) -> str:
    """Read `--namespace`: the tutorial's switch, or a namespace by itself.

    Raises:
        InvalidName: It is none.
    """
    named = given.robot_namespace or given.gazebo_robot_namespace
    word = given.namespace.lower()
    if word in FALSE_WORDS:
        return ""
    space = named if word in TRUE_WORDS or not word else given.namespace
    return check_namespace(space) if space else ""


def read_topic_description(
    bus: Bus, source: SpawnSource, given: SpawnOptions, timeout_s: float
) -> RobotDescription:
    """Read a description from the network.

    Raises:
        TimeoutError: None came.
        ValueError: What came is none.
    """
    found = receive_description(bus, source.word, timeout_s)
    return to_model_uris(found) if given.package_to_model else found
