"""Names and poses of the robots of a scenario: layouts, lists, files and draws."""

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec import inspect

from zensim.proto.bounded_files import read_text_file
from zensim.proto.messages.standard_messages import Pose
from zensim.scenario.quantities import make_uniforms, resolve_draws
from zensim.scenario.scenario_format import LayoutSection, PlaceSection
from zensim.scenario.scenario_nodes import Issue, Place, ScenarioInvalid, ScenarioNode, fail_at
from zensim.scenario.scenario_nodes import read_nodes as read_yaml_nodes
from zensim.scenario.typed_reading import TypedReader
from zensim.spawner.spawn.spawn_poses import make_fleet_layout, make_pose

POSE_LIST_SUFFIXES = (".json", ".yaml", ".yml")
LAUNCH_KEYS = {"x_pose": "x", "y_pose": "y", "z_pose": "z", "yaw_pose": "yaw", "yaw_angle": "yaw"}
"""Keys of the lists of robots of launch files, and those of a pose."""
MAX_TRIES = 1000
"""Draws of a place of the layout `random`."""


class ScenarioRobot(msgspec.Struct, frozen=True):
    """One robot: its group, name and start."""

    name: str
    group: int
    """Index among the groups of the file."""
    x: float
    y: float
    z: float | None = None
    """None = on the ground."""
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0

    @property
    def pose(self) -> Pose:
        """Start in the world."""
        return make_pose((self.x, self.y, self.z or 0.0), (self.roll, self.pitch, self.yaw))


def name_group(group: Mapping[str, Any], count: int) -> list[str]:
    """Name the robots of a group: as it is called if there is one, else with numbers."""
    name = str(group["name"])
    return [name] if count == 1 else [f"{name}{index}" for index in range(count)]


def place_group(
    plain: Mapping[str, Any], index: int, seed: int, poses: Sequence[Mapping[str, Any]]
) -> list[ScenarioRobot]:
    """Place the robots of a group.

    Args:
        plain: The group, with draws.
        index: Of the group in the file.
        seed: Of the run.
        poses: Plain poses of the group's list or file, with draws; empty = by its layout.
    """
    count = plain.get("count") or len(poses) or 1
    path = f"robots.{plain['name']}"
    spots = _place_by_layout(plain, count, seed, path)
    robots = []
    for number, name in enumerate(name_group(plain, count)):
        yaw = resolve_draws(plain.get("yaw", 0.0), seed, f"{path}.yaw", name)
        spot = spots[number] if spots else None
        if poses:
            given = resolve_draws(poses[number], seed, f"{path}.poses[{number}]", name)
            spot = msgspec.convert(given, PlaceSection)
        spot = spot or PlaceSection()
        robots.append(
            ScenarioRobot(
                spot.name or name,
                index,
                spot.x,
                spot.y,
                spot.z,
                spot.roll,
                spot.pitch,
                spot.yaw + yaw,
            )
        )
    return robots


def _place_by_layout(
    plain: Mapping[str, Any], count: int, seed: int, path: str
) -> list[PlaceSection]:
    given = resolve_draws(plain.get("layout") or {}, seed, f"{path}.layout")
    layout = msgspec.convert(given, LayoutSection)
    if layout.radius is not None and layout.kind in ("row", "grid"):
        raise ValueError(f"a {layout.kind} has no `radius`; use `spacing`, or another `kind`")
    if layout.kind == "circle" and {"radius", "spacing"} <= given.keys():
        raise ValueError("a circle has `radius` or `spacing`; remove one")
    if layout.kind == "random":
        return _place_at_random(layout, count, seed, path)
    spacing = layout.spacing
    if layout.kind == "circle" and layout.radius is not None and count > 1:
        spacing = 2.0 * layout.radius * math.sin(math.pi / count)
    spots = make_fleet_layout("r", count, layout.kind, spacing)
    return [PlaceSection(layout.x + one.x, layout.y + one.y, yaw=one.yaw) for one in spots]


def _place_at_random(layout: LayoutSection, count: int, seed: int, path: str) -> list[PlaceSection]:
    """Place robots in a square, each by draws of its own, apart from those before it."""
    half = layout.radius or layout.spacing * math.sqrt(count)
    spots: list[PlaceSection] = []
    for number in range(count):
        for spot in _draw_spots(layout, half, seed, f"{path}.layout[{number}]"):
            if all(math.dist((spot.x, spot.y), (o.x, o.y)) >= layout.spacing for o in spots):
                spots.append(spot)
                break
        else:
            raise ValueError(
                f"no room for {count} robots {layout.spacing:g} m apart in a square of "
                f"{2.0 * half:g} m; use a larger radius or a smaller spacing"
            )
    return spots


def _draw_spots(layout: LayoutSection, half: float, seed: int, path: str) -> Iterator[PlaceSection]:
    for attempt in range(MAX_TRIES):
        first, second = make_uniforms(seed, path, str(attempt))
        yaw = make_uniforms(seed, path, str(attempt), "yaw")[0] * 2.0 * math.pi
        x, y = layout.x + (2.0 * first - 1.0) * half, layout.y + (2.0 * second - 1.0) * half
        yield PlaceSection(x, y, yaw=yaw)


def read_pose_file(file: Path, place: Place, path: str) -> list[dict[str, Any]]:
    """Read poses: a CSV file with a head line name,x,y,z,roll,pitch,yaw, a JSON or a YAML list.

    A YAML list may be that of a launch file: below one key, with x_pose, y_pose and z_pose, numbers
    as texts, and robots that are not `enabled`, which are left out.

    Raises:
        ScenarioInvalid: The file or one of its lines is not valid.
    """
    try:
        text = read_text_file(file)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "cannot be read"
        raise fail_at(place, path, f"`{file}`: {reason.lower()}") from error
    is_list = file.suffix in POSE_LIST_SUFFIXES
    node = (
        _read_launch_list(read_yaml_nodes(text, str(file)))
        if is_list
        else _read_csv(text, str(file))
    )
    reader = TypedReader()
    rows = reader.read(node, inspect.type_info(tuple[PlaceSection, ...]), path)
    if reader.issues:
        raise ScenarioInvalid(tuple(reader.issues))
    return list(rows)


def _read_launch_list(node: ScenarioNode) -> ScenarioNode:
    """Read a list of robots of a launch file as poses; another list stays as it is."""
    if isinstance(node.value, dict) and len(node.value) == 1:
        (node,) = node.value.values()
    if not isinstance(node.value, list):
        return node
    return msgspec.structs.replace(
        node, value=[_read_launch_robot(one) for one in node.value if not _is_disabled(one)]
    )


def _is_disabled(robot: ScenarioNode) -> bool:
    enabled = robot.value.get("enabled") if isinstance(robot.value, dict) else None
    return enabled is not None and enabled.value is False


def _read_launch_robot(robot: ScenarioNode) -> ScenarioNode:
    if not isinstance(robot.value, dict):
        return robot
    values = {
        LAUNCH_KEYS.get(key, key): msgspec.structs.replace(one, value=_to_number(one.value))
        if isinstance(one.value, str) and key != "name"
        else one
        for key, one in robot.value.items()
        if key != "enabled"
    }
    places = {LAUNCH_KEYS.get(key, key): place for key, place in robot.key_places.items()}
    return msgspec.structs.replace(robot, value=values, key_places=places)


def _read_csv(text: str, file: str) -> ScenarioNode:
    lines = list(csv.reader(text.splitlines()))
    head = [word.strip() for word in lines[0]] if lines else []
    rows = []
    for number, cells in enumerate(lines[1:], start=2):
        if not any(cells):
            continue
        place = Place(file, number, 1)
        if len(cells) != len(head):
            mistake = f"{len(cells)} cells, but the head line has {len(head)}"
            raise ScenarioInvalid((Issue(place, "", mistake),))
        values = {
            key: ScenarioNode(place, cell.strip() if key == "name" else _to_number(cell))
            for key, cell in zip(head, cells, strict=True)
            if cell.strip()
        }
        rows.append(ScenarioNode(place, values, dict.fromkeys(values, place)))
    return ScenarioNode(Place(file, 1, 1), rows)


def _to_number(cell: str) -> str | float:
    try:
        return float(cell)
    except ValueError:
        return cell.strip()
