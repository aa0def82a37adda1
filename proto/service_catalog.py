"""The catalog of services: name, request, response and result codes of each."""

from enum import IntEnum
from typing import Generic, TypeVar, cast

import msgspec

from zensim.proto.messages import agent_messages as agents
from zensim.proto.messages import asset_messages as assets
from zensim.proto.messages import entity_messages as entities
from zensim.proto.messages import fault_messages as faults
from zensim.proto.messages import gazebo_messages as gazebo
from zensim.proto.messages import simulation_messages as simulation
from zensim.proto.messages import spawn_messages as spawning
from zensim.proto.messages import telemetry_messages as telemetry
from zensim.proto.messages import world_messages as worlds
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
    spawning.SpawnEntityOrder,
    spawning.SpawnEntityReport,
    SpawnCode,
    is_mutating=True,
)
SPAWN_ENTITIES = Service(
    "spawn_entities",
    spawning.SpawnEntitiesOrder,
    spawning.SpawnEntitiesResponse,
    SpawnEntitiesCode,
    is_mutating=True,
)
DELETE_ENTITY = Service(
    "delete_entity", spawning.DeleteEntityRequest, spawning.DeleteEntityResponse, is_mutating=True
)
GET_ENTITIES = Service("get_entities", entities.GetEntitiesRequest, entities.GetEntitiesResponse)
GET_ENTITIES_STATES = Service(
    "get_entities_states", entities.GetEntitiesStatesOrder, entities.GetEntitiesStatesResponse
)
GET_ENTITY_STATE = Service(
    "get_entity_state", entities.GetEntityStateOrder, entities.GetEntityStateResponse
)
SET_ENTITY_STATE = Service(
    "set_entity_state",
    entities.SetEntityStateRequest,
    entities.SetEntityStateResponse,
    SetEntityStateCode,
    is_mutating=True,
)
GET_ENTITY_INFO = Service(
    "get_entity_info", entities.GetEntityInfoRequest, entities.GetEntityInfoReport
)
SET_ENTITY_INFO = Service(
    "set_entity_info",
    entities.SetEntityInfoRequest,
    entities.SetEntityInfoResponse,
    is_mutating=True,
)
GET_ENTITY_BOUNDS = Service(
    "get_entity_bounds", entities.GetEntityBoundsOrder, entities.GetEntityBoundsResponse
)
CAST_RAYS = Service("cast_rays", entities.CastRaysRequest, entities.CastRaysResponse)
GET_MAP = Service("get_map", worlds.GetMapRequest, worlds.GetMapResponse)
GET_SPAWNABLES = Service(
    "get_spawnables", spawning.GetSpawnablesRequest, spawning.GetSpawnablesResponse
)
GET_NAMED_POSES = Service(
    "get_named_poses", spawning.GetNamedPosesRequest, spawning.GetNamedPosesResponse
)
GET_NAMED_POSE_BOUNDS = Service(
    "get_named_pose_bounds", spawning.GetNamedPoseBoundsRequest, spawning.GetNamedPoseBoundsResponse
)
GET_SIMULATION_STATE = Service(
    "get_simulation_state",
    simulation.GetSimulationStateRequest,
    simulation.GetSimulationStateResponse,
)
SET_SIMULATION_STATE = Service(
    "set_simulation_state",
    simulation.SetSimulationStateRequest,
    simulation.SetSimulationStateResponse,
    SetSimulationStateCode,
    is_mutating=True,
)
STEP_SIMULATION = Service(
    "step_simulation",
    simulation.StepSimulationRequest,
    simulation.StepSimulationResponse,
    is_mutating=True,
)
SIMULATE_STEPS = Service(
    "simulate_steps",
    simulation.SimulateStepsRequest,
    simulation.SimulateStepsResponse,
    is_mutating=True,
)
JOIN_LOCKSTEP = Service(
    "join_lockstep",
    simulation.JoinLockstepRequest,
    simulation.JoinLockstepResponse,
    is_mutating=True,
)
CANCEL_STEPS = Service(
    "cancel_steps", simulation.CancelStepsRequest, simulation.CancelStepsResponse, is_mutating=True
)
RUN_TO = Service("run_to", simulation.RunToRequest, simulation.RunToResponse, is_mutating=True)
SET_SPEED = Service(
    "set_speed", simulation.SetSpeedRequest, simulation.SetSpeedResponse, is_mutating=True
)
RESET_SIMULATION = Service(
    "reset_simulation",
    simulation.ResetSimulationRequest,
    simulation.ResetSimulationResponse,
    is_mutating=True,
)
LOAD_WORLD = Service(
    "load_world", worlds.LoadWorldRequest, worlds.LoadWorldReport, LoadWorldCode, is_mutating=True
)
UNLOAD_WORLD = Service(
    "unload_world",
    worlds.UnloadWorldRequest,
    worlds.UnloadWorldResponse,
    UnloadWorldCode,
    is_mutating=True,
)
GET_CURRENT_WORLD = Service(
    "get_current_world",
    worlds.GetCurrentWorldRequest,
    worlds.GetCurrentWorldResponse,
    GetCurrentWorldCode,
)
GET_AVAILABLE_WORLDS = Service(
    "get_available_worlds",
    worlds.GetAvailableWorldsRequest,
    worlds.GetAvailableWorldsResponse,
    GetAvailableWorldsCode,
)
GAZEBO_GET_ENTITY_STATE = Service(
    "gazebo_get_entity_state", gazebo.GazeboGetEntityStateRequest, gazebo.GazeboGetEntityStateReport
)
GAZEBO_SET_ENTITY_STATE = Service(
    "gazebo_set_entity_state",
    gazebo.GazeboSetEntityStateRequest,
    gazebo.GazeboSetEntityStateReport,
    is_mutating=True,
)
PAUSE_PHYSICS = Service(
    "pause_physics", gazebo.PausePhysicsRequest, gazebo.EmptyReport, is_mutating=True
)
UNPAUSE_PHYSICS = Service(
    "unpause_physics", gazebo.UnpausePhysicsRequest, gazebo.EmptyReport, is_mutating=True
)
RESET_WORLD = Service("reset_world", gazebo.ResetWorldRequest, gazebo.EmptyReport, is_mutating=True)
GAZEBO_RESET_SIMULATION = Service(
    "gazebo_reset_simulation",
    gazebo.GazeboResetSimulationRequest,
    gazebo.EmptyReport,
    is_mutating=True,
)
GET_MODEL_LIST = Service("get_model_list", gazebo.GetModelListRequest, gazebo.GetModelListReport)
APPLY_LINK_WRENCH = Service(
    "apply_link_wrench",
    gazebo.ApplyLinkWrenchRequest,
    gazebo.ApplyLinkWrenchReport,
    is_mutating=True,
)
CLEAR_LINK_WRENCHES = Service(
    "clear_link_wrenches",
    gazebo.ClearLinkWrenchesRequest,
    gazebo.ClearLinkWrenchesReport,
    is_mutating=True,
)
APPLY_JOINT_EFFORT = Service(
    "apply_joint_effort",
    gazebo.ApplyJointEffortRequest,
    gazebo.ApplyJointEffortReport,
    is_mutating=True,
)
CLEAR_JOINT_EFFORTS = Service(
    "clear_joint_efforts",
    gazebo.ClearJointEffortsRequest,
    gazebo.ClearJointEffortsReport,
    is_mutating=True,
)
INJECT_FAULT = Service(
    "inject_fault", faults.InjectFaultRequest, faults.InjectFaultResponse, is_mutating=True
)
GET_JOINT_PROPERTIES = Service(
    "get_joint_properties", gazebo.GetJointPropertiesRequest, gazebo.GetJointPropertiesReport
)
SET_JOINT_PROPERTIES = Service(
    "set_joint_properties",
    gazebo.SetJointPropertiesRequest,
    gazebo.SetJointPropertiesReport,
    is_mutating=True,
)
GET_LINK_PROPERTIES = Service(
    "get_link_properties", gazebo.GetLinkPropertiesRequest, gazebo.GetLinkPropertiesReport
)
SET_LINK_PROPERTIES = Service(
    "set_link_properties",
    gazebo.SetLinkPropertiesRequest,
    gazebo.SetLinkPropertiesReport,
    is_mutating=True,
)
GET_SIMULATOR_FEATURES = Service(
    "get_simulator_features",
    simulation.GetSimulatorFeaturesRequest,
    simulation.GetSimulatorFeaturesResponse,
)
CLAIM_ENTITY = Service(
    "claim_entity",
    agents.ClaimEntityRequest,
    agents.ClaimEntityResponse,
    ClaimCode,
    is_mutating=True,
)
CLAIM_SHARE = Service(
    "claim_share", agents.ClaimShareRequest, agents.ClaimShareResponse, ClaimCode, is_mutating=True
)
GET_MODELS = Service("get_models", telemetry.GetModelsRequest, telemetry.GetModelsResponse)
MISSING_ASSETS = Service(
    "missing_assets", assets.MissingAssetsRequest, assets.MissingAssetsResponse
)
PUT_ASSET = Service("put_asset", assets.PutAssetRequest, assets.PutAssetResponse)
GET_ASSET = Service("get_asset", assets.GetAssetRequest, assets.GetAssetResponse)
INFO = Service("info", telemetry.InfoRequest, telemetry.Info)

SERVICES: dict[str, Service[msgspec.Struct, msgspec.Struct]] = {
    service.name: service for service in tuple(vars().values()) if isinstance(service, Service)
}
"""Every service that a server offers, by name."""
