"""`zensim inspect` and `delete`."""

import sys
from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import typer
from msgspec.structs import astuple

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.exit_codes import ExitCode, choose_exit_code, exit_on_failure, format_failure
from zensim.proto.messages.entity_messages import Bounds, BoundsType, EntityFilters
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.rigid_transforms import find_yaw
from zensim.spawner.cli.command_session import (
    AsJson,
    Connect,
    EntityName,
    Timeout,
    WorldName,
    complete_entity_names,
    data_console,
    open_client,
)
from zensim.spawner.cli.info_commands import format_category
from zensim.spawner.cli.terminal_output import print_report
from zensim.spawner.client.sim_client import SimClient

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class DeletionOutcome(msgspec.Struct, frozen=True):
    """What became of one entity that was to go."""

    name: str
    code: int = ResultCode.OK
    message: str = ""


@app.command()
def delete(
    names: Annotated[
        list[str] | None,
        typer.Argument(help="Entities to take out.", autocompletion=complete_entity_names),
    ] = None,
    *,
    everything: Annotated[bool, typer.Option("--all", help="Take all of them out.")] = False,
    pattern: Annotated[
        str, typer.Option("--pattern", metavar="REGEX", help="Those with this in their name.")
    ] = "",
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before --all.")] = False,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Take entities out of the world: by name, by a pattern, or all of them."""
    with exit_on_failure("delete"):
        _check_one_way(names or (), everything=everything, pattern=pattern)
    with open_client("delete", connect, world_name, timeout) as client:
        names = list(dict.fromkeys(names or ()))
        if not names:
            names = list(client.entities(EntityFilters(pattern)))
            if everything and names and not yes:
                _confirm(len(names))
        failures = _delete_each(client, names, as_json=as_json)
    if pattern and not names:
        typer.echo(f"zensim delete: NOT_FOUND (3): no name has {pattern!r} in it", err=True)
        raise typer.Exit(ExitCode.NOT_FOUND)
    if failures:
        raise typer.Exit(_choose_status(failures, len(names)))


def _choose_status(failures: Sequence[ServiceError], count: int) -> ExitCode:
    """Choose the exit status: partial, or the one that all failures share."""
    if len(failures) < count:
        return ExitCode.PARTIAL
    statuses = {choose_exit_code(error) for error in failures}
    return statuses.pop() if len(statuses) == 1 else ExitCode.FAILED


def _check_one_way(names: Sequence[str], *, everything: bool, pattern: str) -> None:
    if sum(map(bool, (names, everything, pattern))) != 1:
        raise ValueError("give names, or --pattern REGEX, or --all; one of these")


def _confirm(count: int) -> None:
    """Ask a person; a program has said what it wants."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return
    try:
        is_meant = typer.confirm(f"Delete all {count} entities?", err=True)
    except typer.Abort:
        raise KeyboardInterrupt from None
    if not is_meant:
        typer.echo("nothing was deleted", err=True)
        raise typer.Exit(ExitCode.FAILED)


def _delete_each(client: SimClient, names: Sequence[str], *, as_json: bool) -> list[ServiceError]:
    """Delete one after another, say how each went, and return the failures."""
    outcomes, failures = [], []
    for name in names:
        if (error := _try_delete(client, name)) is not None:
            failures.append(error)
            outcomes.append(DeletionOutcome(name, error.code, error.message))
            typer.echo(f"zensim delete: {format_failure(error)}", err=True)
        else:
            outcomes.append(DeletionOutcome(name))
            if not as_json:
                typer.echo(f"deleted {name}")
    if as_json:
        typer.echo(msgspec.json.encode(outcomes).decode())
    return failures


def _try_delete(client: SimClient, name: str) -> ServiceError | None:
    try:
        client.delete(name)
    except ServiceError as error:
        return error
    return None


@app.command()
def inspect(
    name: EntityName,
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Show one entity: what and where it is, who drives it, what it is made of."""
    with open_client("inspect", connect, world_name, timeout) as client:
        found = client.models((name,))
        model = found.models[0]
        facts = {**_find_pose(client, name), **_find_info(client, name)}
    facts.update(
        namespace=found.entities[0].namespace,
        agent=found.entities[0].agent,
        model=model.name,
        mass_kg=model.mass_kg,
        links=[link.name for link in model.links],
        joints=[joint.name for joint in model.joints],
        drive=msgspec.to_builtins(model.drive),
    )
    if as_json:
        report = msgspec.to_builtins(model.report)
        typer.echo(msgspec.json.encode({**facts, "report": report}).decode())
        return
    kind = (facts["drive"] or {}).get("kind")
    for key, value in {**facts, "drive": kind}.items():
        typer.echo(f"{key}: {_format_value(value)}")
    print_report(model.report, data_console)


def _find_pose(client: SimClient, name: str) -> dict[str, Any]:
    state = client.entity_state(name)
    place = state.pose.position
    return {
        "name": name,
        "x": place.x,
        "y": place.y,
        "z": place.z,
        "yaw": find_yaw(astuple(state.pose.orientation), FLOAT_MATH),
        "twist": msgspec.to_builtins(state.twist),
    }


def _find_info(client: SimClient, name: str) -> dict[str, Any]:
    info, bounds = client.entity_info(name), client.entity_bounds(name)
    return {
        "category": format_category(info.category),
        "tags": info.tags,
        "description": info.description,
        "bounds": _to_corners(bounds),
    }


def _to_corners(bounds: Bounds) -> dict[str, list[float]] | None:
    """Write a box down as its corners [m], in the frame of the base link."""
    if bounds.type != BoundsType.BOX:
        return None
    upper, lower = ([point.x, point.y, point.z] for point in bounds.points)
    return {"lower": lower, "upper": upper}


def _format_value(value: object) -> str:
    """Write a value for people: numbers short, lists without brackets, nothing as -."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return "  ".join(f"{key} {_format_value(part)}" for key, part in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_format_value, value)) or "-"
    return "-" if value in (None, "") else str(value)
