"""The options of `zensim spawn` and `zensim fleet`, in groups."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from zensim.spawner.cli.session import AsJson, Connect, Timeout, WorldName

Model = Annotated[
    str, typer.Argument(help="Shipped model, path of a URDF, xacro or SDF file, or - for stdin.")
]
Dynamics = Annotated[
    str,
    typer.Option(
        "--dynamics",
        help="full, kinematic, or auto: full only where need be.",
        show_default="the world's",
    ),
]
Wait = Annotated[float, typer.Option("--wait", help="Seconds to wait for a server.")]


@dataclass(frozen=True, kw_only=True)
class Network:
    """Which server, and how long to wait for it."""

    wait: Wait = 10.0
    timeout: Timeout = 10.0
    as_json: AsJson = False
    connect: Connect = ""
    world_name: WorldName = "default"


@dataclass(frozen=True, kw_only=True)
class Reading:
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
        str, typer.Option("--compat", help="fixed, or gazebo11 for drives with Gazebo's quirks.")
    ] = "fixed"
    package_to_model: Annotated[
        bool, typer.Option("-package_to_model", "--package-to-model", hidden=True)
    ] = False


@dataclass(frozen=True, kw_only=True)
class Placing:
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
    dynamics: Dynamics = ""
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
class Gazebo:
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
class SpawnOptions(Network, Reading, Gazebo, Placing):
    """All options of `zensim spawn`."""

    model: Model = ""


@dataclass(frozen=True, kw_only=True)
class FleetOptions(Network, Reading):
    """All options of `zensim fleet`."""

    model: Model
    count: Annotated[int, typer.Option("--count", "-c", min=1, help="How many.")] = 10
    layout: Annotated[str, typer.Option(help="row, grid or circle.")] = "row"
    spacing: Annotated[float, typer.Option(help="Metres between neighbours.")] = 1.0
    prefix: Annotated[str, typer.Option(help="Names are PREFIX0, PREFIX1, …")] = ""
    dynamics: Dynamics = ""
    partial: Annotated[
        bool, typer.Option("--partial", help="Spawn those that can be, not all or none.")
    ] = False
