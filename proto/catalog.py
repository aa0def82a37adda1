"""The table of services: name, request, response, and the codes that each may answer."""

from enum import IntEnum
from typing import Generic, TypeVar

import msgspec

from zensim.proto import (
    assets,
    claims,
    entities,
    fleets,
    gazebo,
    places,
    services,
    stepping,
    telemetry,
    worlds,
)
from zensim.proto.result import (
    ClaimCode,
    GetAvailableWorldsCode,
    GetCurrentWorldCode,
    LoadWorldCode,
    ResultCode,
    SetEntityStateCode,
    SetSimulationStateCode,
    SpawnCode,
    SpawnEntitiesCode,
    UnloadWorldCode,
)

Request = TypeVar("Request", bound=msgspec.Struct)
Response = TypeVar("Response", bound=msgspec.Struct)


class NoCodes(IntEnum):
    """A service with no codes of its own."""


class Service(msgspec.Struct, Generic[Request, Response], frozen=True):
    """One service: what to send and what comes back."""

    name: str
    request: type[Request]
    response: type[Response]
    codes: type[IntEnum] = NoCodes
    is_mutating: bool = False
    """Whether the same request twice would do something twice."""

    def code_name(self, code: int) -> str:
        """Name a result code of this service."""
        for family in (ResultCode, self.codes):
            if code in set(family):
                return family(code).name
        return "UNKNOWN_CODE"


SPAWN_ENTITY = Service(
    "spawn_entity",
    services.SpawnEntityOrder,
    services.SpawnEntityReport,
    SpawnCode,
    is_mutating=True,
)
SPAWN_ENTITIES = Service(
    "spawn_entities",
    fleets.SpawnEntitiesOrder,
    fleets.SpawnEntitiesResponse,
    SpawnEntitiesCode,
    is_mutating=True,
)
DELETE_ENTITY = Service(
    "delete_entity", services.DeleteEntityRequest, services.DeleteEntityResponse, is_mutating=True
)
GET_ENTITIES = Service("get_entities", services.GetEntitiesRequest, services.GetEntitiesResponse)
GET_ENTITIES_STATES = Service(
    "get_entities_states", entities.GetEntitiesStatesOrder, entities.GetEntitiesStatesResponse
)
GET_ENTITY_STATE = Service(
    "get_entity_state", entities.GetEntityStateOrder, services.GetEntityStateResponse
)
SET_ENTITY_STATE = Service(
    "set_entity_state",
    services.SetEntityStateRequest,
    services.SetEntityStateResponse,
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
GET_SPAWNABLES = Service(
    "get_spawnables", places.GetSpawnablesRequest, places.GetSpawnablesResponse
)
GET_NAMED_POSES = Service(
    "get_named_poses", places.GetNamedPosesRequest, places.GetNamedPosesResponse
)
GET_NAMED_POSE_BOUNDS = Service(
    "get_named_pose_bounds",
    places.GetNamedPoseBoundsRequest,
    places.GetNamedPoseBoundsResponse,
)
GET_SIMULATION_STATE = Service(
    "get_simulation_state", services.GetSimulationStateRequest, services.GetSimulationStateResponse
)
SET_SIMULATION_STATE = Service(
    "set_simulation_state",
    services.SetSimulationStateRequest,
    services.SetSimulationStateResponse,
    SetSimulationStateCode,
    is_mutating=True,
)
STEP_SIMULATION = Service(
    "step_simulation",
    services.StepSimulationRequest,
    services.StepSimulationResponse,
    is_mutating=True,
)
SIMULATE_STEPS = Service(
    "simulate_steps",
    stepping.SimulateStepsRequest,
    stepping.SimulateStepsResponse,
    is_mutating=True,
)
CANCEL_STEPS = Service(
    "cancel_steps", stepping.CancelStepsRequest, stepping.CancelStepsResponse, is_mutating=True
)
RUN_TO = Service("run_to", stepping.RunToRequest, stepping.RunToResponse, is_mutating=True)
SET_SPEED = Service(
    "set_speed", stepping.SetSpeedRequest, stepping.SetSpeedResponse, is_mutating=True
)
RESET_SIMULATION = Service(
    "reset_simulation",
    services.ResetSimulationRequest,
    services.ResetSimulationResponse,
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
    services.GetSimulatorFeaturesRequest,
    services.GetSimulatorFeaturesResponse,
)
CLAIM_ENTITY = Service(
    "claim_entity",
    claims.ClaimEntityRequest,
    claims.ClaimEntityResponse,
    ClaimCode,
    is_mutating=True,
)
CLAIM_SHARE = Service(
    "claim_share",
    claims.ClaimShareRequest,
    claims.ClaimShareResponse,
    ClaimCode,
    is_mutating=True,
)
GET_MODELS = Service("get_models", telemetry.GetModelsRequest, telemetry.GetModelsResponse)
MISSING_ASSETS = Service(
    "missing_assets", assets.MissingAssetsRequest, assets.MissingAssetsResponse
)
PUT_ASSET = Service("put_asset", assets.PutAssetRequest, assets.PutAssetResponse)
GET_ASSET = Service("get_asset", assets.GetAssetRequest, assets.GetAssetResponse)
INFO = Service("info", telemetry.InfoRequest, telemetry.Info)

SERVICES: dict[str, Service[msgspec.Struct, msgspec.Struct]] = {
    service.name: service  # type: ignore[misc]
    for service in (
        SPAWN_ENTITY,
        SPAWN_ENTITIES,
        DELETE_ENTITY,
        GET_ENTITIES,
        GET_ENTITIES_STATES,
        GET_ENTITY_STATE,
        SET_ENTITY_STATE,
        GET_ENTITY_INFO,
        SET_ENTITY_INFO,
        GET_ENTITY_BOUNDS,
        GET_SPAWNABLES,
        GET_NAMED_POSES,
        GET_NAMED_POSE_BOUNDS,
        GET_SIMULATION_STATE,
        SET_SIMULATION_STATE,
        STEP_SIMULATION,
        SIMULATE_STEPS,
        CANCEL_STEPS,
        RUN_TO,
        SET_SPEED,
        RESET_SIMULATION,
        LOAD_WORLD,
        UNLOAD_WORLD,
        GET_CURRENT_WORLD,
        GET_AVAILABLE_WORLDS,
        GAZEBO_GET_ENTITY_STATE,
        GAZEBO_SET_ENTITY_STATE,
        PAUSE_PHYSICS,
        UNPAUSE_PHYSICS,
        RESET_WORLD,
        APPLY_LINK_WRENCH,
        CLEAR_LINK_WRENCHES,
        APPLY_JOINT_EFFORT,
        CLEAR_JOINT_EFFORTS,
        GET_JOINT_PROPERTIES,
        SET_JOINT_PROPERTIES,
        GET_LINK_PROPERTIES,
        SET_LINK_PROPERTIES,
        GET_SIMULATOR_FEATURES,
        CLAIM_ENTITY,
        CLAIM_SHARE,
        GET_MODELS,
        MISSING_ASSETS,
        PUT_ASSET,
        GET_ASSET,
        INFO,
    )
}
"""Every service that a server offers, by name."""
