"""Names and poses of the robots of a fleet."""

import math
from collections.abc import Iterator
from typing import Literal

import msgspec
from msgspec.structs import astuple

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.standard_messages import Point, Pose, Quaternion
from zensim.proto.names import check_name
from zensim.proto.rigid_transforms import find_yaw, from_rpy

FleetLayout = Literal["row", "grid", "circle"]
LAYOUTS: tuple[FleetLayout, ...] = ("row", "grid", "circle")


class RobotPlacement(msgspec.Struct, frozen=True):
    """One robot of a fleet: name, position [m], heading [rad]."""

    name: str
    x: float
    y: float
    yaw: float = 0.0


def make_fleet_layout(
    prefix: str, count: int, layout: FleetLayout, spacing_m: float
) -> list[RobotPlacement]:
    """Arrange `count` robots named `prefix0`, `prefix1` and so on.

    Args:
        prefix: Start of each name.
        count: > 0.
        layout: row = along x; grid = rows of about sqrt(count); circle = facing outward.
        spacing_m: Distance between neighbours; > 0.

    Raises:
        ValueError: A number is out of range.
    """
    if count < 1 or not spacing_m > 0 or not math.isfinite(spacing_m):
        raise ValueError(
            f"a fleet needs a count >= 1 and a spacing > 0 m, got {count} and {spacing_m:g}"
        )
    poses = {"row": _row, "grid": _grid, "circle": _circle}[layout](count, spacing_m)
    return [RobotPlacement(f"{prefix}{i}", *pose) for i, pose in enumerate(poses)]


def _row(count: int, spacing_m: float) -> Iterator[tuple[float, float, float]]:
    for i in range(count):
        yield i * spacing_m, 0.0, 0.0


def _grid(count: int, spacing_m: float) -> Iterator[tuple[float, float, float]]:
    columns = math.ceil(math.sqrt(count))
    for i in range(count):
        row, column = divmod(i, columns)
        yield column * spacing_m, row * spacing_m, 0.0


def _circle(count: int, spacing_m: float) -> Iterator[tuple[float, float, float]]:
    # The chord between neighbours is the spacing; a single robot is at the centre.
    radius_m = 0.0 if count == 1 else spacing_m / (2.0 * math.sin(math.pi / count))
    for i in range(count):
        angle = 2.0 * math.pi * i / count
        yield radius_m * math.cos(angle), radius_m * math.sin(angle), angle


def derive_prefix(model: str) -> str:
    """Derive a name prefix from a model: its name, or its file name without suffix.

    Raises:
        InvalidName: The result is not a valid name.
    """
    return check_name(model.rsplit("/", 1)[-1].split(".", 1)[0], "prefix")


def make_pose(
    position: tuple[float, float, float], angles: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Pose:
    """Make a pose from x, y, z [m] and fixed-axis roll, pitch, yaw [rad]."""
    return Pose(Point(*position), Quaternion(*from_rpy(*angles)))


def find_heading(orientation: Quaternion) -> float:
    """Find the angle about z [rad]."""
    return find_yaw(astuple(orientation), FLOAT_MATH)
