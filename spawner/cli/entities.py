"""`zensim spawn`, `fleet`, `list`, `delete`, `inspect`."""

import math
from typing import Annotated

import msgspec
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from proto.exits import Exit, one_line_failures
from proto.geometry import PoseStamped
from proto.header import Header
from proto.names import check_name
from proto.result import ResultCode
from proto.services import EntityState, SpawnEntityOrder, SpawnEntityReport
from proto.telemetry import EntityModel
from spawner.cli.session import (
    AsJson,
    Connect,
    Timeout,
    WorldName,
    client_for,
    data_console,
    progress_console,
)
from spawner.client import SimClient
from spawner.launch import Outcome, pose_at, read_description, resource_for, spawn_fleet
from spawner.placement import LAYOUTS, fleet_places, name_stem

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

TRUE_WORDS, FALSE_WORDS = {"true", "1", "yes", "on"}, {"false", "0", "no", "off"}


@app.command()
def spawn(
    model: Annotated[str, typer.Argument(help="Shipped model, or path of a URDF file.")] = "",
    *,
    robot_urdf: Annotated[
        str, typer.Option("-urdf", "--robot_urdf", help="The same as MODEL.")
    ] = "",
    name: Annotated[str, typer.Option("-n", "--name", "--robot_name")] = "",
    robot_namespace: Annotated[
        str, typer.Option("-ns", "--robot_namespace", help="Namespace; the name unless given.")
    ] = "",
    namespace: Annotated[
        str,
        typer.Option(
            "-namespace", "--namespace", help="Namespace, or False for the entity's name."
        ),
    ] = "",
    x: Annotated[float, typer.Option("-x", help="Metres.")] = 0.0,
    y: Annotated[float, typer.Option("-y", help="Metres.")] = 0.0,
    z: Annotated[float, typer.Option("-z", help="Metres; on the ground unless given.")] = math.nan,
    roll: Annotated[float, typer.Option("-R", help="Radians.")] = 0.0,
    pitch: Annotated[float, typer.Option("-P", help="Radians.")] = 0.0,
    yaw: Annotated[float, typer.Option("-Y", help="Radians.")] = 0.0,
    reference_frame: Annotated[str, typer.Option(help="Entity that the pose is relative to.")] = "",
    allow_renaming: Annotated[
        bool, typer.Option("--allow-renaming", help="Number the name if it is taken.")
    ] = False,
    wait: Annotated[float, typer.Option(help="Seconds to wait for a server.")] = 10.0,
    timeout: Timeout = 10.0,
    as_json: AsJson = False,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Put one robot into the world."""
    with one_line_failures("spawn"):
        order = _order(
            model=model or robot_urdf,
            name=name,
            namespace=_namespace(robot_namespace, namespace),
            place=(x, y, z),
            turn=(roll, pitch, yaw),
            frame_id=reference_frame,
        )
        if allow_renaming:
            order = msgspec.structs.replace(order, allow_renaming=True)
    with client_for("spawn", connect, world_name, timeout, wait_s=wait) as client:
        client.wait_for_server(wait)
        _print_report(client.spawn(order), as_json=as_json)


def _namespace(robot_namespace: str, namespace: str) -> str:
    """Read `--namespace`: the tutorial's switch, or a namespace by itself."""
    word = namespace.lower()
    if word in FALSE_WORDS:
        return ""
    return robot_namespace if word in TRUE_WORDS or not namespace else namespace


def _order(
    *,
    model: str,
    name: str,
    namespace: str,
    place: tuple[float, float, float],
    turn: tuple[float, float, float],
    frame_id: str,
) -> SpawnEntityOrder:
    if not model:
        raise ValueError("no model was given; use 'zensim spawn box_bot' or a path of a URDF file")
    if name:
        check_name(name)
    x, y, z = place
    roll, pitch, yaw = turn
    is_on_ground = math.isnan(z)
    pose = pose_at((x, y, 0.0 if is_on_ground else z), (roll, pitch, yaw))
    return SpawnEntityOrder(
        name,
        allow_renaming=not name,
        entity_resource=resource_for(model, read_description(model), namespace or name),
        entity_namespace=namespace,
        initial_pose=PoseStamped(Header(frame_id=frame_id), pose),
        snap_to_ground=is_on_ground,
    )


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
    model: Annotated[str, typer.Argument(help="Shipped model, or path of a URDF file.")],
    *,
    count: Annotated[int, typer.Option("--count", "-c", min=1, help="How many.")] = 10,
    layout: Annotated[str, typer.Option(help="row, grid or circle.")] = "row",
    spacing: Annotated[float, typer.Option(help="Metres between neighbours.")] = 1.0,
    prefix: Annotated[str, typer.Option(help="Names are PREFIX0, PREFIX1, …")] = "",
    wait: Annotated[float, typer.Option(help="Seconds to wait for a server.")] = 10.0,
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


@app.command("list")
def list_entities(
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """List the entities of the world."""
    with client_for("list", connect, world_name, timeout) as client:
        rows = [_row(client, model) for model in client.models().entities]
    if as_json:
        typer.echo(msgspec.json.encode(rows).decode())
        return
    table = Table("name", "namespace", "agent", "x [m]", "y [m]", "yaw [rad]", box=None)
    for row in rows:
        numbers = (f"{row[key]:.3f}" for key in ("x", "y", "yaw"))
        table.add_row(str(row["name"]), str(row["namespace"]), str(row["agent"] or "-"), *numbers)
    data_console.print(table)


def _row(client: SimClient, model: EntityModel) -> dict[str, str | float]:
    state = client.entity_state(model.entity)
    place = state.pose.position
    return {
        "name": model.entity,
        "namespace": model.namespace,
        "agent": model.agent,
        "x": place.x,
        "y": place.y,
        "z": place.z,
        "yaw": _yaw(state),
    }


def _yaw(state: EntityState) -> float:
    q = state.pose.orientation
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


@app.command()
def delete(
    names: Annotated[list[str], typer.Argument(help="Entities to take out.")],
    *,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Take entities out of the world."""
    with client_for("delete", connect, world_name, timeout) as client:
        for name in names:
            client.delete(name)
            typer.echo(f"deleted {name}")


@app.command()
def inspect(
    name: Annotated[str, typer.Argument(help="Entity to look at.")],
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Show one entity: where it is, who drives it, what it is made of."""
    with client_for("inspect", connect, world_name, timeout) as client:
        models = client.models((name,))
        row = _row(client, models.entities[0])
        model = models.models[0]
    facts = {
        **row,
        "model": model.name,
        "mass_kg": model.mass_kg,
        "links": [link.name for link in model.links],
        "joints": [joint.name for joint in model.joints],
        "drive": msgspec.to_builtins(model.drive),
        "report": msgspec.to_builtins(model.report),
    }
    if as_json:
        typer.echo(msgspec.json.encode(facts).decode())
        return
    for key, value in facts.items():
        typer.echo(f"{key}: {value}")
