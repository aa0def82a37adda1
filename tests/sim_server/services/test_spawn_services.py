"""Many spawns in one request: as many as can be, or all or none."""

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.engines import STEP_NS, ObedientEngine
from tests.sim_server.fakes import (
    InlineParser,
    WallTime,
    a_world,
    handle_request,
    kinds_of_events,
    make_parts,
    names_in,
)
from tests.sim_server.orders import BOX_BOT
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import ResultCode, SpawnCode, SpawnEntitiesCode
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.proto.messages.spawn_messages import (
    NOT_SPAWNED_PREFIX,
    Resource,
    SpawnEntitiesOrder,
    SpawnEntitiesResponse,
    SpawnEntity,
    SpawnEntityOrder,
)
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.sim_server.errors import SimError
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.service_parts import DeferredResponse, ServerParts
from zensim.sim_server.services import spawn_services

COMMON = SpawnEntityOrder(entity_resource=BOX_BOT, snap_to_ground=True)


def an_order(
    *names: str, atomic: bool = False, common: SpawnEntityOrder = COMMON
) -> SpawnEntitiesOrder:
    requests = tuple(
        SpawnEntity(name, initial_pose=PoseStamped(pose=Pose(Point(float(i)))))
        for i, name in enumerate(names)
    )
    return SpawnEntitiesOrder(requests, atomic, common)


def answer(parts: ServerParts, order: SpawnEntitiesOrder) -> SpawnEntitiesResponse:
    response = handle_request(parts, order)
    if isinstance(response, DeferredResponse):
        while not response.is_ready():
            pass
        response = response.outcome()
    assert isinstance(response, SpawnEntitiesResponse)
    return response


def codes(response: SpawnEntitiesResponse) -> list[int]:
    return [one.result.result for one in response.results]


@pytest.mark.parametrize("atomic", [False, True])
def test_all_are_spawned_in_order_each_with_a_result(*, atomic: bool) -> None:
    parts = make_parts(a_world())

    response = answer(parts, an_order("a", "b", "c", atomic=atomic))

    assert response.result.result == ResultCode.OK
    assert [one.entity_name for one in response.results] == ["a", "b", "c"]
    assert names_in(parts.world) == ["a", "b", "c"]
    assert parts.world.state_of("c")[2] == pytest.approx(0.06)


@pytest.mark.parametrize("atomic", [False, True])
def test_no_orders_are_no_failure(*, atomic: bool) -> None:
    assert answer(make_parts(a_world()), an_order(atomic=atomic)) == SpawnEntitiesResponse()


def test_the_others_are_spawned_when_one_is_refused() -> None:
    parts = make_parts(a_world("b"))

    response = answer(parts, an_order("a", "b", "1c", "d"))

    assert response.result.result == SpawnEntitiesCode.ENTITIES_SPAWN_FAILED
    assert codes(response) == [1, SpawnCode.NAME_NOT_UNIQUE, SpawnCode.NAME_INVALID, 1]
    assert names_in(parts.world) == ["b", "a", "d"]


def test_nobody_is_spawned_when_all_or_none_were_asked_for_and_one_is_refused() -> None:
    parts = make_parts(a_world("b"))
    before = parts.world.states().base.copy()

    response = answer(parts, an_order("a", "b", "c", atomic=True))

    assert response.result.result == SpawnEntitiesCode.ENTITIES_SPAWN_FAILED
    assert codes(response) == [4, SpawnCode.NAME_NOT_UNIQUE, 4]
    assert response.results[0].result.error_message.startswith(f"{NOT_SPAWNED_PREFIX} 'b'")
    assert names_in(parts.world) == ["b"]
    assert (parts.world.states().base == before).all()
    assert kinds_of_events(parts.world) == []


def test_names_are_free_again_at_once_after_a_fleet_was_taken_back() -> None:
    parts = make_parts(a_world("b"))
    answer(parts, an_order("a", "b", atomic=True))

    response = answer(parts, an_order("a", "c", atomic=True))

    assert codes(response) == [1, 1]
    assert names_in(parts.world) == ["b", "a", "c"]


def test_a_fleet_that_was_taken_back_hangs_on_no_bond() -> None:
    parts = make_parts(a_world("b"))
    parts.bonds.alive.add("bond")
    common = msgspec.structs.replace(COMMON, bond="bond")

    answer(parts, an_order("a", "b", atomic=True, common=common))

    assert parts.bonds.entities == {}


@pytest.mark.parametrize("atomic", [False, True])
def test_a_dry_run_says_what_would_be_and_does_nothing(*, atomic: bool) -> None:
    parts = make_parts(a_world())
    common = msgspec.structs.replace(COMMON, dry_run=True)

    response = answer(parts, an_order("a", "b", atomic=atomic, common=common))

    assert codes(response) == [1, 1]
    assert names_in(parts.world) == []


def test_a_dry_run_of_all_or_none_finds_names_that_are_used_twice() -> None:
    common = msgspec.structs.replace(COMMON, dry_run=True)

    response = answer(make_parts(a_world()), an_order("a", "a", atomic=True, common=common))

    assert codes(response) == [4, SpawnCode.NAME_NOT_UNIQUE]


def test_names_are_numbered_where_that_is_allowed() -> None:
    parts = make_parts(a_world())
    common = msgspec.structs.replace(COMMON, allow_renaming=True)

    response = answer(parts, an_order("a", "a", "a", atomic=True, common=common))

    assert [one.entity_name for one in response.results] == ["a", "a_1", "a_2"]


def test_an_order_may_have_a_resource_and_a_namespace_of_its_own() -> None:
    parts = make_parts(a_world())
    own = SpawnEntity("o", entity_resource=Resource("omni_bot"), entity_namespace="team/o")

    answer(parts, SpawnEntitiesOrder((own, SpawnEntity("b")), common=COMMON))

    assert [entity.model.name for entity in parts.world.entities] == ["omni_bot", "box_bot"]
    assert [entity.namespace for entity in parts.world.entities] == ["team/o", "b"]


def test_wishes_hold_for_all() -> None:
    parts = make_parts(a_world())
    common = msgspec.structs.replace(COMMON, info=EntityInfo(tags=("fleet",)))

    answer(parts, an_order("a", "b", common=common))

    assert {entity.info.tags for entity in parts.world.entities} == {("fleet",)}


@pytest.mark.parametrize("atomic", [False, True])
def test_an_unreadable_description_fails_its_own_order(*, atomic: bool) -> None:
    parts = make_parts(a_world())
    bad = SpawnEntity("bad", entity_resource=Resource(resource_string="<robot/>"))

    response = answer(parts, SpawnEntitiesOrder((SpawnEntity("a"), bad), atomic, COMMON))

    assert codes(response) == [4 if atomic else 1, SpawnCode.RESOURCE_PARSE_ERROR]
    assert names_in(parts.world) == ([] if atomic else ["a"])


@pytest.mark.parametrize("atomic", [False, True])
def test_orders_wait_until_descriptions_are_read(*, atomic: bool) -> None:
    parts = make_parts(a_world())
    reader = parts.descriptions.provider
    assert isinstance(reader, InlineParser)
    reader.is_slow = True

    response = handle_request(parts, an_order("a", "b", atomic=atomic))

    assert isinstance(response, DeferredResponse)
    assert not response.is_ready()
    assert names_in(parts.world) == []
    reader.is_slow, parts.descriptions.has_new = False, True
    assert response.is_ready()
    assert names_in(parts.world) == ["a", "b"]


class Unready(ObedientEngine):
    """Has to get ready for every second body."""

    asked = 0

    def prepare(self, model: Model) -> bool:  # noqa: ARG002
        self.asked += 1
        return self.asked % 2 == 0


@pytest.mark.parametrize("atomic", [False, True])
def test_an_engine_that_gets_ready_holds_no_turn_up(*, atomic: bool) -> None:
    parts = make_parts(a_world(engine=Unready(EngineConfig(STEP_NS))))

    response = handle_request(parts, an_order("a", "b", atomic=atomic))

    assert isinstance(response, DeferredResponse)
    turns = [response.is_ready() for _ in range(2)]
    assert turns == [False, True]
    assert names_in(parts.world) == ["a", "b"]


class SlowWall(WallTime):
    """A clock that goes on by as much as a turn may take whenever it is read."""

    def now_ns(self) -> int:
        self.ns += spawn_services.SPAWN_SLICE_NS
        return self.ns


def test_spawns_one_by_one_leave_room_for_steps() -> None:
    parts = make_parts(a_world(), SlowWall())

    response = handle_request(parts, an_order("a", "b", "c"))

    assert isinstance(response, DeferredResponse)
    assert names_in(parts.world) == ["a"]
    assert not response.is_ready()
    assert names_in(parts.world) == ["a", "b"]


def test_a_fleet_is_made_over_some_turns_and_there_at_once() -> None:
    parts = make_parts(a_world("x"), SlowWall())

    response = handle_request(parts, an_order("a", "b", "c", atomic=True))

    assert isinstance(response, DeferredResponse)
    assert names_in(parts.world) == ["x"]
    parts.world.step()
    assert not response.is_ready()
    assert kinds_of_events(parts.world) == []
    assert response.is_ready()
    assert names_in(parts.world) == ["x", "a", "b", "c"]


def test_a_fleet_that_is_being_made_is_given_up_when_the_world_is_reset() -> None:
    parts = make_parts(a_world("x"), SlowWall())
    response = handle_request(parts, an_order("a", "b", atomic=True))
    assert isinstance(response, DeferredResponse)

    parts.world.reset(ResetScope.ALL)

    assert response.is_ready()
    told = response.outcome()
    assert isinstance(told, SpawnEntitiesResponse)
    assert codes(told) == [3, 3]
    assert told.results[0].result.result == ResultCode.INCORRECT_STATE
    assert names_in(parts.world) == []


def test_a_fleet_whose_bond_has_gone_meanwhile_is_given_up() -> None:
    parts = make_parts(a_world("x"), SlowWall())
    parts.bonds.alive.add("bond")
    common = msgspec.structs.replace(COMMON, bond="bond")
    response = handle_request(parts, an_order("a", "b", atomic=True, common=common))
    assert isinstance(response, DeferredResponse)

    parts.bonds.end("bond")

    assert response.is_ready()
    assert names_in(parts.world) == ["x"]


class TickingWall(WallTime):
    """A clock that goes on whenever it is read."""

    def now_ns(self) -> int:
        self.ns += spawn_services.MIN_SPARE_NS
        return self.ns


@pytest.mark.parametrize(("spare", "is_over"), [(0, False), (1000, True)])
def test_spawning_uses_the_time_that_is_left_before_the_next_step(
    spare: int,
    is_over: bool,  # noqa: FBT001
) -> None:
    wall = TickingWall()
    parts = make_parts(a_world(), wall)
    parts.pacing.due_ns = wall.ns + spare * spawn_services.MIN_SPARE_NS

    response = handle_request(parts, an_order(*"abcdef", atomic=True))

    assert isinstance(response, SpawnEntitiesResponse) == is_over


def test_too_many_orders_are_refused() -> None:
    orders = (SpawnEntity("a"),) * 10_001

    with pytest.raises(SimError, match="10001"):
        handle_request(make_parts(a_world()), SpawnEntitiesOrder(orders))


names = st.sampled_from(["a", "b", "c", "d", "", "1x"])


@settings(max_examples=25, deadline=None)
@given(st.lists(names, max_size=4), st.lists(names, max_size=4), st.booleans())
def test_entities_are_those_that_the_results_name(
    first: list[str],
    second: list[str],
    atomic: bool,  # noqa: FBT001
) -> None:
    parts = make_parts(a_world())

    told = [answer(parts, an_order(*wish, atomic=atomic)) for wish in (first, second)]

    spawned = [
        one.entity_name for response in told for one in response.results if one.result.result == 1
    ]
    assert names_in(parts.world) == spawned
    assert len(parts.world.entities.index.bodies) == len(spawned)
    if atomic:
        assert all(len(set(codes(response))) <= 1 or 1 not in codes(response) for response in told)


@pytest.mark.parametrize("is_shared", [True, False])
def test_more_orders_than_are_read_ahead_are_spawned_together(*, is_shared: bool) -> None:
    parts = make_parts(a_world())
    own = Resource() if is_shared else BOX_BOT
    orders = tuple(
        SpawnEntity(f"r{i}", entity_resource=msgspec.structs.replace(own))
        for i in range(spawn_services.MAX_PARSES_AHEAD + 6)
    )

    response = handle_request(parts, SpawnEntitiesOrder(orders, atomic=True, common=COMMON))

    assert isinstance(response, SpawnEntitiesResponse)
    assert len(names_in(parts.world)) == spawn_services.MAX_PARSES_AHEAD + 6
