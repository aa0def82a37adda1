"""Spawn one robot or a fleet with its files, and bonds that delete an entity when its process ends."""

import os
import time
import uuid
from collections.abc import Callable, Sequence

import msgspec

from zensim.proto import service_catalog
from zensim.proto.bus import NoServer
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.spawn_messages import (
    Resource,
    SpawnEntitiesOrder,
    SpawnEntity,
    SpawnEntityOrder,
    SpawnEntityReport,
    SpawnResult,
)
from zensim.proto.messages.standard_messages import PoseStamped
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.asset_bundle import (
    AssetBundle,
    check_collision_meshes,
    find_pending_files,
    make_bundle,
    send_file,
)
from zensim.spawner.spawn.description_sources import RobotDescription, read_model_argument
from zensim.spawner.spawn.description_xml import DescriptionError, add_namespace, remove_namespace
from zensim.spawner.spawn.search_paths import SearchPaths, collect_search_paths
from zensim.spawner.spawn.spawn_poses import RobotPlacement, make_pose

TOKEN_TIMEOUT_S = 2.0
"""How long a server may take to see the token of a bond."""
BOND_POLL_S = 0.05
CHECK_PERIOD_S = 1.0


def make_bond_name() -> str:
    """Make up a name that no other process has."""
    return f"bond_{uuid.uuid4().hex[:16]}"


def spawn_bonded(client: SimClient, order: SpawnEntityOrder) -> SpawnEntityReport:
    """Spawn; ask again while the server has not seen the bond's token yet.

    Raises:
        ServiceError: The server refuses.
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


def hold_bond(client: SimClient, entity: str, is_over: Callable[[], bool]) -> bool:
    """Wait until it is over, then delete the entity; return whether it was still there."""
    ask_at = time.monotonic() + CHECK_PERIOD_S
    while not is_over():
        time.sleep(BOND_POLL_S)
        if time.monotonic() < ask_at:
            continue
        ask_at = time.monotonic() + CHECK_PERIOD_S
        if not _entity_exists(client, entity):
            return False
    try:
        client.delete(entity)
    except ServiceError as error:
        if error.code != ResultCode.NOT_FOUND:
            raise
        return False
    return True


def wait_for_entity(client: SimClient, entity: str, timeout_s: float) -> None:
    """Wait until an entity is in the world.

    Raises:
        TimeoutError: It did not come.
    """
    deadline = time.monotonic() + timeout_s
    while entity not in client.entities():
        if time.monotonic() >= deadline:
            raise TimeoutError(f"entity '{entity}' did not come within {timeout_s:g} s")
        time.sleep(BOND_POLL_S)


def _entity_exists(client: SimClient, entity: str) -> bool:
    try:
        client.entity_state(entity)
    except ServiceError as error:
        return error.code != ResultCode.NOT_FOUND
    except (NoServer, TimeoutError):
        # A server that is away for a moment has not lost the entity.
        return True
    return True


OnBytes = Callable[[int, int], None]


def ignore_progress(_count: int, _total: int) -> None:
    """Show no progress."""


class SpawnOutcome(msgspec.Struct, frozen=True):
    """What became of one robot of a fleet."""

    name: str
    code: int
    message: str = ""


class SpawnPayload(msgspec.Struct, frozen=True):
    """A description ready to go: its text, or a name that the server knows, and its files."""

    model: str
    text: str = ""
    bundle: AssetBundle = AssetBundle()
    is_readable: bool = True
    """Otherwise the server says what is wrong with the text."""


def make_payload(
    description: RobotDescription, paths: SearchPaths, *, allow_missing: bool
) -> SpawnPayload:
    """Gather the files that a description names.

    Raises:
        ServiceError: Files are too many, too large, or missing for a collision.
    """
    if not description.text:
        return SpawnPayload(description.uri)
    near = paths if description.path is None else paths.beside(description.path)
    try:
        bundle = make_bundle(description.text, near)
    except DescriptionError:
        return SpawnPayload(description.uri, description.text, is_readable=False)
    if not allow_missing:
        check_collision_meshes(bundle)
    return SpawnPayload(description.uri, description.text, bundle)


def read_description(model: str) -> str:
    """Read a URDF: a file by its path, or a shipped model by its name; empty when it is neither.

    Raises:
        FileNotFoundError: It looks like a path, but there is no such file.
    """
    return read_model_argument(model, {}, SearchPaths()).text


def read_payload(model: str) -> SpawnPayload:
    """Read what a path or name says, with the files that it names.

    Raises:
        FileNotFoundError: It looks like a path, but there is no such file.
        ServiceError: Files are too many, too large, or missing for a collision.
    """
    paths = collect_search_paths((), os.environ)
    return make_payload(read_model_argument(model, {}, paths), paths, allow_missing=False)


def send_files(client: SimClient, bundle: AssetBundle, on_bytes: OnBytes = ignore_progress) -> int:
    """Send what the server lacks of a bundle, and return how many files that were.

    Args:
        client: Of the server.
        bundle: What the description names.
        on_bytes: Called with how many bytes went, and how many were to go in all.
    """
    lacking = find_pending_files(client, bundle.files)
    total = sum(one.file.size - one.received for one in lacking)
    for one in lacking:
        send_file(client, one, lambda count: on_bytes(count, total))
    return len(lacking)


def add_payload(cargo: SpawnPayload, order: SpawnEntityOrder, namespace: str) -> SpawnEntityOrder:
    """Put a description and its files into an order, its drive in the namespace."""
    text = cargo.text if cargo.is_readable else ""
    resource = make_resource(cargo.model, text, namespace)
    if not cargo.is_readable:
        resource = Resource(resource_string=cargo.text)
    return msgspec.structs.replace(order, entity_resource=resource, assets=cargo.bundle.refs)


def make_resource(model: str, description: str, namespace: str) -> Resource:
    """Say what to spawn: the namespaced text, or the bare name for the server to judge.

    Raises:
        DescriptionError: The text is no robot description.
    """
    if not description:
        return Resource(uri=model)
    return Resource(
        resource_string=add_namespace(description, namespace) if namespace else description
    )


def make_shared_resource(cargo: SpawnPayload) -> Resource:
    """Say what all of a fleet are, in no namespace."""
    if not cargo.text:
        return Resource(uri=cargo.model)
    text = remove_namespace(cargo.text) if cargo.is_readable else cargo.text
    return Resource(resource_string=text)


def spawn_fleet(
    client: SimClient,
    model: str,
    places: Sequence[RobotPlacement],
    on_done: Callable[[SpawnOutcome], None],
) -> list[SpawnOutcome]:
    """Spawn a fleet of one model between two steps, all of it or none.

    Raises:
        NoServer: The server is gone.
        TimeoutError: It does not answer.
    """
    cargo = read_payload(model)
    send_files(client, cargo.bundle)
    outcomes = spawn_many(client, cargo, places, SpawnEntityOrder())
    for outcome in outcomes:
        on_done(outcome)
    return outcomes


def spawn_many(
    client: SimClient,
    cargo: SpawnPayload,
    places: Sequence[RobotPlacement],
    wishes: SpawnEntityOrder,
    *,
    is_atomic: bool = True,
) -> list[SpawnOutcome]:
    """Spawn robots on the ground, each under its own namespace, by one request.

    Args:
        client: Of the server, which has the files.
        cargo: What they all are; it is sent once.
        places: Where they stand.
        wishes: What is wished besides name, place and model.
        is_atomic: All between two steps or none; else one after another, whichever can be.

    Raises:
        NoServer: The server is gone.
        TimeoutError: It does not answer.
        ServiceError: It refuses the request as a whole.
    """
    common = msgspec.structs.replace(
        wishes,
        snap_to_ground=True,
        entity_resource=make_shared_resource(cargo),
        assets=cargo.bundle.refs,
    )
    answer = client.spawn_all(
        SpawnEntitiesOrder(tuple(_make_order(place) for place in places), is_atomic, common)
    )
    return [
        _make_outcome(place, result) for place, result in zip(places, answer.results, strict=True)
    ]


def _make_order(place: RobotPlacement) -> SpawnEntity:
    pose = make_pose((place.x, place.y, 0.0), (0.0, 0.0, place.yaw))
    return SpawnEntity(place.name, entity_namespace=place.name, initial_pose=PoseStamped(pose=pose))


def _make_outcome(place: RobotPlacement, spawned: SpawnResult) -> SpawnOutcome:
    code = spawned.result.result
    if code == ResultCode.OK:
        return SpawnOutcome(spawned.entity_name, code)
    name = service_catalog.SPAWN_ENTITY.code_name(code)
    return SpawnOutcome(place.name, code, f"{name} ({code}): {spawned.result.error_message}")
