"""Topic `map`: what is fixed in the world, drawn when there is a subscriber."""

import logging
from collections.abc import Callable

import msgspec

from zensim.proto.messages.standard_messages import OccupancyGrid
from zensim.proto.messages.world_messages import GetMapRequest, GetMapResponse
from zensim.proto.rate_limiter import RateLimiter
from zensim.proto.topic_catalog import MAP, TopicSpec
from zensim.sim_server.queries.map_queries import (
    MAX_RESOLUTION_M,
    MapRefused,
    draw_map,
    find_fixed_entities,
)
from zensim.sim_server.runtime.loop_channels import WorldPublisher
from zensim.sim_server.service_parts import DeferredResponse, ServerParts

CHECK_HZ = 5.0
"""Rate of wall time at which subscribers and changes of the world are looked for."""
MAX_CELLS = 1 << 22
"""Cells of the map: encoding and sending more would delay steps by more than 10 ms."""
LOG = logging.getLogger(__name__)


class WorldMap:
    """The map of the topic: as `get_map` draws it, but coarser in a large world.

    It is drawn in time slices when the first subscriber appears, and again when something fixed was
    added, moved or removed while there is a subscriber.
    """

    def __init__(
        self,
        parts: ServerParts,
        *,
        is_wanted: Callable[[TopicSpec], bool],
        publish: Callable[[TopicSpec, msgspec.Struct], None],
        serve_late_subscribers: Callable[[], None],
    ) -> None:
        """Draw nothing yet.

        Args:
            parts: With the world.
            is_wanted: Whether a topic has a subscriber.
            publish: Publishes a message.
            serve_late_subscribers: Publishes the last message to new subscribers.
        """
        self._parts = parts
        self._is_wanted, self._publish_message = is_wanted, publish
        self._serve_late_subscribers = serve_late_subscribers
        self.restart()

    def restart(self) -> None:
        """Forget what is drawn, and the time of the last look."""
        self._limiter = RateLimiter(CHECK_HZ)
        self._version: tuple[object, ...] = ()
        """Changes whenever an entity may have been added, moved or removed."""
        self._drawn: tuple[object, ...] = ()
        """Models and states of the entities on the map."""
        self._resolution_m = 0.0
        self._drawing: DeferredResponse[GetMapResponse] | None = None
        self._grid: OccupancyGrid | None = None

    def poll(self, now_ns: int) -> None:
        """Serve late subscribers, and continue or start a drawing.

        Args:
            now_ns: Wall time.
        """
        if self._drawing is not None:
            self._continue(self._drawing)
        if self._limiter.is_due(now_ns):
            self._serve_late_subscribers()
            if self._drawing is None and self._is_wanted(MAP):
                self._update()

    def message(self) -> OccupancyGrid | DeferredResponse[OccupancyGrid]:
        """Make the map, or one that is drawn in later turns of the loop."""
        if self._drawing is None:
            self._update()
        if self._drawing is None:
            return self._find_grid()
        return DeferredResponse(lambda: self._drawing is None, self._find_grid)

    def draw(self) -> OccupancyGrid:
        """Draw the map at once.

        Raises:
            MapRefused: The world is too large.
        """
        self.message()
        while self._drawing is not None:
            self._continue(self._drawing)
        return self._find_grid()

    def _find_grid(self) -> OccupancyGrid:
        if self._grid is None:
            raise MapRefused("the world is too large for a map; use get_map with narrower heights")
        return self._grid

    def _update(self) -> None:
        """Start to draw the map again if what is fixed has changed."""
        world = self._parts.world
        version = world.entities.roster_number, world.placement_count, world.clock.epoch
        if version == self._version:
            return
        self._version = version
        found = find_fixed_entities(world)
        fixed = found.models, found.base.tobytes()
        if fixed != self._drawn:
            self._drawn, self._grid = fixed, None
            self._draw(GetMapRequest().resolution_m)

    def _draw(self, resolution_m: float) -> None:
        """Start to draw; at twice the resolution if the grid would be too large."""
        parts = self._parts
        self._resolution_m, self._drawing = resolution_m, None
        if resolution_m > MAX_RESOLUTION_M:
            LOG.warning("map world=%s reason='the world is too large'", parts.world.name)
            return
        request = GetMapRequest(resolution_m)
        try:
            response = draw_map(parts.world, parts.store, parts.pacing, request, MAX_CELLS)
        except MapRefused:
            self._draw(2.0 * resolution_m)
            return
        if isinstance(response, DeferredResponse):
            self._drawing = response
        else:
            self._publish(response.map)

    def _continue(self, drawing: DeferredResponse[GetMapResponse]) -> None:
        """Draw for one time slice; publish the map if it is done."""
        if not drawing.is_ready():
            return
        try:
            grid = drawing.outcome().map
        except MapRefused:
            self._draw(2.0 * self._resolution_m)
            return
        self._drawing = None
        self._publish(grid)

    def _publish(self, grid: OccupancyGrid) -> None:
        self._grid = grid
        self._publish_message(MAP, grid)


def make_world_map(parts: ServerParts, publisher: WorldPublisher) -> WorldMap:
    """Make the map of a server, which is published with its other topics."""
    return WorldMap(
        parts,
        is_wanted=publisher.is_wanted,
        publish=publisher.publish,
        serve_late_subscribers=publisher.serve_late_subscribers,
    )
