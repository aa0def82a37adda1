"""`zensim spawn` and `zensim fleet`."""

from typing import Annotated

import msgspec
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from proto.exits import Exit, one_line_failures
from proto.geometry import PoseStamped
from proto.header import Header
from proto.names import check_name
from proto.result import ResultCode
from proto.services import Resource, SpawnEntityOrder, SpawnEntityReport
from spawner.cli.session import (
    AsJson,
    Connect,
    Timeout,
    WorldName,
    client_for,
    progress_console,
)
from spawner.launch import Outcome, pose_at, read_description, resource_for, spawn_fleet
from spawner.placement import LAYOUTS, fleet_places, name_stem

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

TRUE_WORDS, FALSE_WORDS = {"true", "1", "yes", "on"}, {"false", "0", "no", "off"}

# Spelt as the tutorial's spawner spells them, and as people write them.
Model = Annotated[str, typer.Argument(help="Shipped model, or path of a URDF file.")]
Urdf = Annotated[str, typer.Option("-urdf", "--robot_urdf", help="The same as MODEL.")]
Name = Annotated[str, typer.Option("-n", "--name", "--robot_name", help="The model's if none.")]
RobotNamespace = Annotated[
    str, typer.Option("-ns", "--robot_namespace", help="Namespace; the name unless given.")
]
Namespace = Annotated[
    str,
    typer.Option("-namespace", "--namespace", help="Namespace, or False for the entity's name."),
]
X = Annotated[float, typer.Option("-x", help="Metres.")]
Y = Annotated[float, typer.Option("-y", help="Metres.")]
Z = Annotated[float | None, typer.Option("-z", help="Metres; on the ground unless given.")]
Roll = Annotated[float, typer.Option("-R", help="Radians.")]
Pitch = Annotated[float, typer.Option("-P", help="Radians.")]
Yaw = Annotated[float, typer.Option("-Y", help="Radians.")]
Frame = Annotated[str, typer.Option("--reference-frame", help="Entity that the pose is in.")]
Renaming = Annotated[bool, typer.Option("--allow-renaming", help="Number the name if taken.")]
Wait = Annotated[float, typer.Option("--wait", help="Seconds to wait for a server.")]


@app.command()
def spawn(
    model: Model = "",
    *,
    robot_urdf: Urdf = "",
    name: Name = "",
    robot_namespace: RobotNamespace = "",
    namespace: Namespace = "",
    x: X = 0.0,
    y: Y = 0.0,
    z: Z = None,
    roll: Roll = 0.0,
    pitch: Pitch = 0.0,
    yaw: Yaw = 0.0,
    frame: Frame = "",
    allow_renaming: Renaming = False,
    wait: Wait = 10.0,
    timeout: Timeout = 10.0,
    as_json: AsJson = False,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Put one robot into the world."""
    with one_line_failures("spawn"):
        space = _namespace(robot_namespace, namespace)
        order = SpawnEntityOrder(
            check_name(name) if name else "",
            allow_renaming=allow_renaming or not name,
            entity_resource=_resource(model or robot_urdf, space or name),
            entity_namespace=space,
            initial_pose=PoseStamped(
                Header(frame_id=frame), pose_at((x, y, z or 0.0), (roll, pitch, yaw))
            ),
            snap_to_ground=z is None,
        )
    with client_for("spawn", connect, world_name, timeout, wait_s=wait) as client:
        client.wait_for_server(wait)
        _print_report(client.spawn(order), as_json=as_json)


def _namespace(robot_namespace: str, namespace: str) -> str:
    """Read `--namespace`: the tutorial's switch, or a namespace by itself."""
    word = namespace.lower()
    if word in FALSE_WORDS:
        return ""
    return robot_namespace if word in TRUE_WORDS or not namespace else namespace


def _resource(model: str, namespace: str) -> Resource:
    if not model:
        raise ValueError("no model was given; use 'zensim spawn box_bot' or a path of a URDF file")
    return resource_for(model, read_description(model), namespace)


def _print_report(report: SpawnEntityReport, *, as_json: bool) -> None:
    if as_json:
        typer.echo(msgspec.json.encode(report).decode())
    else:
        typer.echo(f"spawned {report.entity_name} under {report.entity_namespace}/")
    for entry in report.report:
        if entry.status == "suspicious":
            typer.echo(f"zensim spawn: warning: {entry.subject}: {entry.reason}", err=True)


@app.command()
def fleet(
    model: Model,
    *,
    count: Annotated[int, typer.Option("--count", "-c", min=1, help="How many.")] = 10,
    layout: Annotated[str, typer.Option(help="row, grid or circle.")] = "row",
    spacing: Annotated[float, typer.Option(help="Metres between neighbours.")] = 1.0,
    prefix: Annotated[str, typer.Option(help="Names are PREFIX0, PREFIX1, …")] = "",
    wait: Wait = 10.0,
    timeout: Timeout = 10.0,
    as_json: AsJson = False,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Put many robots into the world."""
    with one_line_failures("fleet"):
        if (shape := next((known for known in LAYOUTS if known == layout), None)) is None:
            raise ValueError(f"--layout {layout!r} is unknown; use {', '.join(LAYOUTS)}")
        places = fleet_places(prefix or name_stem(model), count, shape, spacing)
    with client_for("fleet", connect, world_name, timeout, wait_s=wait) as client:
        client.wait_for_server(wait)
        with fleet_progress() as progress:
            task = progress.add_task("spawning", total=len(places))
            outcomes = spawn_fleet(client, model, places, lambda _: progress.advance(task))
    _print_outcomes(outcomes, as_json=as_json)


def fleet_progress() -> Progress:
    """Make the progress bar of a fleet; silent when standard error is no terminal."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=progress_console,
        disable=not progress_console.is_terminal,
        transient=True,
    )


def _print_outcomes(outcomes: list[Outcome], *, as_json: bool) -> None:
    refused = [outcome for outcome in outcomes if outcome.code != ResultCode.OK]
    if as_json:
        typer.echo(msgspec.json.encode(outcomes).decode())
    else:
        typer.echo(f"spawned {len(outcomes) - len(refused)} of {len(outcomes)}")
    for outcome in refused:
        typer.echo(f"zensim fleet: {outcome.name}: {outcome.message}", err=True)
    if refused:
        raise typer.Exit(Exit.FAILED if len(refused) == len(outcomes) else Exit.PARTIAL)
