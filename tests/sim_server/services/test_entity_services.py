"""Info, bounds and states of entities."""

import math
from itertools import product

import msgspec
import pytest

from tests.models import WHEEL_RADIUS_M, a_box, a_cart, a_puck, an_arm, on_ground
from tests.sim_server.fakes import a_spawn, a_world, handle_request, make_parts
from tests.sim_server.orders import an_order, spawned
from zensim.proto.messages import entity_messages
from zensim.proto.messages.entity_messages import (
    Bounds,
    BoundsType,
    Category,
    EntityCategory,
    EntityFilters,
    EntityInfo,
)
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.simulation_messages import ResetScope, ResetSimulationRequest
from zensim.proto.messages.spawn_messages import SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Vector3
from zensim.sim_server.errors import SimError, UnsupportedFeature
from zensim.sim_server.queries.bounds_queries import BoundsUnsupported
from zensim.sim_server.service_parts import ServerParts

HUMAN = EntityInfo(EntityCategory(Category.HUMAN), "walks about", ("slow", "tall"))


def info_of(parts: ServerParts, name: str) -> EntityInfo:
    response = handle_request(parts, entity_messages.GetEntityInfoRequest(name))
    assert isinstance(response, entity_messages.GetEntityInfoResponse)
    return response.info


def bounds_of(parts: ServerParts, name: str, kind: int = entity_messages.ANY_BOUNDS) -> Bounds:
    response = handle_request(parts, entity_messages.GetEntityBoundsOrder(name, kind))
    assert isinstance(response, entity_messages.GetEntityBoundsResponse)
    return response.bounds


def corners(bounds: Bounds) -> list[tuple[float, float, float]]:
    return [(point.x, point.y, point.z) for point in bounds.points]


@pytest.mark.parametrize(
    ("model", "category"),
    [
        (a_cart(), Category.ROBOT),
        (a_puck(), Category.ROBOT),
        (a_box(), Category.OBJECT),
        (a_box(is_static=True), Category.STATIC_OBJECT),
    ],
)
def test_info_follows_from_the_model_unless_it_is_set(model: Model, category: Category) -> None:
    world = a_world()
    world.spawn(a_spawn("e", model=model))

    info = info_of(make_parts(world), "e")

    assert info == EntityInfo(EntityCategory(category), model.name)


def test_info_is_set_and_kept_through_a_reset_of_states() -> None:
    parts = make_parts(a_world("r0"))

    handle_request(parts, entity_messages.SetEntityInfoRequest("r0", HUMAN))
    handle_request(parts, ResetSimulationRequest(ResetScope.STATE))

    assert info_of(parts, "r0") == HUMAN


def test_info_may_come_with_the_spawn() -> None:
    parts = make_parts(a_world())

    spawned(parts, SpawnEntityOrder("r", entity_resource=an_order().entity_resource, info=HUMAN))

    assert info_of(parts, "r") == HUMAN


def test_tags_are_kept_once_each() -> None:
    parts = make_parts(a_world("r0"))

    handle_request(
        parts, entity_messages.SetEntityInfoRequest("r0", EntityInfo(tags=("a", "b", "a")))
    )

    assert info_of(parts, "r0").tags == ("a", "b")


@pytest.mark.parametrize(
    ("info", "named"),
    [
        (EntityInfo(EntityCategory(3)), "category 3"),
        (EntityInfo(description="x" * 5000), "5000"),
        (EntityInfo(tags=tuple(f"t{i}" for i in range(65))), "65"),
        (EntityInfo(tags=("",)), "128"),
        (EntityInfo(tags=("x" * 129,)), "128"),
    ],
)
def test_invalid_info_is_refused(info: EntityInfo, named: str) -> None:
    parts = make_parts(a_world("r0"))

    with pytest.raises(SimError, match=named):
        handle_request(parts, entity_messages.SetEntityInfoRequest("r0", info))

    assert info_of(parts, "r0").category.category == Category.ROBOT


@pytest.mark.parametrize(
    "request_",
    [
        entity_messages.GetEntityInfoRequest("r9"),
        entity_messages.SetEntityInfoRequest("r9", HUMAN),
        entity_messages.GetEntityBoundsOrder("r9"),
        entity_messages.GetEntityStateOrder("r9"),
        entity_messages.GetEntityStateOrder("r0", "r9"),
        entity_messages.GetEntitiesStatesOrder(EntityFilters(), "r9"),
    ],
)
def test_unknown_entity_or_frame_is_not_found(request_: msgspec.Struct) -> None:
    with pytest.raises(SimError) as error:
        handle_request(make_parts(a_world("r0")), request_)

    assert error.value.code == ResultCode.NOT_FOUND


def test_box_is_of_the_collisions_in_the_frame_of_the_base_upper_corner_first() -> None:
    world = a_world()
    world.spawn(a_spawn("e", model=a_puck(), base=on_ground(7.0, 8.0, 1.0)))

    bounds = bounds_of(make_parts(world), "e")

    assert bounds.type == BoundsType.BOX
    upper, lower = corners(bounds)
    assert upper == pytest.approx((0.2, 0.1, 0.1))
    assert lower == pytest.approx((-0.1, -0.1, 0.0))


def test_bounds_follow_the_joints() -> None:
    parts = make_parts(a_world("r0"))
    upper, lower = corners(bounds_of(parts, "r0"))

    assert upper == pytest.approx((0.125, 0.15 + WHEEL_RADIUS_M, WHEEL_RADIUS_M))
    assert lower[1] == pytest.approx(-0.15 - WHEEL_RADIUS_M)


def test_hull_of_a_box_is_its_corners() -> None:
    world = a_world()
    world.spawn(a_spawn("e", model=a_box(side_m=0.2), base=on_ground(7.0)))

    hull = bounds_of(make_parts(world), "e", BoundsType.CONVEX_HULL)

    assert hull.type == BoundsType.CONVEX_HULL
    found = {tuple(round(part, 9) for part in corner) for corner in corners(hull)}
    assert found == set(product((-0.1, 0.1), repeat=3))
    assert len(hull.points) == 8


def test_sphere_holds_the_box() -> None:
    world = a_world()
    world.spawn(a_spawn("e", model=a_box(side_m=0.2)))

    sphere = bounds_of(make_parts(world), "e", BoundsType.SPHERE)

    assert sphere.points[0] == Vector3()
    assert sphere.points[1].x == pytest.approx(0.1 * math.sqrt(3.0))


def test_bounds_are_empty_without_collisions() -> None:
    world = a_world()
    world.spawn(a_spawn("e", model=an_arm("continuous")))

    assert bounds_of(make_parts(world), "e") == Bounds()


@pytest.mark.parametrize("kind", [0, 4, 200])
def test_bounds_of_no_type_are_unsupported(kind: int) -> None:
    with pytest.raises(BoundsUnsupported) as error:
        bounds_of(make_parts(a_world("r0")), "r0", kind)

    assert error.value.code == ResultCode.FEATURE_UNSUPPORTED


def test_state_is_returned_in_the_frame_of_another_entity() -> None:
    world = a_world("r0", "r1")
    world.place("r1", on_ground(1.0, 2.0, math.pi / 2.0))

    response = handle_request(make_parts(world), entity_messages.GetEntityStateOrder("r0", "r1"))

    assert isinstance(response, entity_messages.GetEntityStateResponse)
    assert response.state.header.frame_id == "r1"
    place = response.state.pose.position
    assert (place.x, place.y, place.z) == pytest.approx((-2.0, 1.0, 0.0))


def test_states_of_all_that_pass_are_of_one_step() -> None:
    parts = make_parts(a_world("r0", "r1", "x"))

    response = handle_request(parts, entity_messages.GetEntitiesStatesOrder(EntityFilters("^r")))

    assert isinstance(response, entity_messages.GetEntitiesStatesResponse)
    assert response.entities == ("r0", "r1")
    assert [state.pose.position for state in response.states] == [
        Point(0.0, 0.0, WHEEL_RADIUS_M),
        Point(1.0, 0.0, WHEEL_RADIUS_M),
    ]


def test_states_are_empty_when_no_entity_passes() -> None:
    response = handle_request(
        make_parts(a_world("r0")), entity_messages.GetEntitiesStatesOrder(EntityFilters("x"))
    )

    assert response == entity_messages.GetEntitiesStatesResponse()


def test_acceleration_cannot_be_set() -> None:
    parts = make_parts(a_world("r0"))

    with pytest.raises(UnsupportedFeature) as error:
        handle_request(parts, entity_messages.SetEntityStateRequest("r0", set_acceleration=True))

    assert error.value.code == ResultCode.FEATURE_UNSUPPORTED
