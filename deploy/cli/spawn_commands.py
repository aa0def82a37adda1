"""`zensim spawn` and `zensim fleet`."""

from contextlib import ExitStack

import msgspec
import typer

from zensim.deploy.cli.command_session import data_console, open_client, print_json
from zensim.deploy.cli.retried_spawns import keeping_unanswered_spawns
from zensim.deploy.cli.spawn_arguments import (
    FleetOptions,
    SpawnOptions,
    SpawnSource,
    choose_source,
    make_placements,
    make_search_paths,
    make_spawn_order,
    parse_compat,
    parse_dynamics,
    read_local_description,
    read_topic_description,
)
from zensim.deploy.cli.terminal_output import print_report, upload_progress
from zensim.proto import keys
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.exit_codes import ExitCode, exit_on_failure, to_cli_words
from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.messages.result_messages import ResultCode, ServiceError, SetSimulationStateCode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import (
    NOT_SPAWNED_PREFIX,
    SpawnEntityOrder,
    SpawnEntityReport,
)
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.stop_signal import StopFlag
from zensim.proto.verbosity import CURRENT, print_note
from zensim.spawner.client.driven_count import wait_until_driven
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

app = make_app()


class SpawnPlan(msgspec.Struct, frozen=True):
    """A spawn order, and what this host adds to it."""

    order: SpawnEntityOrder
    source: SpawnSource
    paths: SearchPaths
    payload: SpawnPayload
    wait_s: float


@app.command(
    epilog="""Examples:
  zensim spawn box_bot --name r1 -x 1
  zensim spawn robot.urdf -x 2 -Y 1.57 --dry-run
  zensim spawn robot.urdf.xacro --xacro-arg arm:=true --package-path ~/ws/src"""
)
def spawn(given: SpawnOptions) -> None:
    """Spawn one robot or object from a URDF, xacro or SDF description."""
    with exit_on_failure("spawn"):
        plan = _make_plan(given)
    if given.gazebo_namespace:
        note = "-gazebo_namespace has no effect; choose the world with --world-name"
        print_note("spawn", note)
    with (
        open_client("spawn", given, wait_s=plan.wait_s) as client,
        keeping_unanswered_spawns(client.bus),
    ):
        client.wait_for_server(plan.wait_s)
        if given.wait_entity:
            wait_for_entity(client, given.wait_entity, plan.wait_s)
        payload = _complete_payload(client, plan, given)
        with upload_progress() as on_bytes:
            send_files(client, payload.bundle, on_bytes)
        _spawn_with_bond(client, plan.order, payload, given)


def _make_plan(given: SpawnOptions) -> SpawnPlan:
    source, order, paths = choose_source(given), make_spawn_order(given), make_search_paths(given)
    wait_s = given.wait if given.gazebo_timeout is None else given.gazebo_timeout
    description = read_local_description(source, given, paths)
    payload = make_payload(
        description, paths, allow_missing=given.allow_missing, controllers=given.controllers or ()
    )
    return SpawnPlan(order, source, paths, payload, wait_s)


def _complete_payload(client: SimClient, plan: SpawnPlan, given: SpawnOptions) -> SpawnPayload:
    if plan.source.kind != "-topic":
        return plan.payload
    description = read_topic_description(client.bus, plan.source, given, plan.wait_s)
    return make_payload(
        description,
        plan.paths,
        allow_missing=given.allow_missing,
        controllers=given.controllers or (),
    )


def _spawn_with_bond(
    client: SimClient, base: SpawnEntityOrder, payload: SpawnPayload, given: SpawnOptions
) -> None:
    is_bonded = given.bond and not given.dry_run
    order = add_payload(payload, base, base.entity_namespace or base.name)
    with ExitStack() as stack:
        if is_bonded:
            order = msgspec.structs.replace(order, bond=make_bond_name())
            token = client.bus.token(keys.bond(given.world_name, order.bond))
            stack.callback(token.close)
        report = spawn_bonded(client, order)
        _print_report(_add_local_notes(report, payload), given)
        if given.unpause and not given.dry_run:
            _unpause(client)
        if is_bonded:
            _hold_until_stopped(client, report.entity_name)


def _add_local_notes(report: SpawnEntityReport, payload: SpawnPayload) -> SpawnEntityReport:
    """Add the notes of this host, except on missing files that the server has reported."""
    reported = "\n".join(f"{entry.subject} {entry.reason}" for entry in report.report)
    missing = (
        ReportEntry("suspicious", file.mesh.uri, f"{file.reason}; not drawn")
        for file in payload.bundle.missing
        if file.mesh.uri not in reported
    )
    notes = (*payload.bundle.notes, *payload.controllers.notes, *missing)
    return msgspec.structs.replace(report, report=(*report.report, *notes))


def _print_report(report: SpawnEntityReport, given: SpawnOptions) -> None:
    if given.as_json or not data_console.is_terminal:
        _print_warnings(report)
    if given.as_json:
        print_json(report)
        return
    if CURRENT.is_quiet:
        print_lines(report.entity_name)
        return
    verb = "would spawn" if given.dry_run else "spawned"
    print_lines(f"{verb} {report.entity_name} under {report.entity_namespace}/")
    print_report(report.report, data_console)


def _print_warnings(report: SpawnEntityReport) -> None:
    """Print what is wrong to standard error, where a redirected table is not seen."""
    for entry in report.report:
        if entry.status in ("suspicious", "predicted"):
            print_lines(f"zensim spawn: warning: {entry.subject}: {entry.reason}", err=True)


def _unpause(client: SimClient) -> None:
    try:
        client.set_simulation_state(State.PLAYING)
    except ServiceError as error:
        if error.code != SetSimulationStateCode.ALREADY_IN_TARGET_STATE:
            raise


def _hold_until_stopped(client: SimClient, entity: str) -> None:
    stop = StopFlag()
    print_lines(
        f"zensim spawn: {entity} is deleted when this command ends; Ctrl-C to exit", err=True
    )
    was_there = hold_bond(client, entity, stop)
    print_lines(
        f"deleted {entity}" if was_there else f"{entity} was deleted by another client", err=True
    )


@app.command(
    epilog="""Examples:
  zensim fleet box_bot --robots 20 --layout grid
  zensim fleet robot.urdf --prefix cart --spacing 2 --partial"""
)
def fleet(given: FleetOptions) -> None:
    """Spawn several robots of one model, in one step."""
    with exit_on_failure("fleet"):
        placements = make_placements(
            given.model, given.robots, given.layout, given.spacing, given.prefix
        )
        paths = make_search_paths(given)
        common = SpawnEntityOrder(
            strict=given.strict,
            allow_missing=given.allow_missing,
            compat=parse_compat(given),
            dynamics=parse_dynamics(given.dynamics),
            drive=parse_drive_order(given.drive),
        )
        description = read_local_description(SpawnSource("MODEL", given.model), given, paths)
        payload = make_payload(
            description,
            paths,
            allow_missing=given.allow_missing,
            controllers=given.controllers or (),
        )
    with (
        open_client("fleet", given, wait_s=given.wait) as client,
        keeping_unanswered_spawns(client.bus),
    ):
        client.wait_for_server(given.wait)
        with upload_progress() as on_bytes:
            send_files(client, payload.bundle, on_bytes)
        outcomes = spawn_many(client, payload, placements, common, is_atomic=not given.partial)
        if given.wait_driven > 0.0:
            spawned = [one.name for one in outcomes if one.code == ResultCode.OK]
            wait_until_driven(client, spawned, given.wait_driven)
    _print_outcomes(outcomes, as_json=given.as_json)


def _print_outcomes(outcomes: list[SpawnOutcome], *, as_json: bool) -> None:
    refused = [outcome for outcome in outcomes if outcome.code != ResultCode.OK]
    if as_json:
        print_json(outcomes)
    elif CURRENT.is_quiet:
        print_lines("\n".join(one.name for one in outcomes if one.code == ResultCode.OK))
    else:
        print_lines(f"spawned {len(outcomes) - len(refused)} of {len(outcomes)}")
    # The others are refused only because of these.
    causes = [outcome for outcome in refused if NOT_SPAWNED_PREFIX not in outcome.message]
    for outcome in causes:
        print_lines(f"zensim fleet: {outcome.name}: {to_cli_words(outcome.message)}", err=True)
    if refused:
        raise typer.Exit(ExitCode.FAILED if len(refused) == len(outcomes) else ExitCode.PARTIAL)
