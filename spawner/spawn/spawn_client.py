"""Spawn entities with their files, and delete them when the spawning process ends (bonds)."""

import os
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.spawn_messages import (
    MAX_SPAWNS,
    NOT_SPAWNED_PREFIX,
    Resource,
    SpawnEntitiesOrder,
    SpawnEntity,
    SpawnEntityOrder,
    SpawnEntityReport,
    SpawnResult,
)
from zensim.proto.messages.standard_messages import PoseStamped
from zensim.spawner.spawn.asset_bundle import (
    AssetBundle,
    check_collision_meshes,
    find_pending_files,
    make_bundle,
    send_file,
)
from zensim.spawner.spawn.controller_sources import (
    ControllerTexts,
    find_controller_files,
    read_controller_files,
)
from zensim.spawner.spawn.description_sources import RobotDescription, read_model_argument
from zensim.spawner.spawn.description_xml import DescriptionError, add_namespace, remove_namespace
from zensim.spawner.spawn.search_paths import SearchPaths, collect_search_paths
from zensim.spawner.spawn.spawn_poses import RobotPlacement, make_pose

if TYPE_CHECKING:
    from zensim.spawner.client.service_client import ServiceClient

DESCRIBED_DRIVE = DriveOrder()
TOKEN_TIMEOUT_S = 2.0
"""Limit on the delay until the server sees the liveliness token of a bond."""
BOND_POLL_S = 0.05
CHECK_PERIOD_S = 1.0


def make_bond_name() -> str:
    """Generate a unique name."""
    return f"bond_{uuid.uuid4().hex[:16]}"


def spawn_bonded(client: "ServiceClient", order: SpawnEntityOrder) -> SpawnEntityReport:
    """Spawn an entity; retry while the server has not seen the token of the bond.

    Raises:
        ServiceError: The server refused the request.
    """
    deadline = time.monotonic() + TOKEN_TIMEOUT_S
    while True:
        try:
            return client.spawn(order)
        except ServiceError as error:
            is_early = order.bond and error.code == ResultCode.INCORRECT_STATE
            if not is_early or time.monotonic() >= deadline:
                raise
        time.sleep(BOND_POLL_S)


def hold_bond(client: "ServiceClient", entity: str, is_over: Callable[[], bool]) -> bool:
    """Wait until `is_over`, then delete the entity; return False if it was deleted before."""
    check_at = time.monotonic() + CHECK_PERIOD_S
    while not is_over():
        time.sleep(BOND_POLL_S)
        if time.monotonic() < check_at:
            continue
        check_at = time.monotonic() + CHECK_PERIOD_S
        if not _entity_exists(client, entity):
            return False
    try:
        client.delete(entity)
    except ServiceError as error:
        if error.code != ResultCode.NOT_FOUND:
            raise
        return False
    return True


def wait_for_entity(client: "ServiceClient", entity: str, timeout_s: float) -> None:
    """Wait until an entity exists.

    Raises:
        TimeoutError: It does not exist in time.
    """
    deadline = time.monotonic() + timeout_s
    while entity not in client.entities():
        if time.monotonic() >= deadline:
            raise TimeoutError(f"entity '{entity}' does not exist after {timeout_s:g} s")
        time.sleep(BOND_POLL_S)


def _entity_exists(client: "ServiceClient", entity: str) -> bool:
    # Imported here, as service_catalog below: reading a description needs no network.
    from zensim.proto.bus.bus_errors import NoServer

    try:
        client.entity_state(entity)
    except ServiceError as error:
        return error.code != ResultCode.NOT_FOUND
    except (NoServer, TimeoutError):
        # The entity survives a short absence of the server.
        return True
    return True


OnBytes = Callable[[int, int], None]


def ignore_progress(_count: int, _total: int) -> None:
    """Do nothing."""


class SpawnOutcome(msgspec.Struct, frozen=True):
    """Result of one robot of a fleet."""

    name: str
    code: int
    message: str = ""


class SpawnPayload(msgspec.Struct, frozen=True):
    """A description to send: its text, or the name of a built-in model, and its files."""

    model: str
    text: str = ""
    bundle: AssetBundle = AssetBundle()
    controllers: ControllerTexts = ControllerTexts()
    is_readable: bool = True
    """False = not parsed here; the server reports the error."""


def make_payload(
    description: RobotDescription,
    paths: SearchPaths,
    *,
    allow_missing: bool,
    controllers: Sequence[Path] = (),
) -> SpawnPayload:
    """Collect the files that a description names, and the files of its controllers.

    Args:
        description: Text, or name of a built-in model.
        paths: Search paths.
        allow_missing: Accept missing collision meshes.
        controllers: Given files; without them, they are searched for.

    Raises:
        OSError: A given file cannot be read.
        ValueError: A given file is too large, or not text.
        ServiceError: There are too many files, a file is too large, or a collision mesh is missing.
    """
    given = read_controller_files(controllers)
    if not description.text:
        return SpawnPayload(description.uri, controllers=given)
    paths = paths if description.path is None else paths.with_folder_of(description.path)
    try:
        bundle = make_bundle(description.text, paths)
    except DescriptionError:
        return SpawnPayload(description.uri, description.text, is_readable=False)
    if not allow_missing:
        check_collision_meshes(bundle)
    found = given if controllers else find_controller_files(description.text, paths)
    return SpawnPayload(description.uri, description.text, bundle, found)


def read_payload(model: str, controllers: Sequence[Path] = ()) -> SpawnPayload:
    """Read a description by path or name, and collect its files.

    Raises:
        FileNotFoundError: There is no such file.
        ServiceError: See `make_payload`.
    """
    paths = collect_search_paths((), os.environ)
    description = read_model_argument(model, {}, paths)
    return make_payload(description, paths, allow_missing=False, controllers=controllers)


def send_files(
    client: "ServiceClient", bundle: AssetBundle, on_bytes: OnBytes = ignore_progress
) -> int:
    """Upload the files that the server lacks, and return their number.

    Args:
        client: Client of the server.
        bundle: Files of the description.
        on_bytes: Called after each chunk with its size and the total size [bytes].
    """
    pending = find_pending_files(client, bundle.files)
    total = sum(one.file.size - one.received for one in pending)
    for one in pending:
        send_file(client, one, lambda count: on_bytes(count, total))
    return len(pending)


def add_payload(payload: SpawnPayload, order: SpawnEntityOrder, namespace: str) -> SpawnEntityOrder:
    """Add a description and its files to an order; the drive gets the namespace."""
    text = payload.text if payload.is_readable else ""
    resource = make_resource(payload.model, text, namespace)
    if not payload.is_readable:
        resource = Resource(resource_string=payload.text)
    return msgspec.structs.replace(
        order,
        entity_resource=resource,
        assets=payload.bundle.refs,
        controllers=payload.controllers.texts,
    )


def make_resource(model: str, description: str, namespace: str) -> Resource:
    """Make a resource from the text with a namespace, or from the name if there is no text.

    Raises:
        DescriptionError: The text is not a robot description.
    """
    if not description:
        return Resource(uri=model)
    return Resource(
        resource_string=add_namespace(description, namespace) if namespace else description
    )


def make_shared_resource(payload: SpawnPayload) -> Resource:
    """Make the resource that all robots of a fleet share, without a namespace."""
    if not payload.text:
        return Resource(uri=payload.model)
    text = remove_namespace(payload.text) if payload.is_readable else payload.text
    return Resource(resource_string=text)


def spawn_fleet(
    client: "ServiceClient",
    model: str,
    placements: Sequence[RobotPlacement],
    on_done: Callable[[SpawnOutcome], None],
    *,
    controllers: Sequence[Path] = (),
    drive: DriveOrder = DESCRIBED_DRIVE,
) -> list[SpawnOutcome]:
    """Spawn all robots of a fleet in one step, or none.

    Raises:
        NoServer: There is no server.
        TimeoutError: The server does not reply.
    """
    payload = read_payload(model, controllers)
    send_files(client, payload.bundle)
    outcomes = spawn_many(client, payload, placements, SpawnEntityOrder(drive=drive))
    for outcome in outcomes:
        on_done(outcome)
    return outcomes


def spawn_many(
    client: "ServiceClient",
    payload: SpawnPayload,
    placements: Sequence[RobotPlacement],
    order: SpawnEntityOrder,
    *,
    is_atomic: bool = True,
) -> list[SpawnOutcome]:
    """Spawn robots on the ground, each in its own namespace, by one request for `MAX_SPAWNS`.

    The first atomic request that fails is the last one, as is a later one that is refused or has
    no reply; robots of earlier requests stay.

    Args:
        client: Client of a server that has the files.
        payload: Model of all robots; sent once.
        placements: Names and poses.
        order: All other properties of the robots.
        is_atomic: Spawn all in one step or none; else as many as possible, one after another.

    Raises:
        NoServer: There is no server for the first request; the same holds for the others.
        TimeoutError: The server does not reply to it.
        ServiceError: The server refused it as a whole.
    """
    common = _share_payload(order, payload)
    outcomes: list[SpawnOutcome] = []
    failed = ""
    for start in range(0, len(placements), MAX_SPAWNS):
        part = placements[start : start + MAX_SPAWNS]
        try:
            outcomes += _spawn_part(client, part, common, is_atomic=is_atomic)
        except _list_call_errors() as error:
            if not outcomes:
                raise
            return [*outcomes, *_report_failure(placements[len(outcomes) :], error)]
        failed = next((one.name for one in outcomes if one.code != ResultCode.OK), "")
        if is_atomic and failed:
            break
    return [*outcomes, *(_refuse_later(one, failed) for one in placements[len(outcomes) :])]


def _spawn_part(
    client: "ServiceClient",
    part: Sequence[RobotPlacement],
    common: SpawnEntityOrder,
    *,
    is_atomic: bool,
) -> list[SpawnOutcome]:
    batch = SpawnEntitiesOrder(tuple(map(_make_order, part)), is_atomic, common)
    return list(map(_make_outcome, part, client.spawn_all(batch).results))


def _list_call_errors() -> tuple[type[Exception], ...]:
    # Imported here: reading a description needs no network.
    from zensim.proto.bus.bus_errors import NoServer

    return NoServer, TimeoutError, ServiceError


def _share_payload(order: SpawnEntityOrder, payload: SpawnPayload) -> SpawnEntityOrder:
    return msgspec.structs.replace(
        order,
        snap_to_ground=True,
        entity_resource=make_shared_resource(payload),
        assets=payload.bundle.refs,
        controllers=payload.controllers.texts,
    )


def _refuse_later(robot: RobotPlacement, failed: str) -> SpawnOutcome:
    message = f"{NOT_SPAWNED_PREFIX} '{failed}', which an earlier request refused"
    return SpawnOutcome(robot.name, ResultCode.OPERATION_FAILED, message)


def _report_failure(robots: Sequence[RobotPlacement], error: Exception) -> list[SpawnOutcome]:
    code = error.code if isinstance(error, ServiceError) else ResultCode.OPERATION_FAILED
    return [SpawnOutcome(robot.name, code, str(error)) for robot in robots]


def _make_order(robot: RobotPlacement) -> SpawnEntity:
    pose = make_pose((robot.x, robot.y, 0.0), (0.0, 0.0, robot.yaw))
    return SpawnEntity(robot.name, entity_namespace=robot.name, initial_pose=PoseStamped(pose=pose))


def _make_outcome(robot: RobotPlacement, result: SpawnResult) -> SpawnOutcome:
    code = result.result.result
    if code == ResultCode.OK:
        return SpawnOutcome(result.entity_name, code)
    from zensim.proto import service_catalog

    name = service_catalog.SPAWN_ENTITY.code_name(code)
    return SpawnOutcome(robot.name, code, f"{name} ({code}): {result.result.error_message}")
