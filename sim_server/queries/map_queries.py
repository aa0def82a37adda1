"""Maps of the world's fixed collisions, drawn in time slices."""

import math
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import (
    Header,
    MapMetaData,
    OccupancyGrid,
    Point,
    Pose,
    time_from_ns,
)
from zensim.proto.messages.world_messages import GetMapRequest, GetMapResponse
from zensim.proto.se3 import FloatArray
from zensim.sim_server.errors import SimError
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.physics.engine import can_move
from zensim.sim_server.queries.sliced_work import MAX_WORK_S, SlicedWork
from zensim.sim_server.scene.occupancy_grid import (
    MAX_CELLS,
    GridTooLarge,
    OccupancyDrawing,
    plan_grid,
)
from zensim.sim_server.scene.ray_casting import PlacedShapes
from zensim.sim_server.scene.scene import SceneLayout
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
    return draw_map(world, store, pacing, request, MAX_CELLS)


def draw_map(
    world: SimulatedWorld, store: AssetStore, pacing: Pacing, request: GetMapRequest, max_cells: int
) -> GetMapResponse | DeferredResponse[GetMapResponse]:
    """Draw what is fixed in the world, in at most so many cells; see `get_map`."""
    shapes = _place_fixed_shapes(world, store)
    band = request.low_m, request.high_m
    try:
        everything = np.arange(len(shapes.geometry))
        drawing = plan_grid(shapes, everything, band, request.resolution_m, max_cells)
    except GridTooLarge as error:
        raise MapRefused(f"the map would have {error}; use a coarser resolution") from error
    time_ns = world.clock.time_ns
    work = SlicedWork(drawing.draw(), pacing)
    return work.respond(lambda: _finish(work, drawing, time_ns))


@dataclass(frozen=True)
class FixedEntities:
    """Entities of which no link moves unless a request moves them as a whole.

    Attributes:
        models: Of each.
        base: (n, 13) states of their root links.
    """

    models: tuple[Model, ...]
    base: FloatArray


def find_fixed_entities(world: SimulatedWorld) -> FixedEntities:
    """Find what is fixed."""
    found = [(row, one.model) for row, one in enumerate(world.entities) if not can_move(one.model)]
    rows = np.array([row for row, _ in found], dtype=np.intp)
    return FixedEntities(tuple(model for _, model in found), world.states().base[rows])


def _place_fixed_shapes(world: SimulatedWorld, store: AssetStore) -> PlacedShapes:
    """Place the shapes of what is fixed: robots, of which there may be many, are left out."""
    fixed = find_fixed_entities(world)
    layout = SceneLayout(fixed.models, store.vertices, store.corners)
    joints = np.zeros(sum(len(model.joints) for model in fixed.models))
    return layout.place(fixed.base, joints)


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
