"""Requests of a spawn, from a description on this host, and the report of its reply."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypedDict, get_args

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Invalid
from zensim.api.argument_checks import check_real, check_whole, make_numbers
from zensim.api.entity_values import SpawnReport
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.messages.drive_messages import Compat
from zensim.proto.messages.model_messages import Dynamics
from zensim.proto.messages.spawn_messages import SpawnEntityOrder, SpawnEntityReport
from zensim.proto.messages.standard_messages import PoseStamped
from zensim.proto.names import check_name, check_namespace
from zensim.proto.near_names import name_choices
from zensim.spawner.spawn.description_sources import read_model_argument
from zensim.spawner.spawn.search_paths import collect_search_paths
from zensim.spawner.spawn.spawn_client import SpawnPayload, add_payload, make_payload
from zensim.spawner.spawn.spawn_poses import (
    LAYOUTS,
    FleetLayout,
    RobotPlacement,
    derive_prefix,
    make_fleet_layout,
    make_pose,
)

SpawnPose = tuple[tuple[float, float, float | None], tuple[float, float, float]]
"""Position [m], z = None on the ground; roll, pitch, yaw [rad]."""
AT_ORIGIN: SpawnPose = ((0.0, 0.0, None), (0.0, 0.0, 0.0))
DEFAULT_COUNT = 10
MAX_COUNT = 100_000


class DescriptionKeywords(TypedDict, total=False):
    """How a description is read, as keyword arguments."""

    xacro_args: Mapping[str, str]
    """Values of `<xacro:arg>`."""
    package_paths: Sequence[str | Path]
    """Folders with packages, models or meshes."""
    controllers: Sequence[str | Path]
    """Parameter files of ros2_controllers or ros_control."""
    drive: str
    """Drive as `zensim spawn --drive` takes it; that of the description if empty."""
    dynamics: Dynamics
    """full, kinematic or auto; that of the world if empty."""
    compat: Compat
    """Behaviour of drives; gazebo11 = with the faults of Gazebo 11."""
    strict: bool
    """Refuse a description with suspicious entries in its report."""
    allow_missing: bool
    """Leave out collisions whose mesh is missing."""


class AgentKeywords(TypedDict, total=False):
    """What drives a new robot, and how long it lives, as keyword arguments."""

    bond: bool
    """Delete it when this process ends."""
    agent: str
    """`external` = do not wait until an agent drives it."""
    timeout_s: float
    """Wall time of the call, until an agent drives it; 10 s after the spawn if it is not given."""


class SpawnKeywords(DescriptionKeywords, AgentKeywords, total=False):
    """Where one robot is spawned, as keyword arguments."""

    x: float
    """Position in the world [m]."""
    y: float
    """Position in the world [m]."""
    z: float
    """Position in the world [m]; on the ground if it is not given."""
    roll: float
    """Orientation [rad], fixed axes."""
    pitch: float
    """Orientation [rad]."""
    yaw: float
    """Orientation [rad]."""
    namespace: str
    """Prefix of topics and frames; the name if it is not given."""


class FleetKeywords(DescriptionKeywords, AgentKeywords, total=False):
    """Where several robots are spawned, as keyword arguments."""

    layout: FleetLayout
    """row, grid (default) or circle."""
    spacing: float
    """Distance between neighbours [m]."""
    poses: npt.ArrayLike
    """x, y or x, y, yaw of each robot, (n, 2) or (n, 3); instead of count and layout."""
    prefix: str
    """Robots are named prefix0, prefix1, …; that of the model if empty."""
    partial: bool
    """Spawn as many as possible, and list the others in `report.refused`."""


class DescriptionOrder(msgspec.Struct, frozen=True):
    """A description on this host, and how it is used."""

    model: str
    """Name of a shipped model, or path of a file."""
    xacro_args: dict[str, str] = {}
    package_paths: tuple[str, ...] = ()
    controllers: tuple[str, ...] = ()
    strict: bool = False
    allow_missing: bool = False
    drive: str = ""
    dynamics: Dynamics = ""
    compat: Compat = "fixed"
    is_dry_run: bool = False


def check_keywords(given: Mapping[str, object], kind: type) -> None:
    """Check the names of keyword arguments.

    Raises:
        TypeError: One is unknown.
    """
    known = list_keywords(kind)
    for name in given:
        if name not in known:
            choices = name_choices(name, sorted(known), most=len(known))
            raise TypeError(f"unexpected keyword argument '{name}'; use {choices}")


def list_keywords(kind: type) -> tuple[str, ...]:
    """List the keyword arguments that a class of them describes."""
    return tuple(kind.__annotations__)


def make_description_order(
    model: str | Path, given: DescriptionKeywords, *, is_dry_run: bool = False
) -> DescriptionOrder:
    """Make the order of a description from keyword arguments; others are ignored.

    Raises:
        Invalid: An argument has a wrong type, or is none of the words that it takes.
    """
    if not isinstance(model, str | Path):
        raise Invalid(f"model={str(model)[:40]} is no text", hint="give a name or a file")
    dynamics, compat = given.get("dynamics", ""), given.get("compat", "fixed")
    _check_word("dynamics", dynamics, get_args(Dynamics))
    _check_word("compat", compat, get_args(Compat))
    return DescriptionOrder(
        str(model),
        dict(given.get("xacro_args") or {}),
        tuple(map(str, given.get("package_paths", ()))),
        tuple(map(str, given.get("controllers", ()))),
        strict=given.get("strict", False),
        allow_missing=given.get("allow_missing", False),
        drive=given.get("drive", ""),
        dynamics=dynamics,
        compat=compat,
        is_dry_run=is_dry_run,
    )


def _check_word(name: str, word: str, words: Sequence[str]) -> None:
    if word not in words:
        choices = ", ".join(filter(None, words))
        raise Invalid(f"{name}={str(word)[:40]!r} is unknown", hint=f"use {choices}")


def make_spawn_pose(given: SpawnKeywords) -> SpawnPose:
    """Make the pose of a spawn from keyword arguments.

    Raises:
        Invalid: A number is none, or not finite.
    """
    for name in ("x", "y", "z", "roll", "pitch", "yaw"):
        number: object = given.get(name, 0.0)
        if name != "z" or number is not None:
            check_real(name, number)
    position = given.get("x", 0.0), given.get("y", 0.0), given.get("z")
    angles = given.get("roll", 0.0), given.get("pitch", 0.0), given.get("yaw", 0.0)
    return position, angles


def read_description(given: DescriptionOrder) -> SpawnPayload:
    """Read a description, and collect its files.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: It cannot be read.
        ServiceError: A mesh is missing, or a file is too large.
    """
    paths = collect_search_paths([Path(one) for one in given.package_paths], os.environ)
    description = read_model_argument(given.model, given.xacro_args, paths)
    controllers = [Path(one) for one in given.controllers]
    return make_payload(
        description, paths, allow_missing=given.allow_missing, controllers=controllers
    )


def make_order(
    given: DescriptionOrder,
    *,
    name: str = "",
    namespace: str = "",
    pose: SpawnPose = AT_ORIGIN,
    payload: SpawnPayload | None = None,
    bond: str = "",
) -> SpawnEntityOrder:
    """Make the request of a spawn; without a payload it lacks the description.

    Raises:
        ValueError: A name or the drive is not valid.
    """
    (x, y, z), angles = pose
    order = SpawnEntityOrder(
        check_name(name) if name else "",
        allow_renaming=not name,
        entity_namespace=check_namespace(namespace) if namespace else "",
        initial_pose=PoseStamped(pose=make_pose((x, y, z or 0.0), angles)),
        snap_to_ground=z is None,
        dry_run=given.is_dry_run,
        strict=given.strict,
        allow_missing=given.allow_missing,
        compat=given.compat,
        dynamics=given.dynamics,
        drive=parse_drive_order(given.drive),
        bond=bond,
    )
    return order if payload is None else add_payload(payload, order, namespace or name)


def make_fleet_placements(
    model: str, count: int | None, given: FleetKeywords
) -> list[RobotPlacement]:
    """Make the names and poses of a fleet.

    Raises:
        Invalid: The poses have a wrong shape or are not finite.
        ValueError: A number or the prefix is not valid.
    """
    prefix, poses = given.get("prefix", ""), given.get("poses")
    names = check_name(prefix, "prefix") if prefix else derive_prefix(model)
    if poses is None:
        number = DEFAULT_COUNT if count is None else count
        check_whole("count", number, 1, MAX_COUNT)
        layout, spacing = given.get("layout", "grid"), given.get("spacing", 1.0)
        if layout not in LAYOUTS:
            raise Invalid(f"layout {layout!r} is unknown", hint=f"use {', '.join(LAYOUTS)}")
        return make_fleet_layout(names, number, layout, spacing)
    rows = make_numbers("poses", poses, "(n, 2): x, y; or (n, 3): x, y, yaw")
    if rows.ndim != 2 or rows.shape[1] not in (2, 3) or not np.isfinite(rows).all():  # noqa: PLR2004  x y, or x y yaw
        raise Invalid(
            f"poses have shape {rows.shape}, or are not finite",
            slug="wrong_shape",
            hint="give (n, 2): x, y; or (n, 3): x, y, yaw",
        )
    if count not in (None, len(rows)):
        raise Invalid(f"count={count} and {len(rows)} poses", hint="give one of them")
    return [RobotPlacement(f"{names}{number}", *row) for number, row in enumerate(rows.tolist())]


def make_report(reply: SpawnEntityReport) -> SpawnReport:
    """Make the report of a spawn from its reply."""
    return SpawnReport(reply.entity_name, reply.entity_namespace, reply.report, drive=reply.drive)
