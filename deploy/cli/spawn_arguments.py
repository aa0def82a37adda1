"""Options of `zensim spawn` and `zensim fleet`, and the requests made from them."""

import os
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import msgspec
import typer

from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.messages.drive_messages import COMPATS
from zensim.proto.messages.model_messages import Dynamics
from zensim.proto.messages.spawn_messages import Compat, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Header, PoseStamped
from zensim.proto.names import check_name, check_namespace
from zensim.proto.options.command_options import (
    ClientOptions,
    JsonOption,
    flag,
    parse_choice,
    seconds,
)
from zensim.proto.settings.path_completion import complete_models
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
from zensim.spawner.spawn.spawn_poses import (
    LAYOUTS,
    RobotPlacement,
    derive_prefix,
    make_fleet_layout,
    make_pose,
)

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus


def complete_layouts(incomplete: str) -> list[str]:
    """Find the layouts that start with a text."""
    return [layout for layout in LAYOUTS if layout.startswith(incomplete)]


ModelArgument = Annotated[
    str,
    typer.Argument(
        metavar="MODEL",
        help="Built-in model, path of a URDF, xacro or SDF file, or - for standard input.",
        autocompletion=complete_models,
    ),
]
DynamicsOption = Annotated[
    str,
    typer.Option(
        "--dynamics",
        metavar="full|kinematic|auto",
        help="Motion model; auto = full only where contacts are possible.",
        show_default="that of the world",
    ),
]
layout_option = partial(
    typer.Option,
    "--layout",
    metavar="row|grid|circle",
    help="Arrangement of the robots.",
    autocompletion=complete_layouts,
)
LayoutOption = Annotated[str, layout_option()]
SpacingOption = Annotated[
    float, typer.Option("--spacing", metavar="METRES", help=r"Distance between neighbours \[m].")
]
_description = partial(typer.Option, rich_help_panel="Description")
_pose = partial(typer.Option, metavar="NUMBER", rich_help_panel="Pose")


ControllersOption = Annotated[
    list[Path] | None,
    _description(
        "--controllers",
        metavar="FILE",
        help="Parameters of ros2_controllers or ros_control (YAML); repeatable.",
        show_default="files that the description names",
    ),
]
DriveOption = Annotated[
    str,
    _description(
        "--drive",
        metavar="DRIVE",
        help="Drive: diff:LEFT,RIGHT, mecanum:…, omni:…, ackermann:…, bicycle:…, tricycle:…, "
        "planar or none; joints, then separation, diameter and wheelbase.",
        show_default="that of the description",
    ),
]


@dataclass(frozen=True, kw_only=True)
class WaitingClientOptions(ClientOptions):
    """Options of a client that waits for its server to start."""

    wait: Annotated[
        float,
        typer.Option(
            "--wait",
            metavar="SECONDS",
            help=r"Timeout of waiting for the server \[s].",
            rich_help_panel="Connection",
        ),
    ] = 10.0


@dataclass(frozen=True, kw_only=True)
class DescriptionOptions:
    """How a description and its files are read."""

    package_path: Annotated[
        list[Path] | None,
        _description(
            "--package-path",
            metavar="FOLDER",
            help="Folder with packages, models or meshes; repeatable.",
        ),
    ] = None
    xacro_arg: Annotated[
        list[str] | None,
        _description("--xacro-arg", metavar="KEY:=VALUE", help="xacro argument; repeatable."),
    ] = None
    allow_missing: Annotated[
        bool,
        flag(
            "--allow-missing",
            help="Leave out collisions whose mesh file is missing.",
            rich_help_panel="Description",
        ),
    ] = False
    strict: Annotated[
        bool,
        flag(
            "--strict",
            help="Fail if the report has suspicious entries.",
            rich_help_panel="Description",
        ),
    ] = False
    compat: Annotated[
        str,
        _description(
            "--compat",
            metavar="fixed|gazebo11",
            help="Behaviour of drives; gazebo11 = with the known faults of Gazebo 11.",
        ),
    ] = "fixed"
    controllers: ControllersOption = None
    drive: DriveOption = ""
    package_to_model: Annotated[
        bool, typer.Option("-package_to_model", "--package-to-model", hidden=True)
    ] = False


@dataclass(frozen=True, kw_only=True)
class EntityOptions:
    """Name, namespace and pose of an entity, and how it is spawned."""

    name: Annotated[
        str,
        typer.Option(
            "-n",
            "--name",
            "--robot_name",
            metavar="NAME",
            help="Name of the entity.",
            show_default="name of the model",
        ),
    ] = ""
    robot_namespace: Annotated[
        str,
        typer.Option(
            "-ns",
            "--robot_namespace",
            metavar="NAMESPACE",
            help="Prefix of topics and frames.",
            show_default="name of the entity",
        ),
    ] = ""
    namespace: Annotated[
        str,
        typer.Option(
            "-namespace",
            "--namespace",
            metavar="NAMESPACE|BOOL",
            help="Same as --robot_namespace; false = use the name of the entity.",
        ),
    ] = ""
    x: Annotated[float, _pose("-x", help=r"Position along x \[m].")] = 0.0
    y: Annotated[float, _pose("-y", help=r"Position along y \[m].")] = 0.0
    z: Annotated[
        float | None, _pose("-z", help=r"Position along z \[m].", show_default="on the ground")
    ] = None
    roll: Annotated[float, _pose("-R", "--roll", help=r"Roll \[rad].")] = 0.0
    pitch: Annotated[float, _pose("-P", "--pitch", help=r"Pitch \[rad].")] = 0.0
    yaw: Annotated[float, _pose("-Y", "--yaw", help=r"Yaw \[rad].")] = 0.0
    frame: Annotated[
        str,
        _pose(
            "--frame",
            metavar="ENTITY",
            help="Entity that the pose is relative to.",
            show_default="world",
        ),
    ] = ""
    snap_to_ground: Annotated[
        bool,
        flag("--snap-to-ground", help="Place on the ground, despite -z.", rich_help_panel="Pose"),
    ] = False
    dynamics: DynamicsOption = ""
    allow_renaming: Annotated[
        bool, flag("--allow-renaming", help="Append a number if the name is taken.")
    ] = False
    dry_run: Annotated[bool, flag("--dry-run", help="Check the request without spawning.")] = False
    bond: Annotated[
        bool, flag("-b", "--bond", help="Wait for Ctrl-C, and delete the entity at exit.")
    ] = False
    as_json: JsonOption = False


@dataclass(frozen=True, kw_only=True)
class GazeboOptions:
    """Further options of Gazebo's spawn_entity.py, in its spelling."""

    urdf: Annotated[
        str, _description("-urdf", "--robot_urdf", metavar="MODEL", help="Same as MODEL.")
    ] = ""
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
class SpawnOptions(WaitingClientOptions, DescriptionOptions, GazeboOptions, EntityOptions):
    """All options of `zensim spawn`."""

    model: ModelArgument = ""


@dataclass(frozen=True, kw_only=True)
class FleetOptions(WaitingClientOptions, DescriptionOptions):
    """All options of `zensim fleet`."""

    model: ModelArgument
    robots: Annotated[
        int, typer.Option("--robots", min=1, metavar="N", help="Number of robots.")
    ] = 10
    layout: LayoutOption = "row"
    spacing: SpacingOption = 1.0
    prefix: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Robots are named PREFIX0, PREFIX1, …",
            show_default="name of the model",
        ),
    ] = ""
    dynamics: DynamicsOption = ""
    partial: Annotated[
        bool, flag("--partial", help="Spawn as many as possible, instead of all or none.")
    ] = False
    wait_driven: Annotated[
        float,
        seconds(
            "--wait-driven",
            help=r"Wait until agents drive them, and fail after this time \[s]; 0 = do not wait.",
        ),
    ] = 0.0
    as_json: JsonOption = False


DYNAMICS: tuple[Dynamics, ...] = get_args(Dynamics)
STDIN = "-"
TRUE_WORDS, FALSE_WORDS = {"true", "1", "yes", "on"}, {"false", "0", "no", "off"}


class SpawnSource(msgspec.Struct, frozen=True):
    """Where a description comes from: an option or MODEL, and its value."""

    kind: str
    word: str = ""


def choose_source(given: SpawnOptions) -> SpawnSource:
    """Choose the only source of the description that is given.

    Raises:
        ValueError: No source or several sources are given.
    """
    options = {
        "MODEL": given.model,
        "-urdf": given.urdf,
        "-file": given.file,
        "-topic": given.topic,
        "-database": given.database,
        "-stdin": STDIN if given.stdin else "",
    }
    sources = [SpawnSource(kind, word) for kind, word in options.items() if word]
    if len(sources) == 1:
        return sources[0]
    if sources:
        kinds = " and ".join(source.kind for source in sources)
        raise ValueError(f"{kinds} exclude each other; give one of them")
    raise ValueError(
        "no model given; use a built-in model as in 'zensim spawn box_bot', the path of a URDF, "
        "xacro or SDF file, -file, -topic, -database or -stdin"
    )


def make_search_paths(given: DescriptionOptions) -> SearchPaths:
    """Collect the search paths of files.

    Raises:
        NotADirectoryError: A --package-path is not a folder.
    """
    paths = given.package_path or []
    for path in paths:
        if not path.is_dir():
            raise NotADirectoryError(20, "--package-path is not a folder", str(path))
    return collect_search_paths(paths, os.environ)


def read_local_description(
    source: SpawnSource, given: DescriptionOptions, paths: SearchPaths
) -> RobotDescription:
    """Read a description on this host; empty if it comes from a topic.

    Raises:
        OSError: The file cannot be read.
        ValueError: The description is not valid.
    """
    arguments = parse_xacro_arguments(given.xacro_arg or ())
    if source.kind == "-topic":
        return RobotDescription()
    if source.word == STDIN and source.kind in ("-stdin", "MODEL", "FILE"):
        description = read_description_stream(sys.stdin.buffer, arguments, paths)
    elif source.kind == "-database":
        description = find_model_by_name(source.word, arguments, paths)
    elif source.kind == "-file":
        description = read_description_file(Path(source.word), arguments, paths)
    else:
        description = read_model_argument(source.word, arguments, paths)
    return to_model_uris(description) if given.package_to_model else description


def make_spawn_order(given: SpawnOptions) -> SpawnEntityOrder:
    """Make an order from the options; it lacks the description.

    Raises:
        ValueError: An option is not valid.
    """
    if given.joint != ("", ""):
        raise ValueError(
            f"-J {given.joint[0]} {given.joint[1]}: initial joint positions are not supported; "
            "remove -J, which Gazebo ignores, too"
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
        drive=parse_drive_order(given.drive),
    )


def parse_compat(given: DescriptionOptions) -> Compat:
    """Parse `--compat`.

    Raises:
        ValueError: The word is unknown.
    """
    return parse_choice("--compat", given.compat, COMPATS)


def parse_dynamics(word: str) -> Dynamics:
    """Parse `--dynamics`; empty = that of the world.

    Raises:
        ValueError: The word is unknown.
    """
    return parse_choice("--dynamics", word, DYNAMICS)


def make_placements(
    model: str, count: int, layout: str, spacing_m: float, prefix: str = ""
) -> list[RobotPlacement]:
    """Make the names and poses of a fleet from command-line options.

    Raises:
        ValueError: An option is not valid.
    """
    shape = parse_choice("--layout", layout, LAYOUTS)
    names = check_name(prefix, "prefix") if prefix else derive_prefix(model)
    return make_fleet_layout(names, count, shape, spacing_m)


def choose_namespace(given: SpawnOptions) -> str:
    """Choose the namespace: `--namespace` is a namespace, or a boolean as in Gazebo tutorials.

    Raises:
        InvalidName: The namespace is not valid.
    """
    named = given.robot_namespace or given.gazebo_robot_namespace
    word = given.namespace.lower()
    if word in FALSE_WORDS:
        return ""
    space = named if word in TRUE_WORDS or not word else given.namespace
    return check_namespace(space) if space else ""


def read_topic_description(
    bus: "Bus", source: SpawnSource, given: SpawnOptions, timeout_s: float
) -> RobotDescription:
    """Receive a description from a topic.

    Raises:
        TimeoutError: No message arrived.
        ValueError: The message is not a description.
    """
    description = receive_description(bus, source.word, timeout_s)
    return to_model_uris(description) if given.package_to_model else description
