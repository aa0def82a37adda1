"""Spawn one robot or a fleet: read, namespace, wait for the server, send."""

import math
import os
from collections.abc import Callable, Sequence

import msgspec

from proto.geometry import Point, Pose, PoseStamped, Quaternion
from proto.result import ServiceError
from proto.services import Resource, SpawnEntityOrder, SpawnEntityReport
from spawner.assets import Bundle, bundle_of, check_collisions
from spawner.client import SimClient
from spawner.descriptions import Description, from_word
from spawner.markup import DescriptionError
from spawner.namespacing import namespaced
from spawner.placement import Place
from spawner.search_paths import SearchPaths, search_paths
from spawner.upload import outstanding, send

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
    """Spawn a fleet of one model; go on after a refusal.

    Raises:
        NoServer: The server is gone.
        TimeoutError: It does not answer.
    """
    cargo = read_cargo(model)
    send_files(client, cargo.bundle)
    return spawn_all(client, cargo, places, on_done, SpawnEntityOrder())


def spawn_all(
    client: SimClient,
    cargo: Cargo,
    places: Sequence[Place],
    on_done: Callable[[Outcome], None],
    order: SpawnEntityOrder,
) -> list[Outcome]:
    """Spawn robots on the ground, each under its own namespace; go on after a refusal.

    Args:
        client: Of the server, which has the files.
        cargo: What they all are.
        places: Where they stand.
        on_done: Called after each.
        order: What is wished besides name, place and model.

    Raises:
        NoServer: The server is gone.
        TimeoutError: It does not answer.
    """
    outcomes = []
    for place in places:
        outcome = _spawn_one(client, cargo, place, order)
        outcomes.append(outcome)
        on_done(outcome)
    return outcomes


def _spawn_one(client: SimClient, cargo: Cargo, place: Place, wishes: SpawnEntityOrder) -> Outcome:
    pose = pose_at((place.x, place.y, 0.0), (0.0, 0.0, place.yaw))
    order = msgspec.structs.replace(
        wishes,
        name=place.name,
        entity_namespace=place.name,
        initial_pose=PoseStamped(pose=pose),
        snap_to_ground=True,
    )
    try:
        report: SpawnEntityReport = client.spawn(order_for(cargo, order, place.name))
    except ServiceError as error:
        return Outcome(place.name, error.code, str(error))
    return Outcome(report.entity_name, report.result.result)
