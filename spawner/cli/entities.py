"""`zensim list`, `inspect`, `delete`."""

import math
from typing import Annotated

import msgspec
import typer
from rich.table import Table

from proto.services import EntityState
from proto.telemetry import EntityModel
from spawner.cli.session import (
    AsJson,
    Connect,
    Timeout,
    WorldName,
    client_for,
    data_console,
)
from spawner.client import SimClient

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


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
