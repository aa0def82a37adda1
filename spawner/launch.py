"""Spawn one robot or a fleet: read, namespace, wait for the server, send."""

import math
import os
from collections.abc import Callable, Sequence

import msgspec

from zensim.proto import service_catalog
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.spawn_messages import (
    Resource,
    SpawnEntitiesOrder,
    SpawnEntity,
    SpawnEntityOrder,
    SpawnResult,
)
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped, Quaternion
from zensim.spawner.assets import Bundle, bundle_of, check_collisions
from zensim.spawner.client import SimClient
from zensim.spawner.descriptions import Description, from_word
from zensim.spawner.markup import DescriptionError
from zensim.spawner.namespacing import namespaced, without_namespace
from zensim.spawner.placement import Place
from zensim.spawner.search_paths import SearchPaths, search_paths
from zensim.spawner.upload import outstanding, send

OnBytes = Callable[[int, int], None]


def ignore_bytes(_count: int, _total: int) -> None:
    """Show no progress."""


class Outcome(msgspec.Struct, frozen=True):
    """What became of one robot of a fleet."""

    name: str
    code: int
    message: str = ""


class Cargo(msgspec.Struct, frozen=True):
    """A description ready to go: its text, or a name that the server knows, and its files."""

    model: str
    text: str = ""
    bundle: Bundle = Bundle()
    is_readable: bool = True
    """Otherwise the server says what is wrong with the text."""


def cargo_of(description: Description, paths: SearchPaths, *, allow_missing: bool) -> Cargo:
    """Gather the files that a description names.

    Raises:
        ServiceError: Files are too many, too large, or missing for a collision.
    """
    if not description.text:
        return Cargo(description.uri)
    near = paths if description.path is None else paths.beside(description.path)
    try:
        bundle = bundle_of(description.text, near)
    except DescriptionError:
        return Cargo(description.uri, description.text, is_readable=False)
    if not allow_missing:
        check_collisions(bundle)
    return Cargo(description.uri, description.text, bundle)


def read_description(model: str) -> str:
    """Read a URDF: a file by its path, or a shipped model by its name; empty when it is neither.

    Raises:
        FileNotFoundError: It looks like a path, but there is no such file.
    """
    return from_word(model, {}, SearchPaths()).text


def read_cargo(model: str) -> Cargo:
    """Read what a path or name says, with the files that it names.

    Raises:
        FileNotFoundError: It looks like a path, but there is no such file.
        ServiceError: Files are too many, too large, or missing for a collision.
    """
    paths = search_paths((), os.environ)
    return cargo_of(from_word(model, {}, paths), paths, allow_missing=False)


def send_files(client: SimClient, bundle: Bundle, on_bytes: OnBytes = ignore_bytes) -> int:
    """Send what the server lacks of a bundle, and return how many files that were.

    Args:
        client: Of the server.
        bundle: What the description names.
        on_bytes: Called with how many bytes went, and how many were to go in all.
    """
    lacking = outstanding(client, bundle.files)
    total = sum(one.file.size - one.received for one in lacking)
    for one in lacking:
        send(client, one, lambda count: on_bytes(count, total))
    return len(lacking)


def order_for(cargo: Cargo, order: SpawnEntityOrder, namespace: str) -> SpawnEntityOrder:
    """Put a description and its files into an order, its drive in the namespace."""
    text = cargo.text if cargo.is_readable else ""
    resource = resource_for(cargo.model, text, namespace)
    if not cargo.is_readable:
        resource = Resource(resource_string=cargo.text)
    return msgspec.structs.replace(order, entity_resource=resource, assets=cargo.bundle.refs)


def resource_for(model: str, description: str, namespace: str) -> Resource:
    """Say what to spawn: the namespaced text, or the bare name for the server to judge.

    Raises:
        DescriptionError: The text is no robot description.
    """
    if not description:
        return Resource(uri=model)
    return Resource(
        resource_string=namespaced(description, namespace) if namespace else description
    )


def shared_resource(cargo: Cargo) -> Resource:
    """Say what all of a fleet are, in no namespace."""
    if not cargo.text:
        return Resource(uri=cargo.model)
    text = without_namespace(cargo.text) if cargo.is_readable else cargo.text
    return Resource(resource_string=text)


def pose_at(
    place: tuple[float, float, float], turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Pose:
    """Make a pose from x, y, z [m] and fixed-axis roll, pitch, yaw [rad]."""
    (sr, sp, sy), (cr, cp, cy) = (
        [wave(angle / 2.0) for angle in turn] for wave in (math.sin, math.cos)
    )
    return Pose(
        Point(*place),
        Quaternion(
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ),
    )


def spawn_fleet(
    client: SimClient,
    model: str,
    places: Sequence[Place],
    on_done: Callable[[Outcome], None],
) -> list[Outcome]:
    """Spawn a fleet of one model between two steps, all of it or none.

    Raises:
        NoServer: The server is gone.
        TimeoutError: It does not answer.
    """
    cargo = read_cargo(model)
    send_files(client, cargo.bundle)
    outcomes = spawn_all(client, cargo, places, SpawnEntityOrder())
    for outcome in outcomes:
        on_done(outcome)
    return outcomes


def spawn_all(
    client: SimClient,
    cargo: Cargo,
    places: Sequence[Place],
    wishes: SpawnEntityOrder,
    *,
    is_atomic: bool = True,
) -> list[Outcome]:
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
        entity_resource=shared_resource(cargo),
        assets=cargo.bundle.refs,
    )
    answer = client.spawn_all(
        SpawnEntitiesOrder(tuple(_order_at(place) for place in places), is_atomic, common)
    )
    return [_outcome(place, result) for place, result in zip(places, answer.results, strict=True)]


def _order_at(place: Place) -> SpawnEntity:
    pose = pose_at((place.x, place.y, 0.0), (0.0, 0.0, place.yaw))
    return SpawnEntity(place.name, entity_namespace=place.name, initial_pose=PoseStamped(pose=pose))


def _outcome(place: Place, spawned: SpawnResult) -> Outcome:
    code = spawned.result.result
    if code == ResultCode.OK:
        return Outcome(spawned.entity_name, code)
    name = service_catalog.SPAWN_ENTITY.code_name(code)
    return Outcome(place.name, code, f"{name} ({code}): {spawned.result.error_message}")
