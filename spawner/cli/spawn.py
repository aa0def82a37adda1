"""`zensim spawn` and `zensim fleet`."""

from contextlib import ExitStack

import msgspec
import typer

from zensim.proto import keys
from zensim.proto.cli_options import options_from
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.messages.result_messages import ResultCode, ServiceError, SetSimulationStateCode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import (
    NOT_SPAWNED_PREFIX,
    SpawnEntityOrder,
    SpawnEntityReport,
)
from zensim.proto.names import check_name
from zensim.proto.stop_signal import StopFlag
from zensim.spawner.bonding import bond_name, spawn_bonded, stay_with, wait_for_entity
from zensim.spawner.cli.options import FleetOptions, SpawnOptions
from zensim.spawner.cli.progress import upload_progress
from zensim.spawner.cli.report_table import print_report
from zensim.spawner.cli.session import client_for, data_console
from zensim.spawner.cli.wishes import (
    Source,
    compat_of,
    description_here,
    description_there,
    dynamics_of,
    order_of,
    paths_of,
    source_of,
)
from zensim.spawner.client import SimClient
from zensim.spawner.launch import Cargo, Outcome, cargo_of, order_for, send_files, spawn_all
from zensim.spawner.placement import LAYOUTS, Place, fleet_places, name_stem
from zensim.spawner.search_paths import SearchPaths

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class Wish(msgspec.Struct, frozen=True):
    """What is to be spawned, as far as this host knows."""

    order: SpawnEntityOrder
    source: Source
    paths: SearchPaths
    cargo: Cargo
    wait_s: float


@app.command()
@options_from(SpawnOptions)
def spawn(given: SpawnOptions) -> None:
    """Put one robot into the world."""
    with exit_on_failure("spawn"):
        wish = _wish(given)
    if given.gazebo_namespace:
        note = "-gazebo_namespace has no effect; --world-name chooses the world"
        typer.echo(f"zensim spawn: note: {note}", err=True)
    network = (given.connect, given.world_name, given.timeout)
    with client_for("spawn", *network, wait_s=wish.wait_s) as client:
        client.wait_for_server(wish.wait_s)
        if given.wait_entity:
            wait_for_entity(client, given.wait_entity, wish.wait_s)
        cargo = _cargo(client, wish, given)
        with upload_progress() as on_bytes:
            send_files(client, cargo.bundle, on_bytes)
        _spawn_and_stay(client, wish.order, cargo, given)


def _wish(given: SpawnOptions) -> Wish:
    source, order, paths = source_of(given), order_of(given), paths_of(given)
    wait_s = given.wait if given.gazebo_timeout is None else given.gazebo_timeout
    description = description_here(source, given, paths)
    cargo = cargo_of(description, paths, allow_missing=given.allow_missing)
    return Wish(order, source, paths, cargo, wait_s)


def _cargo(client: SimClient, wish: Wish, given: SpawnOptions) -> Cargo:
    if wish.source.kind != "-topic":
        return wish.cargo
    description = description_there(client.bus, wish.source, given, wish.wait_s)
    return cargo_of(description, wish.paths, allow_missing=given.allow_missing)


def _spawn_and_stay(
    client: SimClient, wished: SpawnEntityOrder, cargo: Cargo, given: SpawnOptions
) -> None:
    is_bonded = given.bond and not given.dry_run
    order = order_for(cargo, wished, wished.entity_namespace or wished.name)
    with ExitStack() as stack:
        if is_bonded:
            order = msgspec.structs.replace(order, bond=bond_name())
            token = client.bus.token(keys.bond(given.world_name, order.bond))
            stack.callback(token.close)
        report = spawn_bonded(client, order)
        _print_report(_with_notes(report, cargo), given)
        if given.unpause and not given.dry_run:
            _unpause(client)
        if is_bonded:
            _stay(client, report.entity_name)


def _with_notes(report: SpawnEntityReport, cargo: Cargo) -> SpawnEntityReport:
    """Add what only this host knows; of a missing file the server may have spoken already."""
    said = "\n".join(f"{entry.subject} {entry.reason}" for entry in report.report)
    missing = (
        ReportEntry("suspicious", file.mesh.uri, f"{file.reason}; not drawn")
        for file in cargo.bundle.missing
        if file.mesh.uri not in said
    )
    return msgspec.structs.replace(report, report=(*report.report, *cargo.bundle.notes, *missing))


def _print_report(report: SpawnEntityReport, given: SpawnOptions) -> None:
    if given.as_json or not data_console.is_terminal:
        _warn(report)
    if given.as_json:
        typer.echo(msgspec.json.encode(report).decode())
        return
    done = "would spawn" if given.dry_run else "spawned"
    typer.echo(f"{done} {report.entity_name} under {report.entity_namespace}/")
    print_report(report.report, data_console)


def _warn(report: SpawnEntityReport) -> None:
    """Tell people what looks wrong where the table may be out of their sight."""
    for entry in report.report:
        if entry.status == "suspicious":
            typer.echo(f"zensim spawn: warning: {entry.subject}: {entry.reason}", err=True)


def _unpause(client: SimClient) -> None:
    try:
        client.set_simulation_state(State.PLAYING)
    except ServiceError as error:
        if error.code != SetSimulationStateCode.ALREADY_IN_TARGET_STATE:
            raise


def _stay(client: SimClient, entity: str) -> None:
    stop = StopFlag()
    typer.echo(f"zensim spawn: {entity} goes when this command ends, as by Ctrl-C", err=True)
    was_there = stay_with(client, entity, stop)
    typer.echo(f"deleted {entity}" if was_there else f"{entity} has gone", err=True)


@app.command()
@options_from(FleetOptions)
def fleet(given: FleetOptions) -> None:
    """Put many robots into the world."""
    with exit_on_failure("fleet"):
        places = _places(given)
        paths = paths_of(given)
        wishes = SpawnEntityOrder(
            strict=given.strict,
            allow_missing=given.allow_missing,
            compat=compat_of(given),
            dynamics=dynamics_of(given.dynamics),
        )
        description = description_here(Source("MODEL", given.model), given, paths)
        cargo = cargo_of(description, paths, allow_missing=given.allow_missing)
    network = (given.connect, given.world_name, given.timeout)
    with client_for("fleet", *network, wait_s=given.wait) as client:
        client.wait_for_server(given.wait)
        with upload_progress() as on_bytes:
            send_files(client, cargo.bundle, on_bytes)
        outcomes = spawn_all(client, cargo, places, wishes, is_atomic=not given.partial)
    _print_outcomes(outcomes, as_json=given.as_json)


def _places(given: FleetOptions) -> list[Place]:
    if (shape := next((known for known in LAYOUTS if known == given.layout), None)) is None:
        raise ValueError(f"--layout {given.layout!r} is unknown; use {', '.join(LAYOUTS)}")
    prefix = check_name(given.prefix, "prefix") if given.prefix else name_stem(given.model)
    return fleet_places(prefix, given.count, shape, given.spacing)


def _print_outcomes(outcomes: list[Outcome], *, as_json: bool) -> None:
    refused = [outcome for outcome in outcomes if outcome.code != ResultCode.OK]
    if as_json:
        typer.echo(msgspec.json.encode(outcomes).decode())
    else:
        typer.echo(f"spawned {len(outcomes) - len(refused)} of {len(outcomes)}")
    # Those that only another held back have nothing to say.
    telling = [outcome for outcome in refused if NOT_SPAWNED_PREFIX not in outcome.message]
    for outcome in telling:
        typer.echo(f"zensim fleet: {outcome.name}: {outcome.message}", err=True)
    if refused:
        raise typer.Exit(ExitCode.FAILED if len(refused) == len(outcomes) else ExitCode.PARTIAL)
