"""Maps of what is fixed, for map servers."""

import msgspec
import numpy as np
import pytest

from tests.models import a_box, on_ground
from tests.sim_server.fakes import a_spawn, a_world, handle_request, make_parts
from tests.sim_server.queries.worlds_with_boxes import parts_with_boxes, respond
from zensim.proto.messages.world_messages import GetMapRequest, GetMapResponse
from zensim.sim_server.queries.map_queries import MapRefused


def test_map_shows_what_is_fixed() -> None:
    grid = respond(parts_with_boxes(), GetMapRequest(0.05), GetMapResponse).map

    cells = np.frombuffer(grid.data, np.int8).reshape(grid.info.height, grid.info.width)
    row, column = np.nonzero(cells == 100)
    x = grid.info.origin.position.x + 0.05 * (column + 0.5)
    y = grid.info.origin.position.y + 0.05 * (row + 0.5)
    assert grid.header.frame_id == "map"
    assert grid.info.resolution == 0.05
    assert (x.mean(), y.mean()) == pytest.approx((3.0, 0.0), abs=0.05)
    assert (x.min(), x.max()) == pytest.approx((2.9, 3.1), abs=0.08)
    assert set(np.unique(cells).tolist()) == {0, 100}


@pytest.mark.parametrize(
    "request_",
    [
        GetMapRequest(0.0),
        GetMapRequest(-1.0),
        GetMapRequest(float("nan")),
        GetMapRequest(0.001),
        GetMapRequest(low_m=1.0, high_m=0.5),
        GetMapRequest(low_m=float("-inf")),
        GetMapRequest(high_m=float("nan")),
    ],
)
def test_map_that_cannot_be_drawn_is_refused(request_: GetMapRequest) -> None:
    with pytest.raises(MapRefused):
        handle_request(parts_with_boxes(), request_)


def test_map_of_a_huge_world_is_refused() -> None:
    world = a_world()
    pillar = msgspec.structs.replace(a_box(), is_static=True)
    world.spawn(a_spawn("pillar", model=pillar, base=on_ground(900.0)))

    with pytest.raises(MapRefused):
        handle_request(make_parts(world), GetMapRequest(0.005))
