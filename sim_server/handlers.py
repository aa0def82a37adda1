"""One handler a service: request in, response out. Refusals become Results here and only here."""

from collections.abc import Callable
from importlib.metadata import version

import msgspec

from proto import assets, claims, services, telemetry
from proto.catalog import SERVICES
from proto.header import Header, time_from_ns
from proto.names import InvalidName, check_name
from proto.result import ClaimCode, Result, ResultCode, SetEntityStateCode, SetSimulationStateCode
from proto.services import Feature, State
from sim_server.desk import Desk
from sim_server.errors import IncorrectState, PoseRefused, Refused, Unsupported
from sim_server.physics.engine import FloatArray
from sim_server.poses import (
    WORLD_FRAMES,
    pose_of,
    pose_row,
    turned,
    twist_of,
    twist_row,
)
from sim_server.spawning import in_world, spawn
from sim_server.world import World

FEATURES = (
    Feature.SPAWNING,
    Feature.DELETING,
    Feature.SPAWNING_RESOURCE_STRING,
    Feature.ENTITY_STATE_GETTING,
    Feature.ENTITY_STATE_SETTING,
    Feature.SIMULATION_RESET,
    Feature.SIMULATION_RESET_TIME,
    Feature.SIMULATION_RESET_STATE,
    Feature.SIMULATION_RESET_SPAWNED,
    Feature.SIMULATION_STATE_GETTING,
    Feature.SIMULATION_STATE_SETTING,
    Feature.SIMULATION_STATE_PAUSE,
    Feature.STEP_SIMULATION_SINGLE,
    Feature.STEP_SIMULATION_MULTIPLE,
)
VERSION = version("zensim")
MAX_STEPS = 10_000_000


def handle(desk: Desk, request: msgspec.Struct) -> msgspec.Struct:
    """Carry out a request.

    Raises:
        SimError: It is refused.
    """
    return HANDLERS[type(request)](desk, request)


def refusal(name: str, code: int, message: str) -> msgspec.Struct:
    """Make a service's response that says no."""
    service = SERVICES.get(name)
    response = service.response if service else services.DeleteEntityResponse
    if "result" not in response.__struct_fields__:
        response = services.DeleteEntityResponse
    return response(result=Result(int(code), message))


def _twist_in_world(world: World, frame_id: str, twist: FloatArray) -> FloatArray:
    """Turn a twist (6,) with the axes of a frame; how the frame moves itself is left out."""
    if frame_id in WORLD_FRAMES:
        return twist
    return turned(world.state_of(frame_id)[:7], twist)


def _delete(desk: Desk, request: services.DeleteEntityRequest) -> services.DeleteEntityResponse:
    desk.world.delete(request.entity)
    return services.DeleteEntityResponse()


def _get_entities(desk: Desk, request: services.GetEntitiesRequest) -> services.GetEntitiesResponse:
    if request.filters != services.EntityFilters():
        raise Unsupported("filters are not supported; leave them empty and filter the names")
    return services.GetEntitiesResponse(entities=desk.world.roster().names)


def _get_state(
    desk: Desk, request: services.GetEntityStateRequest
) -> services.GetEntityStateResponse:
    row = desk.world.state_of(request.entity)
    header = Header(time_from_ns(desk.world.time_ns), "world")
    return services.GetEntityStateResponse(
        state=services.EntityState(header, pose_of(row), twist_of(row))
    )


def _set_state(
    desk: Desk, request: services.SetEntityStateRequest
) -> services.SetEntityStateResponse:
    row = desk.world.state_of(request.entity).copy()
    # A request of version 1 has no flags and means both.
    is_version_1 = not (request.set_pose or request.set_twist or request.set_acceleration)
    if request.set_acceleration:
        raise Unsupported("acceleration cannot be set; set the pose or the twist")
    try:
        if request.set_pose or is_version_1:
            pose = pose_row(request.state.pose)
            row[:7] = in_world(desk.world, request.state.header.frame_id, pose)
        if request.set_twist or is_version_1:
            twist = twist_row(request.state.twist)
            row[7:13] = _twist_in_world(desk.world, request.state.header.frame_id, twist)
    except PoseRefused as error:
        raise Refused(SetEntityStateCode.INVALID_POSE, str(error)) from error
    desk.world.place(request.entity, row)
    return services.SetEntityStateResponse()


def _get_simulation_state(
    desk: Desk, _: services.GetSimulationStateRequest
) -> services.GetSimulationStateResponse:
    return services.GetSimulationStateResponse(services.SimulationState(desk.world.state))


def _set_simulation_state(
    desk: Desk, request: services.SetSimulationStateRequest
) -> services.SetSimulationStateResponse:
    wanted = request.state.state
    if wanted == desk.world.state:
        raise Refused(
            SetSimulationStateCode.ALREADY_IN_TARGET_STATE,
            f"the simulation is {desk.world.state_name} already",
        )
    if wanted == State.PLAYING:
        desk.world.play()
    elif wanted == State.PAUSED:
        desk.world.pause()
    else:
        raise Unsupported(f"state {wanted} cannot be set; use 1 (playing) or 2 (paused)")
    return services.SetSimulationStateResponse()


def _step(desk: Desk, request: services.StepSimulationRequest) -> services.StepSimulationResponse:
    desk.world.require_paused()
    if not 1 <= request.steps <= MAX_STEPS:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"steps={request.steps} is out of range; use 1 to {MAX_STEPS}",
        )
    return services.StepSimulationResponse()


def _reset(
    desk: Desk, request: services.ResetSimulationRequest
) -> services.ResetSimulationResponse:
    known = services.ResetScope.TIME | services.ResetScope.STATE | services.ResetScope.SPAWNED
    if request.scope not in (services.ResetScope.ALL, request.scope & known):
        raise Unsupported(f"scope {request.scope} has unknown bits; use 0, 255 or a sum of 1, 2, 4")
    desk.world.reset(request.scope)
    return services.ResetSimulationResponse()


def _features(
    _: Desk, __: services.GetSimulatorFeaturesRequest
) -> services.GetSimulatorFeaturesResponse:
    return services.GetSimulatorFeaturesResponse(
        services.SimulatorFeatures(
            tuple(int(feature) for feature in FEATURES), ("urdf", "sdf"), f"zensim {VERSION}"
        )
    )


def _claim(desk: Desk, request: claims.ClaimEntityRequest) -> claims.ClaimEntityResponse:
    try:
        agent = check_name(request.agent, "agent")
    except InvalidName as error:
        raise Refused(ClaimCode.AGENT_INVALID, str(error)) from error
    if agent not in desk.alive_agents:
        raise IncorrectState(f"agent '{agent}' has no liveliness token; declare it before claiming")
    if not request.entities:
        raise Refused(ClaimCode.NOT_DRIVABLE, "no entity was named; name at least one")
    granted = desk.world.claim(agent, request.entities, request.on_release)
    return claims.ClaimEntityResponse(
        Result(), granted, desk.world.step_ns, desk.world.control_steps
    )


def _get_models(desk: Desk, request: telemetry.GetModelsRequest) -> telemetry.GetModelsResponse:
    wanted = request.entities or desk.world.roster().names
    entities = [desk.world.entity(name) for name in wanted]
    number = {model: i for i, model in enumerate(dict.fromkeys(e.model for e in entities))}
    return telemetry.GetModelsResponse(
        Result(),
        desk.world.roster_number,
        tuple(
            telemetry.EntityModel(
                entity.name,
                entity.namespace,
                number[entity.model],
                desk.world.claims.agent_of(entity.name),
                pose_of(entity.initial),
            )
            for entity in entities
        ),
        tuple(number),
    )


def _missing_assets(
    desk: Desk, request: assets.MissingAssetsRequest
) -> assets.MissingAssetsResponse:
    missing = desk.store.missing(request.sha256s)
    return assets.MissingAssetsResponse(
        Result(), tuple(name for name, _ in missing), tuple(received for _, received in missing)
    )


def _put_asset(desk: Desk, request: assets.PutAssetRequest) -> assets.PutAssetResponse:
    received = desk.store.put(
        request.sha256, offset=request.offset, total=request.total, data=request.data
    )
    return assets.PutAssetResponse(Result(), received)


def _get_asset(desk: Desk, request: assets.GetAssetRequest) -> assets.GetAssetResponse:
    data = desk.store.piece(request.sha256, request.offset, assets.MAX_CHUNK_BYTES)
    return assets.GetAssetResponse(Result(), data, desk.store.size(request.sha256))


def _info(desk: Desk, _: telemetry.InfoRequest) -> telemetry.Info:
    world, is_playing = desk.world, desk.world.state == State.PLAYING
    return telemetry.Info(
        world=world.name,
        version=VERSION,
        sim_time_s=world.time_ns * 1e-9,
        steps=world.steps,
        epoch=world.epoch,
        step_ns=world.step_ns,
        real_time_factor=desk.meter.real_time_factor if is_playing else 0.0,
        target_real_time_factor=desk.target_real_time_factor,
        entities=len(world.entities),
        agents=len(world.claims.agents),
        claimed=len(world.claims),
        state=world.state_name,
        engine=world.engine_name,
        world_model=desk.world_model,
        seed=desk.seed,
    )


HANDLERS: dict[type[msgspec.Struct], Callable[[Desk, msgspec.Struct], msgspec.Struct]] = {
    services.SpawnEntityOrder: spawn,  # type: ignore[dict-item]
    services.DeleteEntityRequest: _delete,  # type: ignore[dict-item]
    services.GetEntitiesRequest: _get_entities,  # type: ignore[dict-item]
    services.GetEntityStateRequest: _get_state,  # type: ignore[dict-item]
    services.SetEntityStateRequest: _set_state,  # type: ignore[dict-item]
    services.GetSimulationStateRequest: _get_simulation_state,  # type: ignore[dict-item]
    services.SetSimulationStateRequest: _set_simulation_state,  # type: ignore[dict-item]
    services.StepSimulationRequest: _step,  # type: ignore[dict-item]
    services.ResetSimulationRequest: _reset,  # type: ignore[dict-item]
    services.GetSimulatorFeaturesRequest: _features,  # type: ignore[dict-item]
    claims.ClaimEntityRequest: _claim,  # type: ignore[dict-item]
    telemetry.GetModelsRequest: _get_models,  # type: ignore[dict-item]
    assets.MissingAssetsRequest: _missing_assets,  # type: ignore[dict-item]
    assets.PutAssetRequest: _put_asset,  # type: ignore[dict-item]
    assets.GetAssetRequest: _get_asset,  # type: ignore[dict-item]
    telemetry.InfoRequest: _info,  # type: ignore[dict-item]
}
