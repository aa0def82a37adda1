"""Spawn one robot or a fleet: read, namespace, wait for the server, send."""

import math
from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path

import msgspec

from proto.geometry import Point, Pose, PoseStamped, Quaternion
from proto.names import NAME
from proto.result import ServiceError
from proto.services import Resource, SpawnEntityOrder, SpawnEntityReport
from spawner.client import SimClient
from spawner.namespacing import namespaced
from spawner.placement import Place


class Outcome(msgspec.Struct, frozen=True):
    """What became of one robot of a fleet."""

    name: str
    code: int
    message: str = ""


def read_description(model: str) -> str:
    """Read a URDF: a file by its path, or a shipped model by its name; empty when it is neither.

    Raises:
        FileNotFoundError: It looks like a path, but there is no such file.
    """
    path = Path(model)
    if path.is_file():
        return path.read_text(encoding="utf-8")
    if not NAME.fullmatch(model):
        raise FileNotFoundError(2, "no such file, nor a shipped model", model)
    shipped = resources.files("sim_server") / "models" / f"{model}.urdf"
    return shipped.read_text(encoding="utf-8") if shipped.is_file() else ""


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
    """Spawn a fleet on the ground, each robot under its own namespace; go on after a refusal.

    Raises:
        NoServer: The server is gone.
        TimeoutError: It does not answer.
    """
    description = read_description(model)
    outcomes = []
    for place in places:
        outcome = _spawn_one(client, model, description, place)
        outcomes.append(outcome)
        on_done(outcome)
    return outcomes


def _spawn_one(client: SimClient, model: str, description: str, place: Place) -> Outcome:
    order = SpawnEntityOrder(
        place.name,
        entity_resource=resource_for(model, description, place.name),
        entity_namespace=place.name,
        initial_pose=PoseStamped(pose=pose_at((place.x, place.y, 0.0), (0.0, 0.0, place.yaw))),
        snap_to_ground=True,
    )
    try:
        report: SpawnEntityReport = client.spawn(order)
    except ServiceError as error:
        return Outcome(place.name, error.code, str(error))
    return Outcome(report.entity_name, report.result.result)
