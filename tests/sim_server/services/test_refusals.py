"""Handlers: every refusal has its code, and says what was given, what is wrong, what would work."""

import math

import msgspec
import pytest

from tests.sim_server.description.robots import a_joint, a_link, a_robot
from tests.sim_server.fakes import a_world, handle_request, make_parts, names_in
from tests.sim_server.orders import BOX_BOT, an_order
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
    Twist,
    Vector3,
)
from zensim.sim_server.errors import SimError
from zensim.sim_server.service_parts import ServerParts
from zensim.sim_server.services.simulation_services import MAX_STEPS

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
    "spawn a taken name": (
        a_spawn(name="r0"),
        SpawnCode.NAME_NOT_UNIQUE,
        "name.taken: .*'r0'",
    ),
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
    "spawn beside nobody": (
        a_spawn_at(Pose(), "r7"),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "delete nobody": (
        DeleteEntityRequest("r7"),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "filter": (
        entity_messages.GetEntitiesRequest(entity_messages.EntityFilters("r(")),
        ResultCode.OPERATION_FAILED,
        r"'r\('",
    ),
    "ask for the state of nobody": (
        entity_messages.GetEntityStateOrder("r7"),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "place nobody": (
        entity_messages.SetEntityStateRequest("r7"),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "place nowhere": (
        a_placing(Pose(Point(x=NAN))),
        SetEntityStateCode.INVALID_POSE,
        "finite",
    ),
    "place too fast": (
        a_placing(twist=Twist(Vector3(1e5))),
        SetEntityStateCode.INVALID_POSE,
        "10000",
    ),
    "place beside nobody": (
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
    "step while playing": (
        StepSimulationRequest(1),
        ResultCode.INCORRECT_STATE,
        "playing",
    ),
    "reset unknown bits": (
        ResetSimulationRequest(8),
        ResultCode.FEATURE_UNSUPPORTED,
        "scope 8",
    ),
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
    "claim nothing": (
        agent_messages.ClaimEntityRequest("a"),
        ClaimCode.NOT_DRIVABLE,
        ".",
    ),
    "claim nobody": (
        agent_messages.ClaimEntityRequest("a", ("r0", "r7")),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
    "claim what another drives": (
        agent_messages.ClaimEntityRequest("a", ("r1",)),
        ClaimCode.ALREADY_CLAIMED,
        "'r1'.*'b'",
    ),
    "ask for the model of nobody": (
        telemetry_messages.GetModelsRequest(("r7",)),
        ResultCode.NOT_FOUND,
        "'r7'",
    ),
}


@pytest.fixture
def parts() -> ServerParts:
    """Two entities, of which agent b drives the second."""
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


def test_world_is_paused_once(parts: ServerParts) -> None:
    parts.world.clock.pause()

    with pytest.raises(SimError, match="paused") as refused:
        handle_request(parts, in_state(State.PAUSED))

    assert refused.value.code == SetSimulationStateCode.ALREADY_IN_TARGET_STATE


def test_spawn_is_refused_when_the_model_has_no_name_that_could_be_one(
    parts: ServerParts,
) -> None:
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
