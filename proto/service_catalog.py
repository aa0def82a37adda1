"""The catalog of services: name, request, response and result codes of each."""

from enum import IntEnum
from typing import Generic, TypeVar, cast

import msgspec

from zensim.proto.messages import (
    agent_messages,
    asset_messages,
    entity_messages,
    fault_messages,
    gazebo_messages,
    simulation_messages,
    spawn_messages,
    telemetry_messages,
    world_messages,
)
from zensim.proto.messages.result_messages import (
    ClaimCode,
    GetAvailableWorldsCode,
    GetCurrentWorldCode,
    LoadWorldCode,
    Result,
    ResultCode,
    ServiceError,
    SetEntityStateCode,
    SetSimulationStateCode,
    SpawnCode,
    SpawnEntitiesCode,
    UnloadWorldCode,
)
from zensim.proto.messages.simulation_messages import (
    GetSimulationStateRequest,
    GetSimulationStateResponse,
    GetSimulatorFeaturesRequest,
    GetSimulatorFeaturesResponse,
    ResetSimulationRequest,
    ResetSimulationResponse,
    SetSimulationStateRequest,
    SetSimulationStateResponse,
    StepSimulationRequest,
    StepSimulationResponse,
)
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    DeleteEntityResponse,
    SpawnEntityOrder,
    SpawnEntityReport,
)

Request = TypeVar("Request", bound=msgspec.Struct)
Response = TypeVar("Response", bound=msgspec.Struct)


class NoCodes(IntEnum):
    """Codes of a service that has only those of `ResultCode`."""


class Service(msgspec.Struct, Generic[Request, Response], frozen=True):
    """Name, messages and result codes of a service."""

    name: str
    request: type[Request]
    response: type[Response]
    codes: type[IntEnum] = NoCodes
    is_mutating: bool = False
    """Whether a repeated request would have a second effect."""

    def code_name(self, code: int) -> str:
        """Name a result code of this service."""
        for family in (ResultCode, self.codes):
            if code in set(family):
                return family(code).name
        return "UNKNOWN_CODE"


def require_ok(service: Service[Request, Response], response: msgspec.Struct) -> Response:
    """Return the response of a service unless it is a refusal.

    Raises:
        ServiceError: The request was refused.
    """
    result: Result = getattr(response, "result", Result())
    if result.result != ResultCode.OK:
        name = service.code_name(result.result)
        raise ServiceError(service.name, result.result, name, result.error_message, response)
    return cast("Response", response)


SPAWN_ENTITY = Service(
    "spawn_entity",
    SpawnEntityOrder,
    SpawnEntityReport,
    SpawnCode,
    is_mutating=True,
)
SPAWN_ENTITIES = Service(
    "spawn_entities",
    spawn_messages.SpawnEntitiesOrder,
    spawn_messages.SpawnEntitiesResponse,
    SpawnEntitiesCode,
    is_mutating=True,
)
DELETE_ENTITY = Service(
    "delete_entity", DeleteEntityRequest, DeleteEntityResponse, is_mutating=True
)
GET_ENTITIES = Service(
    "get_entities", entity_messages.GetEntitiesRequest, entity_messages.GetEntitiesResponse
)
GET_ENTITIES_STATES = Service(
    "get_entities_states",
    entity_messages.GetEntitiesStatesOrder,
    entity_messages.GetEntitiesStatesResponse,
)
GET_ENTITY_STATE = Service(
    "get_entity_state", entity_messages.GetEntityStateOrder, entity_messages.GetEntityStateResponse
)
SET_ENTITY_STATE = Service(
    "set_entity_state",
    entity_messages.SetEntityStateRequest,
    entity_messages.SetEntityStateResponse,
    SetEntityStateCode,
    is_mutating=True,
)
GET_ENTITY_INFO = Service(
    "get_entity_info", entity_messages.GetEntityInfoRequest, entity_messages.GetEntityInfoReport
)
SET_ENTITY_INFO = Service(
    "set_entity_info",
    entity_messages.SetEntityInfoRequest,
    entity_messages.SetEntityInfoResponse,
    is_mutating=True,
)
GET_ENTITY_BOUNDS = Service(
    "get_entity_bounds",
    entity_messages.GetEntityBoundsOrder,
    entity_messages.GetEntityBoundsResponse,
)
CAST_RAYS = Service("cast_rays", entity_messages.CastRaysRequest, entity_messages.CastRaysResponse)
GET_MAP = Service("get_map", world_messages.GetMapRequest, world_messages.GetMapResponse)
GET_SPAWNABLES = Service(
    "get_spawnables", spawn_messages.GetSpawnablesRequest, spawn_messages.GetSpawnablesResponse
)
GET_NAMED_POSES = Service(
    "get_named_poses", spawn_messages.GetNamedPosesRequest, spawn_messages.GetNamedPosesResponse
)
GET_NAMED_POSE_BOUNDS = Service(
    "get_named_pose_bounds",
    spawn_messages.GetNamedPoseBoundsRequest,
    spawn_messages.GetNamedPoseBoundsResponse,
)
GET_SIMULATION_STATE = Service(
    "get_simulation_state", GetSimulationStateRequest, GetSimulationStateResponse
)
SET_SIMULATION_STATE = Service(
    "set_simulation_state",
    SetSimulationStateRequest,
    SetSimulationStateResponse,
    SetSimulationStateCode,
    is_mutating=True,
)
STEP_SIMULATION = Service(
    "step_simulation",
    StepSimulationRequest,
    StepSimulationResponse,
    is_mutating=True,
)
SIMULATE_STEPS = Service(
    "simulate_steps",
    simulation_messages.SimulateStepsRequest,
    simulation_messages.SimulateStepsResponse,
    is_mutating=True,
)
JOIN_LOCKSTEP = Service(
    "join_lockstep",
    simulation_messages.JoinLockstepRequest,
    simulation_messages.JoinLockstepResponse,
    is_mutating=True,
)
CANCEL_STEPS = Service(
    "cancel_steps",
    simulation_messages.CancelStepsRequest,
    simulation_messages.CancelStepsResponse,
    is_mutating=True,
)
RUN_TO = Service(
    "run_to", simulation_messages.RunToRequest, simulation_messages.RunToResponse, is_mutating=True
)
SET_SPEED = Service(
    "set_speed",
    simulation_messages.SetSpeedRequest,
    simulation_messages.SetSpeedResponse,
    is_mutating=True,
)
RESET_SIMULATION = Service(
    "reset_simulation",
    ResetSimulationRequest,
    ResetSimulationResponse,
    is_mutating=True,
)
LOAD_WORLD = Service(
    "load_world",
    world_messages.LoadWorldRequest,
    world_messages.LoadWorldReport,
    LoadWorldCode,
    is_mutating=True,
)
UNLOAD_WORLD = Service(
    "unload_world",
    world_messages.UnloadWorldRequest,
    world_messages.UnloadWorldResponse,
    UnloadWorldCode,
    is_mutating=True,
)
GET_CURRENT_WORLD = Service(
    "get_current_world",
    world_messages.GetCurrentWorldRequest,
    world_messages.GetCurrentWorldResponse,
    GetCurrentWorldCode,
)
GET_AVAILABLE_WORLDS = Service(
    "get_available_worlds",
    world_messages.GetAvailableWorldsRequest,
    world_messages.GetAvailableWorldsResponse,
    GetAvailableWorldsCode,
)
GAZEBO_GET_ENTITY_STATE = Service(
    "gazebo_get_entity_state",
    gazebo_messages.GazeboGetEntityStateRequest,
    gazebo_messages.GazeboGetEntityStateReport,
)
GAZEBO_SET_ENTITY_STATE = Service(
    "gazebo_set_entity_state",
    gazebo_messages.GazeboSetEntityStateRequest,
    gazebo_messages.GazeboSetEntityStateReport,
    is_mutating=True,
)
PAUSE_PHYSICS = Service(
    "pause_physics",
    gazebo_messages.PausePhysicsRequest,
    gazebo_messages.EmptyReport,
    is_mutating=True,
)
UNPAUSE_PHYSICS = Service(
    "unpause_physics",
    gazebo_messages.UnpausePhysicsRequest,
    gazebo_messages.EmptyReport,
    is_mutating=True,
)
RESET_WORLD = Service(
    "reset_world", gazebo_messages.ResetWorldRequest, gazebo_messages.EmptyReport, is_mutating=True
)
GAZEBO_RESET_SIMULATION = Service(
    "gazebo_reset_simulation",
    gazebo_messages.GazeboResetSimulationRequest,
    gazebo_messages.EmptyReport,
    is_mutating=True,
)
GET_MODEL_LIST = Service(
    "get_model_list", gazebo_messages.GetModelListRequest, gazebo_messages.GetModelListReport
)
APPLY_LINK_WRENCH = Service(
    "apply_link_wrench",
    gazebo_messages.ApplyLinkWrenchRequest,
    gazebo_messages.ApplyLinkWrenchReport,
    is_mutating=True,
)
CLEAR_LINK_WRENCHES = Service(
    "clear_link_wrenches",
    gazebo_messages.ClearLinkWrenchesRequest,
    gazebo_messages.ClearLinkWrenchesReport,
    is_mutating=True,
)
APPLY_JOINT_EFFORT = Service(
    "apply_joint_effort",
    gazebo_messages.ApplyJointEffortRequest,
    gazebo_messages.ApplyJointEffortReport,
    is_mutating=True,
)
CLEAR_JOINT_EFFORTS = Service(
    "clear_joint_efforts",
    gazebo_messages.ClearJointEffortsRequest,
    gazebo_messages.ClearJointEffortsReport,
    is_mutating=True,
)
INJECT_FAULT = Service(
    "inject_fault",
    fault_messages.InjectFaultRequest,
    fault_messages.InjectFaultResponse,
    is_mutating=True,
)
GET_JOINT_PROPERTIES = Service(
    "get_joint_properties",
    gazebo_messages.GetJointPropertiesRequest,
    gazebo_messages.GetJointPropertiesReport,
)
SET_JOINT_PROPERTIES = Service(
    "set_joint_properties",
    gazebo_messages.SetJointPropertiesRequest,
    gazebo_messages.SetJointPropertiesReport,
    is_mutating=True,
)
GET_LINK_PROPERTIES = Service(
    "get_link_properties",
    gazebo_messages.GetLinkPropertiesRequest,
    gazebo_messages.GetLinkPropertiesReport,
)
SET_LINK_PROPERTIES = Service(
    "set_link_properties",
    gazebo_messages.SetLinkPropertiesRequest,
    gazebo_messages.SetLinkPropertiesReport,
    is_mutating=True,
)
GET_SIMULATOR_FEATURES = Service(
    "get_simulator_features",
    GetSimulatorFeaturesRequest,
    GetSimulatorFeaturesResponse,
)
CLAIM_ENTITY = Service(
    "claim_entity",
    agent_messages.ClaimEntityRequest,
    agent_messages.ClaimEntityResponse,
    ClaimCode,
    is_mutating=True,
)
CLAIM_SHARE = Service(
    "claim_share",
    agent_messages.ClaimShareRequest,
    agent_messages.ClaimShareResponse,
    ClaimCode,
    is_mutating=True,
)
GET_MODELS = Service(
    "get_models", telemetry_messages.GetModelsRequest, telemetry_messages.GetModelsResponse
)
MISSING_ASSETS = Service(
    "missing_assets", asset_messages.MissingAssetsRequest, asset_messages.MissingAssetsResponse
)
PUT_ASSET = Service("put_asset", asset_messages.PutAssetRequest, asset_messages.PutAssetResponse)
GET_ASSET = Service("get_asset", asset_messages.GetAssetRequest, asset_messages.GetAssetResponse)
INFO = Service("info", telemetry_messages.InfoRequest, telemetry_messages.Info)

SERVICES: dict[str, Service[msgspec.Struct, msgspec.Struct]] = {
    service.name: service for service in tuple(vars().values()) if isinstance(service, Service)
}
"""Every service that a server offers, by name."""
