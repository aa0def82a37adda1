"""Rays that requests cast at the collisions of all entities, in time slices."""

from collections.abc import Iterator

import numpy as np

from zensim.proto.messages.entity_messages import NOTHING_HIT_M, CastRaysRequest, CastRaysResponse
from zensim.proto.messages.standard_messages import Point, Vector3
from zensim.proto.se3 import FloatArray
from zensim.sim_server.errors import SimError
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.queries.sliced_work import MAX_WORK_S, SlicedWork
from zensim.sim_server.scene.ray_casting import (
    NO_ENTITY,
    PlacedShapes,
    RayHits,
    Rays,
    cast_rays_exactly,
)
from zensim.sim_server.service_parts import CurrentWorld, DeferredResponse, Pacing
from zensim.sim_server.world.simulated_world import SimulatedWorld

MAX_RAYS = 10_000
TESTS_PER_TURN = 1 << 15
"""Rays times shapes and triangles that are tested in one turn of the loop."""


MAX_COORDINATE_M = 1e9


class RaysRefused(SimError):
    """Rays that cannot be cast."""

    slug = "rays.refused"


def cast_rays(
    world: SimulatedWorld,
    store: AssetStore,
    current: CurrentWorld,
    pacing: Pacing,
    request: CastRaysRequest,
) -> CastRaysResponse | DeferredResponse[CastRaysResponse]:
    """Find what rays hit first, as the entities are now.

    Raises:
        RaysRefused: The request is not valid.
        EntityNotFound: The entity to pass through does not exist.
    """
    ignored = NO_ENTITY
    if request.ignored_entity:
        ignored = world.entities.index.row[world.entities.find(request.ignored_entity).name]
    rays = _read_rays(request, ignored)
    scene = world.scene(store.vertices, store.corners, has_ground=current.model.ground_plane)
    hits = RayHits(np.full(len(rays.origins), np.inf), np.full(len(rays.origins), NO_ENTITY))
    work = SlicedWork(_cast(scene.shapes, rays, hits), pacing)
    names = world.entities.index.names
    return work.respond(lambda: _finish(work, hits, names))


def _read_rays(request: CastRaysRequest, ignored: int) -> Rays:
    count = len(request.origins)
    if count != len(request.directions) or count > MAX_RAYS:
        raise RaysRefused(
            f"{count} origins and {len(request.directions)} directions; send as many of each, "
            f"at most {MAX_RAYS}"
        )
    if not 0.0 < request.range_max_m < np.inf:
        raise RaysRefused(f"range_max_m is {request.range_max_m:g}; use a positive number")
    origins, directions = _read_vectors(request.origins), _read_vectors(request.directions)
    largest = np.abs(directions).max(axis=1, initial=0.0, keepdims=True)
    is_far = ~(np.abs(origins) <= MAX_COORDINATE_M).all(axis=1)
    is_wrong = is_far | ~np.isfinite(largest[:, 0]) | (largest[:, 0] == 0.0)
    if is_wrong.any():
        raise RaysRefused(
            f"ray {int(np.argmax(is_wrong))} begins beyond {MAX_COORDINATE_M:g} m or has no "
            "direction; use finite numbers, and no direction of length 0"
        )
    # Squares of huge directions would overflow.
    directions /= largest
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Rays(origins, directions, request.range_max_m, np.full(count, ignored))


def _read_vectors(vectors: tuple[Point, ...] | tuple[Vector3, ...]) -> FloatArray:
    return np.array([(one.x, one.y, one.z) for one in vectors], dtype=np.float64).reshape(-1, 3)


def _cast(shapes: PlacedShapes, rays: Rays, hits: RayHits) -> Iterator[None]:
    """Cast some rays in each step."""
    tests = len(shapes.entity) + sum(
        len(shapes.geometries[number].triangles) for number in shapes.geometry.tolist()
    )
    batch = max(1, TESTS_PER_TURN // max(tests, 1))
    for start in range(0, len(rays.origins), batch):
        part = slice(start, start + batch)
        found = cast_rays_exactly(
            shapes,
            Rays(rays.origins[part], rays.directions[part], rays.max_range_m, rays.ignored[part]),
        )
        hits.ranges[part], hits.entities[part] = found.ranges, found.entities
        yield


def _finish(work: SlicedWork, hits: RayHits, names: tuple[str, ...]) -> CastRaysResponse:
    if work.is_too_long:
        raise RaysRefused(f"the rays took more than {MAX_WORK_S:g} s; send fewer in one request")
    ranges = np.where(np.isfinite(hits.ranges), hits.ranges, NOTHING_HIT_M)
    entities = tuple(names[row] if row >= 0 else "" for row in hits.entities.tolist())
    return CastRaysResponse(ranges=tuple(ranges.tolist()), entities=entities)
