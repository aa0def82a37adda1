"""Orders of vehicles, shown to a visitor: what those selected do, and their routes."""

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
import viser

from zensim.proto.messages.vehicle_messages import FleetStatus, VehicleStatus
from zensim.spawner.client.vehicle_statuses import VehicleStatuses
from zensim.spawner.page.model_visuals import Array
from zensim.spawner.page.motion_overlays import Colour, Segments, make_segment_colours
from zensim.spawner.page.side_panel import WatchedTopic
from zensim.spawner.page.viewer_client import PageState

VEHICLES_WATCH: Final = WatchedTopic("vehicles")
ROUTE_COLOUR: Final[Colour] = (204, 121, 167)
"""Reddish purple, distinct from arrows in all kinds of colour blindness (Okabe and Ito, 2008)."""
ROUTE_PX: Final = 3.0
ROUTE_HEIGHT_M: Final = 0.02
"""Height above the origin of the base: above trails."""


class VehicleDisplay:
    """The vehicles of a world, and the routes that are drawn of them."""

    def __init__(self, scene: viser.SceneApi) -> None:
        """Draw nothing yet."""
        self._scene = scene
        self._statuses = VehicleStatuses()
        self._routes = Segments(self._add)

    def receive(self, message: msgspec.Struct) -> None:
        """Take a report; messages of other topics are ignored."""
        if isinstance(message, FleetStatus):
            self._statuses.receive(message)

    def find(self, entity: str) -> VehicleStatus | None:
        """Find what a vehicle does; None if no program has said so of late."""
        return self._statuses.find(entity)

    def find_order(self, entity: str) -> str:
        """Find the order of a vehicle; empty if there is none."""
        vehicle = self.find(entity)
        return vehicle.order if vehicle is not None else ""

    def draw(self, entities: Sequence[str], state: PageState) -> None:
        """Draw the routes of exactly these entities."""
        found = [(state.state_of(name)[:3], self.find(name)) for name in entities]
        segments = [make_route_segments(at, one) for at, one in found if one is not None]
        self._routes.show(np.concatenate([np.zeros((0, 2, 3)), *segments]))

    def _add(self, segments: Array) -> viser.LineSegmentsHandle:
        return self._scene.add_line_segments(
            "/routes",
            segments,
            make_segment_colours([ROUTE_COLOUR], len(segments)),
            thickness=ROUTE_PX,
            thickness_units="screen",
        )


def make_route_segments(position: Array, status: VehicleStatus) -> Array:
    """Make the segments (k, 2, 3) of the route that is left [m].

    Args:
        position: Of the vehicle now (3,), from which the route begins.
        status: What was said of it; a route that is no list of points is none.
    """
    if len(status.route) % 8:
        return np.zeros((0, 2, 3))
    points = np.frombuffer(status.route, "<f4").reshape(-1, 2)
    height = np.full((len(points), 1), position[2] + ROUTE_HEIGHT_M)
    line = np.hstack([points, height]).astype(np.float32)
    line[:1, :2] = position[:2]
    found: Array = np.stack([line[:-1], line[1:]], axis=1)
    return found if np.isfinite(found).all() else found[:0]
