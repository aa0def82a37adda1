"""Spawns of one and of many entities: names, poses, reports, dry runs, bonds, batches."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.engines import STEP_NS, ObedientEngine
from tests.models import WHEEL_RADIUS_M, on_ground
from tests.sim_server.fakes import (
    InlineParser,
    WallTime,
    a_server,
    a_world,
    handle_request,
    kinds_of_events,
    make_parts,
    names_in,
)
from tests.sim_server.orders import BOX_BOT, LYING, an_order, spawned, suspicions
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Inertial, Link, Model, Shape
from zensim.proto.messages.result_messages import ResultCode, SpawnCode, SpawnEntitiesCode
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.proto.messages.spawn_messages import (
    NOT_SPAWNED_PREFIX,
    Resource,
    SpawnEntitiesOrder,
    SpawnEntitiesResponse,
    SpawnEntity,
    SpawnEntityOrder,
    SpawnEntityReport,
)
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped, Quaternion
from zensim.proto.stl import write_corners
from zensim.sim_server.errors import IncorrectState, ModelError, NameNotUnique, SimError
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.service_parts import DeferredResponse, ServerParts
from zensim.sim_server.services import spawn_services
from zensim.sim_server.services.spawn_services import NOTHING_BELOW
from zensim.sim_server.world.spawn_request import ValidatedSpawn


def height_of(parts: ServerParts, name: str = "r") -> float:
    return float(parts.world.state_of(name)[2])


def test_spawn_puts_a_shipped_model_at_the_requested_pose() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order("r", place=(1.0, 2.0, 0.06)))

    assert (report.entity_name, report.entity_namespace) == ("r", "r")
    assert parts.world.state_of("r")[:3] == pytest.approx([1.0, 2.0, 0.06])
    assert suspicions(report) == []
    assert kinds_of_events(parts.world) == ["spawned"]


def test_spawn_names_an_entity_after_its_model_without_a_name() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(""))

    assert report.entity_name == "box_bot"


def test_spawn_takes_a_description_as_text_and_keeps_it_for_the_agent() -> None:
    parts = make_parts(a_world())
    text = '<robot name="dot"><link name="base"/></robot>'

    report = spawned(parts, SpawnEntityOrder(entity_resource=Resource("", text)))

    assert report.entity_name == "dot"
    assert parts.world.entities.find("dot").description == text


def test_spawn_remembers_the_wall_time_of_the_spawn() -> None:
    wall = WallTime(77)
    parts = make_parts(a_world(), wall)

    spawned(parts, an_order())

    assert parts.world.entities.find("r").born_ns == 77


def test_spawn_takes_an_all_zero_quaternion_as_identity_and_reports_it() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(orientation=Quaternion(0.0, 0.0, 0.0, 0.0)))

    assert suspicions(report) == ["all-zero quaternion read as identity"]
    assert parts.world.state_of("r")[3:7].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert kinds_of_events(parts.world) == ["spawned", "warning"]


def test_spawn_reports_how_far_below_ground_a_robot_is() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(place=(0.0, 0.0, 0.01)))

    assert suspicions(report) == [
        "lowest point is 5.0 cm below ground; z = 0.060 puts it on the ground"
    ]
    assert height_of(parts) == 0.01


def a_floor_world(*, gravity: tuple[float, float, float] = (0.0, 0.0, -9.8)) -> ServerParts:
    """Make a world whose floor is a static model of 4 m, without a ground plane."""
    floor = Link("floor", collisions=(Shape("box", (4.0, 4.0, 0.2)),))
    parts = make_parts(a_world())
    parts.current_world.model = msgspec.structs.replace(
        parts.current_world.model, ground_plane=False, gravity=gravity
    )
    base = np.array([0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
    model = Model("floor", (floor,), is_static=True)
    parts.world.spawn(ValidatedSpawn("floor", "", model, base))
    return parts


@pytest.mark.parametrize(("x", "expected"), [(0.0, []), (1.9, []), (2.1, [NOTHING_BELOW])])
def test_spawn_warns_when_nothing_is_below(x: float, expected: list[str]) -> None:
    report = spawned(a_floor_world(), an_order(place=(x, 0.0, 0.06)))

    assert suspicions(report) == expected


def test_spawn_below_a_floor_warns_that_nothing_is_below() -> None:
    report = spawned(a_floor_world(), an_order(place=(0.0, 0.0, -3.0)))

    assert NOTHING_BELOW in suspicions(report)


def test_spawn_without_gravity_does_not_warn_that_nothing_is_below() -> None:
    report = spawned(a_floor_world(gravity=(0.0, 0.0, 0.0)), an_order(place=(5.0, 0.0, 0.06)))

    assert NOTHING_BELOW not in suspicions(report)


def test_spawn_puts_a_robot_on_the_ground_when_requested() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(place=(0.0, 0.0, 17.0), is_snapped=True))

    assert height_of(parts) == pytest.approx(0.06)
    assert suspicions(report) == []


def test_spawn_puts_a_lying_robot_on_the_ground_when_requested() -> None:
    parts = make_parts(a_world())

    spawned(parts, an_order(orientation=LYING, is_snapped=True))

    # Rolled to its side it rests on a wheel, 0.055 m from the centre.
    assert height_of(parts) == pytest.approx(0.055 + 0.035)


def test_spawn_reports_that_a_lying_robot_is_below_ground() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(orientation=LYING))

    assert suspicions(report) == [
        "lowest point is 3.0 cm below ground; z = 0.090 puts it on the ground"
    ]


@pytest.mark.parametrize("frame_id", ["", "world", "map", "/map", "/world"])
def test_spawn_takes_a_pose_of_the_world(frame_id: str) -> None:
    parts = make_parts(a_world())

    spawned(parts, an_order(place=(3.0, 0.0, 0.06), frame_id=frame_id))

    assert parts.world.state_of("r")[0] == 3.0


def test_spawn_takes_a_pose_in_the_frame_of_another_entity() -> None:
    world = a_world("r0")
    world.place("r0", on_ground(5.0, 0.0, math.pi / 2.0))
    parts = make_parts(world)

    spawned(parts, an_order(place=(1.0, 0.0, 0.0), frame_id="r0"))

    assert world.state_of("r")[:3] == pytest.approx([5.0, 1.0, WHEEL_RADIUS_M])


FAR = PoseStamped(pose=Pose(Point(50.0, 0.0, 0.06)))
AT_R1 = PoseStamped(pose=Pose(Point(0.0, 0.0, 0.06)))
UNDERGROUND = PoseStamped(pose=Pose(Point(50.0, 0.0, -1.0)))


def a_far_order(name: str = "new", **changes: object) -> SpawnEntityOrder:
    fields: dict[str, object] = {"entity_resource": BOX_BOT, "initial_pose": FAR}
    return SpawnEntityOrder(name, **{**fields, **changes})  # type: ignore[arg-type]


def descriptions_of(parts: ServerParts) -> InlineParser:
    assert isinstance(parts.descriptions.provider, InlineParser)
    return parts.descriptions.provider


def spawn_beside(
    world_names: list[str], order: SpawnEntityOrder
) -> tuple[SpawnEntityReport, list[str]]:
    parts = make_parts(a_world(*world_names))
    report = handle_request(parts, order)
    assert isinstance(report, SpawnEntityReport)
    return report, names_in(parts.world)


def test_dry_run_returns_the_name_and_spawns_nothing() -> None:
    report, names = spawn_beside(["new"], a_far_order(dry_run=True, allow_renaming=True))

    assert report.entity_name == "new_1"
    assert names == ["new"]


def test_dry_run_makes_no_events() -> None:
    parts = make_parts(a_world())

    handle_request(parts, a_far_order(dry_run=True, initial_pose=UNDERGROUND))

    assert parts.world.clock.take_events() == []


def test_dry_run_is_refused_as_the_spawn_would_be() -> None:
    with pytest.raises(NameNotUnique):
        spawn_beside(["new"], a_far_order(dry_run=True))


@pytest.mark.parametrize("is_dry", [False, True])
def test_report_names_overlapping_entities(*, is_dry: bool) -> None:
    report, _ = spawn_beside(["r1"], a_far_order(initial_pose=AT_R1, dry_run=is_dry))

    assert suspicions(report) == ["overlaps entity 'r1'"]


@pytest.mark.parametrize(("pose", "fault"), [(AT_R1, "'r1'"), (UNDERGROUND, "initial_pose")])
def test_strict_spawn_is_refused_and_spawns_nothing(pose: PoseStamped, fault: str) -> None:
    parts = make_parts(a_world("r1"))

    with pytest.raises(ModelError, match=rf"^report\.suspicious: .*{fault}"):
        handle_request(parts, a_far_order(strict=True, initial_pose=pose))

    assert names_in(parts.world) == ["r1"]


def test_strict_spawn_is_made_when_nothing_is_suspicious() -> None:
    report, names = spawn_beside([], a_far_order(strict=True))

    assert suspicions(report) == []
    assert names == ["new"]


def test_robot_stands_on_the_lowest_corner_of_its_meshes() -> None:
    parts = make_parts(a_world())
    corners = np.array([[[0.0, 0.0, -0.25], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]]])
    parts.store.pin("a" * 64, write_corners(corners))
    shape = Shape("mesh", (1.0, 1.0, 2.0), mesh="a" * 64)
    descriptions_of(parts).given = Model("m", (Link("base", Inertial(1.0), (shape,)),))

    snapped = handle_request(parts, a_far_order("high", snap_to_ground=True))
    sunk = handle_request(parts, a_far_order("low", initial_pose=FAR))

    assert isinstance(snapped, SpawnEntityReport)
    assert isinstance(sunk, SpawnEntityReport)
    assert suspicions(snapped) == []
    assert parts.world.state_of("high")[2] == pytest.approx(0.5)
    assert any("44.0 cm below ground" in reason for reason in suspicions(sunk))


def test_bond_without_a_token_is_refused() -> None:
    with pytest.raises(IncorrectState, match="'b1'"):
        spawn_beside([], a_far_order(bond="b1"))


def test_entity_is_deleted_when_its_bond_ends() -> None:
    server = a_server("r1")
    server.inbox.bonds.append(("b1", True))
    server.request("spawn_entity", a_far_order(bond="b1"))
    server.loop.serve()
    bound = names_in(server.world)

    server.inbox.bonds.append(("b1", False))
    server.loop.serve()

    assert bound == ["r1", "new"]
    assert names_in(server.world) == ["r1"]


def test_ended_bond_keeps_another_entity_of_the_name() -> None:
    server = a_server()
    server.inbox.bonds.append(("b1", True))
    server.request("spawn_entity", a_far_order(bond="b1"))
    server.loop.serve()
    server.world.delete("new")
    server.wall.ns += 1
    server.request("spawn_entity", a_far_order())
    server.loop.serve()

    server.inbox.bonds.append(("b1", False))
    server.loop.serve()

    assert names_in(server.world) == ["new"]


def test_spawns_wait_for_parsing_and_keep_their_order() -> None:
    server = a_server()
    parser = InlineParser()
    parser.is_slow = True
    server.parts.descriptions.provider = parser
    calls = [server.request("spawn_entity", a_far_order(name)) for name in ("a", "b")]
    server.loop.serve()
    before = [call.is_over for call in calls]

    parser.is_slow = False
    server.loop.serve()

    assert before == [False, False]
    assert [call.is_over for call in calls] == [True, True]
    assert names_in(server.world) == ["a", "b"]


def test_retry_replaces_a_pending_spawn() -> None:
    server = a_server()
    parser = InlineParser()
    parser.is_slow = True
    server.parts.descriptions.provider = parser
    first = server.request("spawn_entity", a_far_order("a"))
    first.request_id = b"1"
    server.loop.serve()
    again = server.request("spawn_entity", a_far_order("a"))
    again.request_id = b"1"
    server.loop.serve()

    parser.is_slow = False
    server.loop.serve()

    assert (first.is_over, again.is_over) == (False, True)
    assert names_in(server.world) == ["a"]


def test_world_steps_while_a_spawn_is_pending() -> None:
    server = a_server("r1")
    parser = InlineParser()
    parser.is_slow = True
    server.parts.descriptions.provider = parser
    server.request("spawn_entity", a_far_order("a"))
    steps = server.world.clock.steps
    server.turn_for(0.1)

    assert server.world.clock.steps > steps


COMMON = SpawnEntityOrder(entity_resource=BOX_BOT, snap_to_ground=True)


def a_batch(
    *names: str, atomic: bool = False, common: SpawnEntityOrder = COMMON
) -> SpawnEntitiesOrder:
    requests = tuple(
        SpawnEntity(name, initial_pose=PoseStamped(pose=Pose(Point(float(i)))))
        for i, name in enumerate(names)
    )
    return SpawnEntitiesOrder(requests, atomic, common)


def spawn_batch(parts: ServerParts, order: SpawnEntitiesOrder) -> SpawnEntitiesResponse:
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

    response = spawn_batch(parts, a_batch("a", "b", "c", atomic=atomic))

    assert response.result.result == ResultCode.OK
    assert [one.entity_name for one in response.results] == ["a", "b", "c"]
    assert names_in(parts.world) == ["a", "b", "c"]
    assert parts.world.state_of("c")[2] == pytest.approx(0.06)


@pytest.mark.parametrize("atomic", [False, True])
def test_empty_batch_succeeds(*, atomic: bool) -> None:
    assert spawn_batch(make_parts(a_world()), a_batch(atomic=atomic)) == SpawnEntitiesResponse()


def test_the_others_are_spawned_when_one_is_refused() -> None:
    parts = make_parts(a_world("b"))

    response = spawn_batch(parts, a_batch("a", "b", "1c", "d"))

    assert response.result.result == SpawnEntitiesCode.ENTITIES_SPAWN_FAILED
    assert codes(response) == [1, SpawnCode.NAME_NOT_UNIQUE, SpawnCode.NAME_INVALID, 1]
    assert names_in(parts.world) == ["b", "a", "d"]


def test_atomic_batch_spawns_nothing_when_one_is_refused() -> None:
    parts = make_parts(a_world("b"))
    before = parts.world.states().base.copy()

    response = spawn_batch(parts, a_batch("a", "b", "c", atomic=True))

    assert response.result.result == SpawnEntitiesCode.ENTITIES_SPAWN_FAILED
    assert codes(response) == [4, SpawnCode.NAME_NOT_UNIQUE, 4]
    assert response.results[0].result.error_message.startswith(f"{NOT_SPAWNED_PREFIX} 'b'")
    assert names_in(parts.world) == ["b"]
    assert (parts.world.states().base == before).all()
    assert kinds_of_events(parts.world) == []


def test_names_are_free_after_a_batch_was_rolled_back() -> None:
    parts = make_parts(a_world("b"))
    spawn_batch(parts, a_batch("a", "b", atomic=True))

    response = spawn_batch(parts, a_batch("a", "c", atomic=True))

    assert codes(response) == [1, 1]
    assert names_in(parts.world) == ["b", "a", "c"]


def test_batch_that_was_rolled_back_has_no_bond() -> None:
    parts = make_parts(a_world("b"))
    parts.bonds.alive.add("bond")
    common = msgspec.structs.replace(COMMON, bond="bond")

    spawn_batch(parts, a_batch("a", "b", atomic=True, common=common))

    assert parts.bonds.entities == {}


@pytest.mark.parametrize("atomic", [False, True])
def test_dry_run_reports_results_and_spawns_nothing(*, atomic: bool) -> None:
    parts = make_parts(a_world())
    common = msgspec.structs.replace(COMMON, dry_run=True)

    response = spawn_batch(parts, a_batch("a", "b", atomic=atomic, common=common))

    assert codes(response) == [1, 1]
    assert names_in(parts.world) == []


def test_atomic_dry_run_finds_names_that_are_used_twice() -> None:
    common = msgspec.structs.replace(COMMON, dry_run=True)

    response = spawn_batch(make_parts(a_world()), a_batch("a", "a", atomic=True, common=common))

    assert codes(response) == [4, SpawnCode.NAME_NOT_UNIQUE]


def test_names_are_numbered_where_renaming_is_allowed() -> None:
    parts = make_parts(a_world())
    common = msgspec.structs.replace(COMMON, allow_renaming=True)

    response = spawn_batch(parts, a_batch("a", "a", "a", atomic=True, common=common))

    assert [one.entity_name for one in response.results] == ["a", "a_1", "a_2"]


def test_order_may_have_a_resource_and_a_namespace_of_its_own() -> None:
    parts = make_parts(a_world())
    own = SpawnEntity("o", entity_resource=Resource("omni_bot"), entity_namespace="team/o")

    spawn_batch(parts, SpawnEntitiesOrder((own, SpawnEntity("b")), common=COMMON))

    assert [entity.model.name for entity in parts.world.entities] == ["omni_bot", "box_bot"]
    assert [entity.namespace for entity in parts.world.entities] == ["team/o", "b"]


def test_common_options_apply_to_all() -> None:
    parts = make_parts(a_world())
    common = msgspec.structs.replace(COMMON, info=EntityInfo(tags=("fleet",)))

    spawn_batch(parts, a_batch("a", "b", common=common))

    assert {entity.info.tags for entity in parts.world.entities} == {("fleet",)}


@pytest.mark.parametrize("atomic", [False, True])
def test_unreadable_description_fails_its_own_order(*, atomic: bool) -> None:
    parts = make_parts(a_world())
    bad = SpawnEntity("bad", entity_resource=Resource(resource_string="<robot/>"))

    response = spawn_batch(parts, SpawnEntitiesOrder((SpawnEntity("a"), bad), atomic, COMMON))

    assert codes(response) == [4 if atomic else 1, SpawnCode.RESOURCE_PARSE_ERROR]
    assert names_in(parts.world) == ([] if atomic else ["a"])


@pytest.mark.parametrize("atomic", [False, True])
def test_orders_wait_until_descriptions_are_parsed(*, atomic: bool) -> None:
    parts = make_parts(a_world())
    parser = parts.descriptions.provider
    assert isinstance(parser, InlineParser)
    parser.is_slow = True

    response = handle_request(parts, a_batch("a", "b", atomic=atomic))

    assert isinstance(response, DeferredResponse)
    assert not response.is_ready()
    assert names_in(parts.world) == []
    parser.is_slow, parts.descriptions.has_new = False, True
    assert response.is_ready()
    assert names_in(parts.world) == ["a", "b"]


class Unready(ObedientEngine):
    """Needs a second call to prepare a body."""

    asked = 0

    def prepare(self, model: Model) -> bool:  # noqa: ARG002
        self.asked += 1
        return self.asked % 2 == 0


@pytest.mark.parametrize("atomic", [False, True])
def test_engine_that_prepares_models_delays_no_turn(*, atomic: bool) -> None:
    parts = make_parts(a_world(engine=Unready(EngineConfig(STEP_NS))))

    response = handle_request(parts, a_batch("a", "b", atomic=atomic))

    assert isinstance(response, DeferredResponse)
    turns = [response.is_ready() for _ in range(2)]
    assert turns == [False, True]
    assert names_in(parts.world) == ["a", "b"]


class SlowWall(WallTime):
    """Advance by the time slice of a turn at each reading."""

    def now_ns(self) -> int:
        self.ns += spawn_services.SPAWN_SLICE_NS
        return self.ns


def test_spawns_one_by_one_allow_steps_in_between() -> None:
    parts = make_parts(a_world(), SlowWall())

    response = handle_request(parts, a_batch("a", "b", "c"))

    assert isinstance(response, DeferredResponse)
    assert names_in(parts.world) == ["a"]
    assert not response.is_ready()
    assert names_in(parts.world) == ["a", "b"]


def test_atomic_batch_is_staged_over_turns_and_committed_at_once() -> None:
    parts = make_parts(a_world("x"), SlowWall())

    response = handle_request(parts, a_batch("a", "b", "c", atomic=True))

    assert isinstance(response, DeferredResponse)
    assert names_in(parts.world) == ["x"]
    parts.world.step()
    assert not response.is_ready()
    assert kinds_of_events(parts.world) == []
    assert response.is_ready()
    assert names_in(parts.world) == ["x", "a", "b", "c"]


def test_atomic_batch_is_dropped_when_the_world_is_reset() -> None:
    parts = make_parts(a_world("x"), SlowWall())
    response = handle_request(parts, a_batch("a", "b", atomic=True))
    assert isinstance(response, DeferredResponse)

    parts.world.reset(ResetScope.ALL)

    assert response.is_ready()
    sent = response.outcome()
    assert isinstance(sent, SpawnEntitiesResponse)
    assert codes(sent) == [3, 3]
    assert sent.results[0].result.result == ResultCode.INCORRECT_STATE
    assert names_in(parts.world) == []


def test_atomic_batch_is_dropped_when_its_bond_ends() -> None:
    parts = make_parts(a_world("x"), SlowWall())
    parts.bonds.alive.add("bond")
    common = msgspec.structs.replace(COMMON, bond="bond")
    response = handle_request(parts, a_batch("a", "b", atomic=True, common=common))
    assert isinstance(response, DeferredResponse)

    parts.bonds.end("bond")

    assert response.is_ready()
    assert names_in(parts.world) == ["x"]


class TickingWall(WallTime):
    """Advance at each reading."""

    def now_ns(self) -> int:
        self.ns += spawn_services.MIN_SPARE_NS
        return self.ns


@pytest.mark.parametrize(("spare", "is_over"), [(0, False), (1000, True)])
def test_spawning_uses_the_time_before_the_next_step(
    spare: int,
    is_over: bool,  # noqa: FBT001
) -> None:
    wall = TickingWall()
    parts = make_parts(a_world(), wall)
    parts.pacing.due_ns = wall.ns + spare * spawn_services.MIN_SPARE_NS

    response = handle_request(parts, a_batch(*"abcdef", atomic=True))

    assert isinstance(response, SpawnEntitiesResponse) == is_over


def test_spawning_leaves_room_in_long_spare_time_for_other_messages() -> None:
    wall = TickingWall()
    parts = make_parts(a_world(), wall)
    parts.pacing.due_ns = wall.ns + 1000 * spawn_services.MIN_SPARE_NS
    names = [f"r{number}" for number in range(100)]

    response = handle_request(parts, a_batch(*names, atomic=True))

    assert isinstance(response, DeferredResponse)
    assert wall.ns < parts.pacing.due_ns - 900 * spawn_services.MIN_SPARE_NS


def test_too_many_orders_are_refused() -> None:
    orders = (SpawnEntity("a"),) * 10_001

    with pytest.raises(SimError, match="10001"):
        handle_request(make_parts(a_world()), SpawnEntitiesOrder(orders))


names = st.sampled_from(["a", "b", "c", "d", "", "1x"])


@settings(max_examples=25, deadline=None)
@given(st.lists(names, max_size=4), st.lists(names, max_size=4), st.booleans())
def test_results_name_the_entities(
    first: list[str],
    second: list[str],
    atomic: bool,  # noqa: FBT001
) -> None:
    parts = make_parts(a_world())

    sent = [spawn_batch(parts, a_batch(*wish, atomic=atomic)) for wish in (first, second)]

    spawned = [
        one.entity_name for response in sent for one in response.results if one.result.result == 1
    ]
    assert names_in(parts.world) == spawned
    assert len(parts.world.entities.index.bodies) == len(spawned)
    if atomic:
        assert all(len(set(codes(response))) <= 1 or 1 not in codes(response) for response in sent)


@pytest.mark.parametrize("is_shared", [True, False])
def test_more_orders_than_are_parsed_ahead_are_spawned_together(*, is_shared: bool) -> None:
    parts = make_parts(a_world())
    own = Resource() if is_shared else BOX_BOT
    orders = tuple(
        SpawnEntity(f"r{i}", entity_resource=msgspec.structs.replace(own))
        for i in range(spawn_services.MAX_PARSES_AHEAD + 6)
    )

    response = handle_request(parts, SpawnEntitiesOrder(orders, atomic=True, common=COMMON))

    assert isinstance(response, SpawnEntitiesResponse)
    assert len(names_in(parts.world)) == spawn_services.MAX_PARSES_AHEAD + 6
