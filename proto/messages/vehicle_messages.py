"""What vehicles of a fleet manager do, for who looks at the world."""

from typing import ClassVar

import msgspec

MAX_ROUTE_POINTS = 32


class VehicleStatus(msgspec.Struct, frozen=True, gc=False):
    """Order, battery and errors of one vehicle."""

    ros_type: ClassVar[str] = "zensim/msg/VehicleStatus"

    entity: str = ""
    order: str = ""
    """Id of its last order; empty = it had none."""
    task: str = ""
    """idle, driving, waiting (its order lets it stand), paused or charging."""
    last_node: str = ""
    goal: str = ""
    """Last node to which it may drive; empty = it is there."""
    battery_percent: float = 100.0
    errors: tuple[str, ...] = ()
    route: bytes = b""
    """x, y [m] of at most 32 points from the vehicle to its goal, float32 (k, 2), little-endian."""


class FleetStatus(msgspec.Struct, frozen=True):
    """All vehicles of one program."""

    ros_type: ClassVar[str] = "zensim/msg/FleetStatus"

    vehicles: tuple[VehicleStatus, ...] = ()
