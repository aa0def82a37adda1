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
from zensim.spawner.cli.command_session import data_console, open_client
from zensim.spawner.cli.spawn_arguments import (
    FleetOptions,
    SpawnOptions,
    SpawnSource,
    choose_source,
    make_search_paths,
    make_spawn_order,
    parse_compat,
    parse_dynamics,
    read_local_description,
    read_topic_description,
)
from zensim.spawner.cli.terminal_output import print_report, upload_progress
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.search_paths import SearchPaths
from zensim.spawner.spawn.spawn_client import (
    SpawnOutcome,
    SpawnPayload,
    add_payload,
    hold_bond,
    make_bond_name,
    make_payload,
    send_files,
    spawn_bonded,
    spawn_many,
    wait_for_entity,
)
from zensim.spawner.spawn.spawn_poses import (
    LAYOUTS,
    RobotPlacement,
    derive_prefix,
    make_fleet_layout,
)

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class SpawnPlan(msgspec.Struct, frozen=True):
    """What is to be spawned, as far as this host knows."""

    order: SpawnEntityOrder
    source: SpawnSource
    paths: SearchPaths
    cargo: SpawnPayload
    wait_s: float


@app.command()
@options_from(SpawnOptions)
def spawn(given: SpawnOptions) -> None:
    """Put one robot into the world."""
    with exit_on_failure("spawn"):
        wish = _make_plan(given)
    if given.gazebo_namespace:
        note = "-gazebo_namespace has no effect; --world-name chooses the world"
        typer.echo(f"zensim spawn: note: {note}", err=True)
    network = (given.connect, given.world_name, given.timeout)
    with open_client("spawn", *network, wait_s=wish.wait_s) as client:
        client.wait_for_server(wish.wait_s)
        if given.wait_entity:
            wait_for_entity(client, given.wait_entity, wish.wait_s)
        cargo = _complete_payload(client, wish, given)
        with upload_progress() as on_bytes:
            send_files(client, cargo.bundle, on_bytes)
        _spawn_with_bond(client, wish.order, cargo, given)


def _make_plan(given: SpawnOptions) -> SpawnPlan:
    source, order, paths = choose_source(given), make_spawn_order(given), make_search_paths(given)
    wait_s = given.wait if given.gazebo_timeout is None else given.gazebo_timeout
    description = read_local_description(source, given, paths)
    cargo = make_payload(description, paths, allow_missing=given.allow_missing)
    return SpawnPlan(order, source, paths, cargo, wait_s)


def _complete_payload(client: SimClient, wish: SpawnPlan, given: SpawnOptions) -> SpawnPayload:
    if wish.source.kind != "-topic":
        return wish.cargo
    description = read_topic_description(client.bus, wish.source, given, wish.wait_s)
    return make_payload(description, wish.paths, allow_missing=given.allow_missing)


def _spawn_with_bond(
    client: SimClient, wished: SpawnEntityOrder, cargo: SpawnPayload, given: SpawnOptions
) -> None:
    is_bonded = given.bond and not given.dry_run
    order = add_payload(cargo, wished, wished.entity_namespace or wished.name)
    with ExitStack() as stack:
        if is_bonded:
            order = msgspec.structs.replace(order, bond=make_bond_name())
            token = client.bus.token(keys.bond(given.world_name, order.bond))
            stack.callback(token.close)
        report = spawn_bonded(client, order)
        _print_report(_add_local_notes(report, cargo), given)
        if given.unpause and not given.dry_run:
            _unpause(client)
        if is_bonded:
            _hold_until_stopped(client, report.entity_name)


def _add_local_notes(report: SpawnEntityReport, cargo: SpawnPayload) -> SpawnEntityReport:
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
        _print_warnings(report)
    if given.as_json:
        typer.echo(msgspec.json.encode(report).decode())
        return
    done = "would spawn" if given.dry_run else "spawned"
    typer.echo(f"{done} {report.entity_name} under {report.entity_namespace}/")
    print_report(report.report, data_console)


def _print_warnings(report: SpawnEntityReport) -> None:
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


def _hold_until_stopped(client: SimClient, entity: str) -> None:
    stop = StopFlag()
    typer.echo(f"zensim spawn: {entity} goes when this command ends, as by Ctrl-C", err=True)
    was_there = hold_bond(client, entity, stop)
    typer.echo(f"deleted {entity}" if was_there else f"{entity} has gone", err=True)


@app.command()
@options_from(FleetOptions)
def fleet(given: FleetOptions) -> None:
    """Put many robots into the world."""
    with exit_on_failure("fleet"):
        places = _make_placements(given)
        paths = make_search_paths(given)
        wishes = SpawnEntityOrder(
            strict=given.strict,
            allow_missing=given.allow_missing,
            compat=parse_compat(given),
            dynamics=parse_dynamics(given.dynamics),
        )
        description = read_local_description(SpawnSource("MODEL", given.model), given, paths)
        cargo = make_payload(description, paths, allow_missing=given.allow_missing)
    network = (given.connect, given.world_name, given.timeout)
    with open_client("fleet", *network, wait_s=given.wait) as client:
        client.wait_for_server(given.wait)
        with upload_progress() as on_bytes:
            send_files(client, cargo.bundle, on_bytes)
        outcomes = spawn_many(client, cargo, places, wishes, is_atomic=not given.partial)
    _print_outcomes(outcomes, as_json=given.as_json)


def _make_placements(given: FleetOptions) -> list[RobotPlacement]:
    if (shape := next((known for known in LAYOUTS if known == given.layout), None)) is None:
        raise ValueError(f"--layout {given.layout!r} is unknown; use {', '.join(LAYOUTS)}")
    prefix = check_name(given.prefix, "prefix") if given.prefix else derive_prefix(given.model)
    return make_fleet_layout(prefix, given.count, shape, given.spacing)


def _print_outcomes(outcomes: list[SpawnOutcome], *, as_json: bool) -> None:
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
