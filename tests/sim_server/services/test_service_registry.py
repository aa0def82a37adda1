"""Handlers of all services by the registry: parts, responses, refusals with their codes."""

import math
from typing import get_type_hints

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import WHEEL_RADIUS_M, on_ground
from tests.proto.strategies import messages_of
from tests.sim_server.description.robots import a_joint, a_link, a_robot
from tests.sim_server.fakes import (
    a_command,
    a_world,
    handle_request,
    make_parts,
    names_in,
    wheel_speeds,
)
from tests.sim_server.orders import BOX_BOT, an_order, spawned
from zensim.proto.codec.message_codec import Format, encode, supports_format
from zensim.proto.messages import agent_messages, entity_messages, telemetry_messages
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.result_messages import (
    ClaimCode,
    ResultCode,
    SetEntityStateCode,
    SetSimulationStateCode,
    SpawnCode,
)
from zensim.proto.messages.simulation_messages import (
    GetSimulationStateRequest,
    GetSimulationStateResponse,
    GetSimulatorFeaturesRequest,
    GetSimulatorFeaturesResponse,
    ResetScope,
    ResetSimulationRequest,
    SetSimulationStateRequest,
    SimulationState,
    State,
    StepSimulationRequest,
)
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import (
    Header,
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Time,
    Twist,
    Vector3,
)
from zensim.proto.service_catalog import SERVICES, Service
from zensim.sim_server.errors import SimError
from zensim.sim_server.service_parts import DeferredResponse, ServerParts
from zensim.sim_server.services.service_registry import (
    FEATURES,
    SERVICE_TABLE,
    ServiceEntry,
    make_refusal,
)
from zensim.sim_server.services.simulation_services import MAX_STEPS


def state_at(
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    linear: tuple[float, float, float] = (0.0, 0.0, 0.0),
    frame_id: str = "",
) -> entity_messages.EntityState:
    return entity_messages.EntityState(
        Header(frame_id=frame_id), Pose(Point(*place)), Twist(Vector3(*linear))
    )


@pytest.mark.parametrize("name", SERVICES)
def test_service_has_one_handler(name: str) -> None:
    assert [entry.service.name for entry in SERVICE_TABLE].count(name) == 1


@pytest.mark.parametrize("entry", SERVICE_TABLE, ids=lambda entry: entry.service.name)
def test_handler_takes_parts_that_a_server_provides(entry: ServiceEntry) -> None:
    provided = set(get_type_hints(ServerParts).values())

    assert [part for part in entry.parts if part not in provided] == []


def test_handlers_are_of_services_only() -> None:
    assert {entry.service.name for entry in SERVICE_TABLE} == set(SERVICES)


def test_services_have_different_requests() -> None:
    assert len({service.request for service in SERVICES.values()}) == len(SERVICES)


def test_features_are_returned_with_the_formats_that_can_be_spawned() -> None:
    response = handle_request(make_parts(a_world()), GetSimulatorFeaturesRequest())

    assert isinstance(response, GetSimulatorFeaturesResponse)
    assert set(response.features.features) == {int(feature) for feature in FEATURES}
    assert response.features.spawn_formats == ("urdf", "sdf")
    assert response.features.custom_info.startswith("zensim ")


def test_delete_removes_an_entity() -> None:
    parts = make_parts(a_world("r0", "r1"))

    handle_request(parts, DeleteEntityRequest("r0"))

    assert names_in(parts.world) == ["r1"]


def test_get_entities_lists_all_in_the_order_of_spawning() -> None:
    response = handle_request(
        make_parts(a_world("r2", "r0", "r1")), entity_messages.GetEntitiesRequest()
    )

    assert isinstance(response, entity_messages.GetEntitiesResponse)
    assert response.entities == ("r2", "r0", "r1")


def test_get_state_returns_pose_twist_and_time_in_the_world() -> None:
    world = a_world("r0")
    world.claim("a", ("r0",), "stop")
    world.command("a", a_command(world, "a", 4.0, 4.0))
    for _ in range(240):
        world.step()

    response = handle_request(make_parts(world), entity_messages.GetEntityStateOrder("r0"))

    assert isinstance(response, entity_messages.GetEntityStateResponse)
    assert response.state.header == Header(Time(1, 80), "world")
    assert response.state.pose.position.x == pytest.approx(4.0 * WHEEL_RADIUS_M, abs=1e-3)
    assert response.state.twist.linear.x == pytest.approx(4.0 * WHEEL_RADIUS_M)


def test_set_state_of_version_1_sets_pose_and_twist() -> None:
    parts = make_parts(a_world("r0"))
    state = state_at((3.0, 0.0, 0.5), linear=(1.0, 0.0, 0.0))

    handle_request(parts, entity_messages.SetEntityStateRequest("r0", state))

    row = parts.world.state_of("r0")
    assert (row[0], row[2], row[7]) == (3.0, 0.5, 1.0)


def test_set_state_sets_only_the_pose_when_only_its_flag_is_set() -> None:
    parts = make_parts(a_world("r0"))
    state = state_at((3.0, 0.0, 0.5), linear=(1.0, 0.0, 0.0))

    handle_request(parts, entity_messages.SetEntityStateRequest("r0", state, set_pose=True))

    row = parts.world.state_of("r0")
    assert (row[0], row[7]) == (3.0, 0.0)


def test_set_state_sets_only_the_twist_when_only_its_flag_is_set() -> None:
    parts = make_parts(a_world("r0"))
    state = state_at((3.0, 0.0, 0.5), linear=(1.0, 0.0, 0.0))

    handle_request(parts, entity_messages.SetEntityStateRequest("r0", state, set_twist=True))

    row = parts.world.state_of("r0")
    assert (row[0], row[7]) == (0.0, 1.0)


def test_set_state_takes_pose_and_twist_in_the_frame_of_another_entity() -> None:
    world = a_world("r0", "r1")
    world.place("r1", on_ground(5.0, 0.0, math.pi / 2.0))
    state = state_at((1.0, 0.0, 0.0), linear=(2.0, 0.0, 0.0), frame_id="r1")

    handle_request(make_parts(world), entity_messages.SetEntityStateRequest("r0", state))

    row = world.state_of("r0")
    assert row[:3] == pytest.approx([5.0, 1.0, WHEEL_RADIUS_M])
    assert row[7:10] == pytest.approx([0.0, 2.0, 0.0])


def test_set_state_does_not_change_the_initial_state() -> None:
    parts = make_parts(a_world("r0"))
    handle_request(parts, entity_messages.SetEntityStateRequest("r0", state_at((3.0, 0.0, 0.5))))

    handle_request(parts, ResetSimulationRequest(ResetScope.STATE))

    assert parts.world.state_of("r0") == pytest.approx(on_ground())


def test_simulation_is_paused_and_played() -> None:
    parts = make_parts(a_world())

    handle_request(parts, SetSimulationStateRequest(SimulationState(State.PAUSED)))

    response = handle_request(parts, GetSimulationStateRequest())
    assert isinstance(response, GetSimulationStateResponse)
    assert response.state.state == State.PAUSED
    handle_request(parts, SetSimulationStateRequest(SimulationState(State.PLAYING)))
    assert parts.world.clock.state == State.PLAYING


@pytest.mark.parametrize("scope", [0, 1, 2, 3, 4, 5, 6, 7, 255])
def test_reset_takes_every_sum_of_known_bits(scope: int) -> None:
    parts = make_parts(a_world("r0"))

    handle_request(parts, ResetSimulationRequest(scope))

    assert parts.world.clock.epoch == 1
    assert bool(names_in(parts.world)) == (scope in (1, 2, 3))


def test_claim_returns_model_and_clock() -> None:
    parts = make_parts(a_world("r0"))
    parts.agents.alive.add("a")

    response = handle_request(parts, agent_messages.ClaimEntityRequest("a", ("r0",)))

    assert isinstance(response, agent_messages.ClaimEntityResponse)
    assert [claim.entity for claim in response.grants] == ["r0"]
    assert (response.step_ns, response.control_steps) == (parts.world.clock.step_ns, 3)


def test_claim_ends_as_requested() -> None:
    parts = make_parts(a_world("r0"))
    parts.agents.alive.add("a")

    handle_request(parts, agent_messages.ClaimEntityRequest("a", ("r0",), "delete"))
    parts.world.release("a")

    assert names_in(parts.world) == []


def test_models_are_returned_once_for_all_entities_that_share_them() -> None:
    parts = make_parts(a_world("r0", "r1"))
    spawned(parts, an_order("r2"))

    response = handle_request(parts, telemetry_messages.GetModelsRequest())

    assert isinstance(response, telemetry_messages.GetModelsResponse)
    assert [(one.entity, one.model) for one in response.entities] == [
        ("r0", 0),
        ("r1", 0),
        ("r2", 1),
    ]
    assert [model.name for model in response.models] == ["cart", "box_bot"]
    assert response.roster == parts.world.entities.roster_number


def test_models_of_named_entities_are_returned() -> None:
    parts = make_parts(a_world("r0", "r1"))
    parts.world.claim("a", ("r1",), "stop")

    response = handle_request(parts, telemetry_messages.GetModelsRequest(("r1",)))

    assert isinstance(response, telemetry_messages.GetModelsResponse)
    (one,) = response.entities
    assert (one.entity, one.namespace, one.model, one.agent) == ("r1", "r1", 0, "a")
    assert one.initial_pose.position == Point(1.0, 0.0, WHEEL_RADIUS_M)


def test_info_returns_configuration_and_counts() -> None:
    parts = make_parts(a_world("r0", "r1"), factor=2.0)
    parts.world.claim("a", ("r0", "r1"), "stop")
    parts.world.step()
    parts.pacing.loop_stats.real_time_factor = 0.9

    info = handle_request(parts, telemetry_messages.InfoRequest())

    assert isinstance(info, telemetry_messages.Info)
    assert (info.entities, info.agents, info.claimed) == (2, 1, 2)
    assert (info.steps, info.state, info.seed) == (1, "playing", 7)
    assert (info.real_time_factor, info.target_real_time_factor) == (0.9, 2.0)
    assert (info.engine, info.world_model) == ("obedient", "empty")


def test_info_has_a_real_time_factor_of_zero_when_paused() -> None:
    parts = make_parts(a_world())
    parts.pacing.loop_stats.real_time_factor = 0.9
    parts.world.clock.pause()

    info = handle_request(parts, telemetry_messages.InfoRequest())

    assert isinstance(info, telemetry_messages.Info)
    assert (info.real_time_factor, info.state) == (0.0, "paused")


@pytest.mark.parametrize("name", [*SERVICES, "no_such_service"])
def test_refusal_is_a_response_with_a_result(name: str) -> None:
    response = make_refusal(name, ResultCode.OPERATION_FAILED, "given, wrong, works")

    result = getattr(response, "result", None)
    assert (result.result, result.error_message) == (4, "given, wrong, works")  # type: ignore[union-attr]


@pytest.mark.parametrize("service", SERVICES.values(), ids=SERVICES)
@given(data=st.data())
def test_service_replies_to_any_request_or_refuses_it(
    service: Service[msgspec.Struct, msgspec.Struct], data: st.DataObject
) -> None:
    parts = make_parts(a_world("r0"))
    parts.agents.alive.add("a")
    request = data.draw(messages_of(service.request))

    try:
        response = handle_request(parts, request)
        if isinstance(response, DeferredResponse):
            while not response.is_ready():
                parts.descriptions.provider.poll()
            response = response.outcome()
    except SimError as error:
        response = make_refusal(service.name, error.code, str(error))

    for wanted in (one for one in Format if supports_format(type(response), one)):
        assert encode(response, wanted)
    assert np.isfinite(parts.world.states().base).all()
    assert np.isfinite(wheel_speeds(parts.world)).all()


HEDGEHOG = a_robot(
    a_link("body"),
    *(a_link(f"s{i}") + a_joint(f"j{i}", ("body", f"s{i}"), "continuous") for i in range(121)),
)
NAN, INF = math.nan, math.inf
HERE, STILL = Pose(), Twist()


def a_spawn(**changes: object) -> SpawnEntityOrder:
    return msgspec.structs.replace(an_order("r9"), **changes)


def a_spawn_of(text: str) -> SpawnEntityOrder:
    return a_spawn(entity_resource=Resource(resource_string=text))


def a_spawn_at(pose: Pose, frame_id: str = "") -> SpawnEntityOrder:
    return a_spawn(initial_pose=PoseStamped(Header(frame_id=frame_id), pose))


def a_placing(pose: Pose = HERE, twist: Twist = STILL) -> entity_messages.SetEntityStateRequest:
    return entity_messages.SetEntityStateRequest("r0", EntityState(pose=pose, twist=twist))


def in_state(state: int) -> SetSimulationStateRequest:
    return SetSimulationStateRequest(SimulationState(state))


REFUSED = {
    "spawn nothing": (
        a_spawn(entity_resource=Resource()),
        SpawnCode.NO_RESOURCE,
        "resource.empty: ",
    ),
    "spawn an unknown model": (
        a_spawn(entity_resource=Resource("tank")),
        ResultCode.NOT_FOUND,
        "library.model: .*'tank'",
    ),
    "spawn a file": (
        a_spawn(entity_resource=Resource("file:///etc/passwd")),
        ResultCode.NOT_FOUND,
        "resource.unknown: .*'file:///etc/passwd'",
    ),
    "spawn no XML": (a_spawn_of("<robot"), SpawnCode.RESOURCE_PARSE_ERROR, "."),
    "spawn a model that the engine cannot simulate": (
        a_spawn_of(HEDGEHOG),
        SpawnCode.RESOURCE_PARSE_ERROR,
        "urdf.joints: ",
    ),
    "spawn a taken name": (a_spawn(name="r0"), SpawnCode.NAME_NOT_UNIQUE, "name.taken: .*'r0'"),
    "spawn a bad name": (
        a_spawn(name="9 lives"),
        SpawnCode.NAME_INVALID,
        "name.invalid: .*'9 lives'",
    ),
    "spawn in a bad namespace": (
        a_spawn(entity_namespace="sim/r"),
        SpawnCode.NAMESPACE_INVALID,
        "name.namespace: .*'sim/r'",
    ),
    "spawn in a taken namespace": (
        a_spawn(entity_namespace="/r1"),
        SpawnCode.NAMESPACE_INVALID,
        "name.namespace: .*'r1'",
    ),
    "spawn at a position that is no number": (
        a_spawn_at(Pose(Point(y=NAN))),
        SpawnCode.INVALID_POSE,
        "finite",
    ),
    "spawn in an infinite direction": (
        a_spawn_at(Pose(orientation=Quaternion(x=INF))),
        SpawnCode.INVALID_POSE,
        "finite",
    ),
    "spawn too far away": (
        a_spawn_at(Pose(Point(z=1e6))),
        SpawnCode.INVALID_POSE,
        r"pose.refused: .*1e\+06",
    ),
    "spawn in no direction": (
        a_spawn_at(Pose(orientation=Quaternion(w=1e-9))),
        SpawnCode.INVALID_POSE,
        "pose.refused: .*1e-09",
    ),
    "spawn beside an absent entity": (a_spawn_at(Pose(), "r7"), ResultCode.NOT_FOUND, "'r7'"),
    "delete an absent entity": (DeleteEntityRequest("r7"), ResultCode.NOT_FOUND, "'r7'"),
    "filter": (
        entity_messages.GetEntitiesRequest(entity_messages.EntityFilters("r(")),
        ResultCode.OPERATION_FAILED,
        r"'r\('",
    ),
    "ask for the state of an absent entity": (
        entity_messages.GetEntityStateOrder("r7"),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "place an absent entity": (
        entity_messages.SetEntityStateRequest("r7"),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "place nowhere": (a_placing(Pose(Point(x=NAN))), SetEntityStateCode.INVALID_POSE, "finite"),
    "place too fast": (
        a_placing(twist=Twist(Vector3(1e5))),
        SetEntityStateCode.INVALID_POSE,
        "10000",
    ),
    "place beside an absent entity": (
        entity_messages.SetEntityStateRequest("r0", EntityState(Header(frame_id="r7"))),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "accelerate": (
        entity_messages.SetEntityStateRequest("r0", set_acceleration=True),
        ResultCode.FEATURE_UNSUPPORTED,
        "acceleration",
    ),
    "play twice": (
        in_state(State.PLAYING),
        SetSimulationStateCode.ALREADY_IN_TARGET_STATE,
        "playing",
    ),
    "unload by the state": (
        in_state(State.NO_WORLD),
        SetSimulationStateCode.INCORRECT_TRANSITION,
        "no_world",
    ),
    "step while playing": (StepSimulationRequest(1), ResultCode.INCORRECT_STATE, "playing"),
    "reset unknown bits": (ResetSimulationRequest(8), ResultCode.FEATURE_UNSUPPORTED, "scope 8"),
    "claim under a bad name": (
        agent_messages.ClaimEntityRequest("a b", ("r0",)),
        ClaimCode.AGENT_INVALID,
        "'a b'",
    ),
    "claim without being alive": (
        agent_messages.ClaimEntityRequest("ghost", ("r0",)),
        ResultCode.INCORRECT_STATE,
        "'ghost'",
    ),
    "claim nothing": (agent_messages.ClaimEntityRequest("a"), ClaimCode.NOT_DRIVABLE, "."),
    "claim an absent entity": (
        agent_messages.ClaimEntityRequest("a", ("r0", "r7")),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "claim what another drives": (
        agent_messages.ClaimEntityRequest("a", ("r1",)),
        ClaimCode.ALREADY_CLAIMED,
        "'r1'.*'b'",
    ),
    "ask for the model of an absent entity": (
        telemetry_messages.GetModelsRequest(("r7",)),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
}


@pytest.fixture
def parts() -> ServerParts:
    """Two entities; agent b drives the second."""
    made = make_parts(a_world("r0", "r1"))
    made.agents.alive |= {"a", "b"}
    made.world.claim("b", ("r1",), "stop")
    return made


@pytest.mark.parametrize(("request_", "code", "named"), REFUSED.values(), ids=REFUSED)
def test_request_is_refused_with_code_and_what_was_given(
    parts: ServerParts, request_: msgspec.Struct, code: int, named: str
) -> None:
    before = parts.world.states().base.tobytes()

    with pytest.raises(SimError, match=named) as refused:
        handle_request(parts, request_)

    assert refused.value.code == code
    assert "\n" not in str(refused.value)
    assert names_in(parts.world) == ["r0", "r1"]
    assert parts.world.states().base.tobytes() == before
    assert parts.world.claims.agent_of("r0") == ""


@pytest.mark.parametrize("steps", [0, MAX_STEPS + 1, 2**64 - 1])
def test_steps_are_refused_when_they_are_none_or_too_many(parts: ServerParts, steps: int) -> None:
    parts.world.clock.pause()

    with pytest.raises(SimError, match=str(steps)) as refused:
        handle_request(parts, StepSimulationRequest(steps))

    assert refused.value.code == ResultCode.OPERATION_FAILED


def test_pause_is_refused_when_paused(parts: ServerParts) -> None:
    parts.world.clock.pause()

    with pytest.raises(SimError, match="paused") as refused:
        handle_request(parts, in_state(State.PAUSED))

    assert refused.value.code == SetSimulationStateCode.ALREADY_IN_TARGET_STATE


def test_spawn_is_refused_when_the_model_has_no_name_that_could_be_one(parts: ServerParts) -> None:
    nameless = a_spawn(
        name="", entity_resource=Resource("", '<robot name="my robot"><link name="a"/></robot>')
    )

    with pytest.raises(SimError, match=r"name.invalid: .*'my robot'") as refused:
        handle_request(parts, nameless)

    assert refused.value.code == SpawnCode.NAME_INVALID


def test_spawn_refuses_a_long_name_in_a_short_line(parts: ServerParts) -> None:
    with pytest.raises(SimError) as refused:
        handle_request(parts, a_spawn(name="x" * 100_000, entity_resource=BOX_BOT))

    assert len(str(refused.value)) < 300
