"""The topic `map`: drawn for subscribers, again after changes, and for gets."""

import threading

import numpy as np
import pytest

from tests.fakes import MemoryBus
from tests.models import a_box, on_ground
from tests.sim_server.fakes import ServerFixture, a_server, a_spawn, answer_of
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.entity_messages import GetEntitiesRequest
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.spawn_messages import DeleteEntityResponse
from zensim.proto.messages.standard_messages import OccupancyGrid
from zensim.proto.messages.world_messages import GetMapResponse
from zensim.proto.topic_endpoints import TopicFactory
from zensim.sim_server.runtime import world_map
from zensim.sim_server.runtime.loop_channels import BusWorldPublisher
from zensim.sim_server.runtime.world_map import make_world_map
from zensim.sim_server.service_parts import DeferredResponse

PILLAR = a_box(is_static=True)
FAR_M = 300.0


def a_server_with_pillar(x: float = 3.0) -> ServerFixture:
    server = a_server("r0")
    server.world.spawn(a_spawn("pillar", model=PILLAR, base=on_ground(x)))
    return server


def maps_of(server: ServerFixture) -> list[OccupancyGrid]:
    return [one for one in server.publisher.on("map") if isinstance(one, OccupancyGrid)]


def occupied_x(grid: OccupancyGrid) -> list[float]:
    """Find the columns of occupied cells, rounded to 0.5 m."""
    cells = np.frombuffer(grid.data, np.int8).reshape(grid.info.height, grid.info.width)
    columns = np.nonzero((cells == 100).any(axis=0))[0]
    x = grid.info.origin.position.x + grid.info.resolution * (columns + 0.5)
    return sorted(set((np.round(x * 2.0) / 2.0).tolist()))


def test_map_is_published_once_for_a_subscriber() -> None:
    server = a_server_with_pillar()

    server.turn_for(2.0)

    (grid,) = maps_of(server)
    assert occupied_x(grid) == [3.0]
    assert grid.header.frame_id == "map"
    assert grid.info.resolution == 0.05


def test_map_is_not_drawn_without_a_subscriber() -> None:
    server = a_server_with_pillar()
    server.publisher.unwanted.add("map")

    server.turn_for(1.0)

    assert maps_of(server) == []


def test_map_is_published_again_when_something_fixed_changes() -> None:
    server = a_server_with_pillar()
    server.turn_for(0.5)

    server.world.spawn(a_spawn("other", model=PILLAR, base=on_ground(5.0)))
    server.turn_for(0.5)
    server.world.place("pillar", on_ground(2.0))
    server.turn_for(0.5)
    server.world.delete("other")
    server.turn_for(0.5)

    assert [occupied_x(grid) for grid in maps_of(server)] == [[3.0], [3.0, 5.0], [2.0, 5.0], [2.0]]


def test_map_is_not_drawn_again_for_robots() -> None:
    server = a_server_with_pillar()
    server.turn_for(0.5)

    server.world.spawn(a_spawn("r1", base=on_ground(8.0)))
    server.world.place("r0", on_ground(9.0))
    server.turn_for(0.5)

    assert len(maps_of(server)) == 1


def test_map_of_a_large_world_is_coarser() -> None:
    server = a_server_with_pillar(FAR_M)
    server.world.spawn(a_spawn("other", model=PILLAR, base=on_ground(0.0, FAR_M)))

    server.turn_for(1.0)

    (grid,) = maps_of(server)
    assert grid.info.resolution == 0.2
    assert 0.0 in occupied_x(grid)


def test_get_returns_the_map_without_a_subscriber() -> None:
    server = a_server_with_pillar()
    server.publisher.unwanted.add("map")
    first = server.request("map", GetEntitiesRequest())
    server.turn_for(0.1)
    server.world.place("pillar", on_ground(1.0))
    second = server.request("map", GetEntitiesRequest())
    server.turn_for(0.1)

    replies = [answer_of(call, OccupancyGrid) for call in (first, second)]
    found = [occupied_x(reply) for reply in replies if isinstance(reply, OccupancyGrid)]
    assert found == [[3.0], [1.0]]


def test_get_of_a_map_that_cannot_be_drawn_is_refused() -> None:
    server = a_server_with_pillar(9e4)
    server.world.spawn(a_spawn("other", model=PILLAR, base=on_ground(0.0, 9e4)))
    call = server.request("map", GetEntitiesRequest())

    server.turn_for(0.5)

    refused = answer_of(call, DeleteEntityResponse)
    assert isinstance(refused, DeleteEntityResponse)
    assert refused.result.result == ResultCode.OPERATION_FAILED
    assert maps_of(server) == []


def test_late_subscribers_get_the_map_on_each_key() -> None:
    server, bus = a_server_with_pillar(), MemoryBus()
    publisher = BusWorldPublisher(bus, "w", TopicFactory(bus))
    drawn = make_world_map(server.parts, publisher)
    bus.pumps.append(lambda: drawn.poll(server.wall.ns))
    found = []
    for key in ("map", "sim/w/map"):
        listener = bus.subscribe(key)
        for _ in range(5):
            server.wall.ns += 250_000_000
            drawn.poll(server.wall.ns)
        sample = listener.newest()
        assert sample is not None
        found.append(decode(OccupancyGrid, sample.payload, sample.encoding))
    server.wall.ns += 250_000_000
    (sample,) = bus.get("map")
    found.append(decode(OccupancyGrid, sample.payload, sample.encoding))

    assert [occupied_x(grid) for grid in found] == [[3.0]] * 3


def test_map_is_drawn_at_once_where_steps_may_wait() -> None:
    server = a_server_with_pillar()

    assert occupied_x(make_world_map(server.parts, server.publisher).draw()) == [3.0]
    assert maps_of(server)


def test_get_during_a_drawing_has_its_map(monkeypatch: pytest.MonkeyPatch) -> None:
    server, is_drawn, grid = a_server_with_pillar(), threading.Event(), OccupancyGrid()
    drawing = DeferredResponse(is_drawn.is_set, lambda: GetMapResponse(map=grid))
    monkeypatch.setattr(world_map, "draw_map", lambda *_: drawing)
    drawn = make_world_map(server.parts, server.publisher)

    reply = drawn.message()
    assert isinstance(reply, DeferredResponse)
    assert not reply.is_ready()
    is_drawn.set()
    drawn.poll(server.wall.ns)

    assert reply.is_ready()
    assert reply.outcome() is grid
