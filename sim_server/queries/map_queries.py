"""Maps of the world's fixed collisions, drawn in time slices."""

import math

import numpy as np

from zensim.proto.messages.standard_messages import (
    Header,
    MapMetaData,
    OccupancyGrid,
    Point,
    Pose,
    time_from_ns,
)
from zensim.proto.messages.world_messages import GetMapRequest, GetMapResponse
from zensim.sim_server.errors import SimError
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.queries.sliced_work import MAX_WORK_S, SlicedWork
from zensim.sim_server.scene.occupancy_grid import GridTooLarge, OccupancyDrawing, plan_grid
from zensim.sim_server.service_parts import DeferredResponse, Pacing
from zensim.sim_server.world.simulated_world import SimulatedWorld

MAP_FRAME = "map"
MIN_RESOLUTION_M, MAX_RESOLUTION_M = 0.005, 10.0


class MapRefused(SimError):
    """A map that cannot be drawn."""

    slug = "map.refused"


def get_map(
    world: SimulatedWorld, store: AssetStore, pacing: Pacing, request: GetMapRequest
) -> GetMapResponse | DeferredResponse[GetMapResponse]:
    """Draw what is fixed in the world.

    Raises:
        MapRefused: The request is not valid, or the map would be too large.
    """
    _check_request(request)
    scene = world.scene(store.vertices, store.corners)
    band = request.low_m, request.high_m
    try:
        drawing = plan_grid(
            scene.shapes, np.flatnonzero(scene.is_fixed), band, request.resolution_m
        )
    except GridTooLarge as error:
        raise MapRefused(f"the map would have {error}; use a coarser resolution") from error
    time_ns = world.clock.time_ns
    work = SlicedWork(drawing.draw(), pacing)
    return work.respond(lambda: _finish(work, drawing, time_ns))


def _check_request(request: GetMapRequest) -> None:
    if not MIN_RESOLUTION_M <= request.resolution_m <= MAX_RESOLUTION_M:
        raise MapRefused(
            f"resolution_m is {request.resolution_m:g}; use {MIN_RESOLUTION_M:g} to "
            f"{MAX_RESOLUTION_M:g}"
        )
    if not (
        math.isfinite(request.low_m)
        and math.isfinite(request.high_m)
        and request.low_m <= request.high_m
    ):
        raise MapRefused(
            f"heights are {request.low_m:g} to {request.high_m:g}; use finite, rising numbers"
        )


def _finish(work: SlicedWork, drawing: OccupancyDrawing, time_ns: int) -> GetMapResponse:
    if work.is_too_long:
        raise MapRefused(f"drawing took more than {MAX_WORK_S:g} s; use a coarser resolution")
    frame, time = drawing.frame, time_from_ns(time_ns)
    x, y = frame.corner.tolist()
    info = MapMetaData(time, frame.resolution_m, frame.width, frame.height, Pose(Point(x, y)))
    return GetMapResponse(map=OccupancyGrid(Header(time, MAP_FRAME), info, drawing.cells.tobytes()))
