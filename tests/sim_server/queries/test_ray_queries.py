"""Rays of requests: hits by name, refusals, and time slices."""

import pytest

from tests.models import a_box, on_ground
from tests.sim_server.fakes import WallTime, a_spawn, a_world, handle_request, make_parts
from tests.sim_server.queries.worlds_with_boxes import parts_with_boxes, respond
from zensim.proto.messages.entity_messages import NOTHING_HIT_M, CastRaysRequest, CastRaysResponse
from zensim.proto.messages.standard_messages import Point, Vector3
from zensim.sim_server.errors import EntityNotFound
from zensim.sim_server.queries.ray_queries import MAX_RAYS, RaysRefused
from zensim.sim_server.queries.sliced_work import MAX_WORK_S
from zensim.sim_server.service_parts import DeferredResponse

AHEAD = Vector3(2.0, 0.0, 0.0)
DOWN = Vector3(0.0, 0.0, -1.0)
LOW = Point(0.0, 0.0, 0.05)


def test_rays_hit_the_nearest_entity_the_ground_or_nothing() -> None:
    up = Vector3(0.0, 0.0, 1.0)
    request = CastRaysRequest((LOW, LOW, LOW), (AHEAD, DOWN, up))

    response = respond(parts_with_boxes(), request, CastRaysResponse)

    assert response.entities == ("near", "", "")
    assert response.ranges == pytest.approx((2.9, 0.05, NOTHING_HIT_M))


def test_rays_pass_through_the_ignored_entity() -> None:
    request = CastRaysRequest((LOW,), (AHEAD,), ignored_entity="near")

    assert respond(parts_with_boxes(), request, CastRaysResponse).entities == ("far",)


def test_nothing_is_hit_beyond_the_range() -> None:
    request = CastRaysRequest((LOW,), (AHEAD,), range_max_m=2.0)

    assert respond(parts_with_boxes(), request, CastRaysResponse).ranges == (NOTHING_HIT_M,)


def test_no_rays_have_no_hits() -> None:
    assert respond(parts_with_boxes(), CastRaysRequest(), CastRaysResponse) == CastRaysResponse()


@pytest.mark.parametrize(
    "request_",
    [
        CastRaysRequest((LOW,), ()),
        CastRaysRequest((LOW,), (Vector3(),)),
        CastRaysRequest((LOW,), (Vector3(float("inf")),)),
        CastRaysRequest((Point(float("nan")),), (AHEAD,)),
        CastRaysRequest((LOW,), (AHEAD,), range_max_m=0.0),
        CastRaysRequest((LOW,), (AHEAD,), range_max_m=float("nan")),
        CastRaysRequest((LOW,), (AHEAD,), range_max_m=float("inf")),
        CastRaysRequest((LOW,) * (MAX_RAYS + 1), (AHEAD,) * (MAX_RAYS + 1)),
    ],
)
def test_rays_that_cannot_be_cast_are_refused(request_: CastRaysRequest) -> None:
    with pytest.raises(RaysRefused):
        handle_request(parts_with_boxes(), request_)


def test_unknown_entity_to_pass_through_is_not_found() -> None:
    with pytest.raises(EntityNotFound):
        handle_request(parts_with_boxes(), CastRaysRequest(ignored_entity="r9"))


class SlowWall(WallTime):
    """A clock that moves at each reading."""

    pace_s = 0.1

    def now_ns(self) -> int:
        self.ns += int(self.pace_s * 1e9)
        return self.ns


def test_many_rays_take_several_turns_and_hit_the_world_of_the_first() -> None:
    world = a_world(*[f"r{i}" for i in range(40)])
    world.spawn(a_spawn("crate", model=a_box(), base=on_ground(-3.0)))
    backward = Vector3(-1.0, 0.0, 0.0)
    wall = SlowWall()
    wall.pace_s = 0.003
    origin = Point(-1.0, 0.0, 0.05)
    response = handle_request(
        make_parts(world, wall), CastRaysRequest((origin,) * 2000, (backward,) * 2000)
    )
    assert isinstance(response, DeferredResponse)
    world.delete("crate")

    turns = 1
    while not response.is_ready():
        turns += 1

    assert turns >= 2
    found = response.outcome()
    assert isinstance(found, CastRaysResponse)
    assert set(found.entities) == {"crate"}


def test_rays_that_take_too_long_are_refused() -> None:
    wall = SlowWall()
    world = a_world(*[f"r{i}" for i in range(40)])
    response = handle_request(
        make_parts(world, wall), CastRaysRequest((LOW,) * 5000, (AHEAD,) * 5000)
    )
    assert isinstance(response, DeferredResponse)

    wall.pace_s = 2.0 * MAX_WORK_S
    while not response.is_ready():
        pass

    with pytest.raises(RaysRefused):
        response.outcome()
