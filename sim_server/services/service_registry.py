"""Registry of services: handler and features of each, and handlers bound to a server's parts."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, get_type_hints

import msgspec

from zensim.proto import service_catalog as catalog
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.simulation_messages import (
    Feature,
    GetSimulatorFeaturesRequest,
    GetSimulatorFeaturesResponse,
    SimulatorFeatures,
    State,
)
from zensim.proto.messages.spawn_messages import DeleteEntityResponse
from zensim.proto.service_catalog import SERVICES, Request, Response, Service
from zensim.sim_server.errors import IncorrectState
from zensim.sim_server.queries.map_queries import get_map
from zensim.sim_server.queries.ray_queries import cast_rays
from zensim.sim_server.service_parts import DeferredResponse, ServerParts
from zensim.sim_server.services import (
    claim_services,
    entity_services,
    gazebo_services,
    simulation_services,
    spawn_services,
    world_services,
)
from zensim.sim_server.services.fault_services import inject_fault
from zensim.sim_server.services.spawn_services import get_spawnables, spawn_entity_when_parsed

if TYPE_CHECKING:
    from typing_extensions import TypeVarTuple, Unpack

    Parts = TypeVarTuple("Parts")

SPAWN_FORMATS = ("urdf", "sdf")


@dataclass(frozen=True)
class ServiceEntry:
    """One service of this server."""

    service: Service[Any, Any]
    handler: Callable[..., msgspec.Struct | DeferredResponse[Any]]
    parts: tuple[type, ...]
    """Types of the handler's parameters before the request."""
    features: tuple[Feature, ...] = ()


def make_entry(
    service: Service[Request, Response],
    handler: "Callable[[Unpack[Parts], Request], Response | DeferredResponse[Response]]",
    *features: Feature,
) -> ServiceEntry:
    """Pair a service with its handler: a function of parts of the server and the request."""
    *parts, _request, _response = get_type_hints(handler).values()
    return ServiceEntry(service, handler, tuple(parts), features)


def get_simulator_features(_: GetSimulatorFeaturesRequest) -> GetSimulatorFeaturesResponse:
    """List the features of this server."""
    numbers = tuple(int(feature) for feature in FEATURES)
    about = SimulatorFeatures(numbers, SPAWN_FORMATS, f"zensim {simulation_services.VERSION}")
    return GetSimulatorFeaturesResponse(about)


SERVICE_TABLE = (
    make_entry(
        catalog.SPAWN_ENTITY,
        spawn_entity_when_parsed,
        Feature.SPAWNING,
        Feature.SPAWNING_RESOURCE_STRING,
    ),
    make_entry(catalog.SPAWN_ENTITIES, spawn_services.spawn_entities, Feature.SPAWNING_ENTITIES),
    make_entry(catalog.DELETE_ENTITY, entity_services.delete_entity, Feature.DELETING),
    make_entry(
        catalog.GET_ENTITIES,
        entity_services.get_entities,
        Feature.ENTITY_TAGS,
        Feature.ENTITY_CATEGORIES,
    ),
    make_entry(catalog.GET_ENTITIES_STATES, entity_services.get_entities_states),
    make_entry(
        catalog.GET_ENTITY_STATE, entity_services.get_entity_state, Feature.ENTITY_STATE_GETTING
    ),
    make_entry(
        catalog.SET_ENTITY_STATE, entity_services.set_entity_state, Feature.ENTITY_STATE_SETTING
    ),
    make_entry(
        catalog.GET_ENTITY_INFO, entity_services.get_entity_info, Feature.ENTITY_INFO_GETTING
    ),
    make_entry(
        catalog.SET_ENTITY_INFO, entity_services.set_entity_info, Feature.ENTITY_INFO_SETTING
    ),
    make_entry(
        catalog.GET_ENTITY_BOUNDS,
        entity_services.get_entity_bounds,
        Feature.ENTITY_BOUNDS,
        Feature.ENTITY_BOUNDS_BOX,
        Feature.ENTITY_BOUNDS_CONVEX,
    ),
    make_entry(catalog.CAST_RAYS, cast_rays),
    make_entry(catalog.GET_MAP, get_map),
    make_entry(catalog.GET_SPAWNABLES, get_spawnables, Feature.SPAWNABLES),
    make_entry(catalog.GET_NAMED_POSES, world_services.get_named_poses, Feature.NAMED_POSES),
    make_entry(
        catalog.GET_NAMED_POSE_BOUNDS, world_services.get_named_pose_bounds, Feature.POSE_BOUNDS
    ),
    make_entry(
        catalog.GET_SIMULATION_STATE,
        simulation_services.get_simulation_state,
        Feature.SIMULATION_STATE_GETTING,
    ),
    make_entry(
        catalog.SET_SIMULATION_STATE,
        simulation_services.set_simulation_state,
        Feature.SIMULATION_STATE_SETTING,
        Feature.SIMULATION_STATE_PAUSE,
    ),
    make_entry(
        catalog.STEP_SIMULATION,
        simulation_services.step_simulation,
        Feature.STEP_SIMULATION_SINGLE,
        Feature.STEP_SIMULATION_MULTIPLE,
    ),
    make_entry(
        catalog.SIMULATE_STEPS, simulation_services.simulate_steps, Feature.STEP_SIMULATION_ACTION
    ),
    make_entry(catalog.JOIN_LOCKSTEP, simulation_services.join_lockstep),
    make_entry(catalog.CANCEL_STEPS, simulation_services.cancel_steps),
    make_entry(catalog.RUN_TO, simulation_services.run_to),
    make_entry(catalog.SET_SPEED, simulation_services.set_speed),
    make_entry(
        catalog.RESET_SIMULATION,
        simulation_services.reset_simulation,
        Feature.SIMULATION_RESET,
        Feature.SIMULATION_RESET_TIME,
        Feature.SIMULATION_RESET_STATE,
        Feature.SIMULATION_RESET_SPAWNED,
    ),
    make_entry(
        catalog.LOAD_WORLD,
        world_services.load_world,
        Feature.WORLD_LOADING,
        Feature.WORLD_RESOURCE_STRING,
    ),
    make_entry(catalog.UNLOAD_WORLD, world_services.unload_world, Feature.WORLD_UNLOADING),
    make_entry(
        catalog.GET_CURRENT_WORLD, world_services.get_current_world, Feature.WORLD_INFO_GETTING
    ),
    make_entry(
        catalog.GET_AVAILABLE_WORLDS,
        world_services.get_available_worlds,
        Feature.AVAILABLE_WORLDS,
        Feature.WORLD_TAGS,
    ),
    make_entry(catalog.GAZEBO_GET_ENTITY_STATE, gazebo_services.get_gazebo_state),
    make_entry(catalog.GAZEBO_SET_ENTITY_STATE, gazebo_services.set_gazebo_state),
    make_entry(catalog.PAUSE_PHYSICS, gazebo_services.pause_physics),
    make_entry(catalog.UNPAUSE_PHYSICS, gazebo_services.unpause_physics),
    make_entry(catalog.RESET_WORLD, gazebo_services.reset_world),
    make_entry(catalog.GAZEBO_RESET_SIMULATION, gazebo_services.reset_gazebo_simulation),
    make_entry(catalog.GET_MODEL_LIST, gazebo_services.get_model_list),
    make_entry(catalog.APPLY_LINK_WRENCH, gazebo_services.apply_link_wrench),
    make_entry(catalog.CLEAR_LINK_WRENCHES, gazebo_services.clear_link_wrenches),
    make_entry(catalog.APPLY_JOINT_EFFORT, gazebo_services.apply_joint_effort),
    make_entry(catalog.CLEAR_JOINT_EFFORTS, gazebo_services.clear_joint_efforts),
    make_entry(catalog.INJECT_FAULT, inject_fault),
    make_entry(catalog.GET_JOINT_PROPERTIES, gazebo_services.get_joint_properties),
    make_entry(catalog.SET_JOINT_PROPERTIES, gazebo_services.set_joint_properties),
    make_entry(catalog.GET_LINK_PROPERTIES, gazebo_services.get_link_properties),
    make_entry(catalog.SET_LINK_PROPERTIES, gazebo_services.set_link_properties),
    make_entry(catalog.GET_SIMULATOR_FEATURES, get_simulator_features),
    make_entry(catalog.CLAIM_ENTITY, claim_services.claim_entity),
    make_entry(catalog.CLAIM_SHARE, claim_services.claim_share),
    make_entry(catalog.GET_MODELS, entity_services.get_models),
    make_entry(catalog.MISSING_ASSETS, spawn_services.missing_assets),
    make_entry(catalog.PUT_ASSET, spawn_services.put_asset),
    make_entry(catalog.GET_ASSET, spawn_services.get_asset),
    make_entry(catalog.INFO, simulation_services.get_server_info),
)
FEATURES = tuple(sorted(feature for one in SERVICE_TABLE for feature in one.features))


class ServiceHandlers:
    """The handlers of all services, with the parts of one server."""

    def __init__(self, parts: ServerParts) -> None:
        provided = {type(part): part for part in vars(parts).values()}
        self._world = parts.world
        self._handlers = {
            one.service.request: partial(one.handler, *(provided[part] for part in one.parts))
            for one in SERVICE_TABLE
        }

    def handle(self, request: msgspec.Struct) -> msgspec.Struct | DeferredResponse[Any]:
        """Handle a request.

        Raises:
            SimError: The request is refused.
        """
        state = self._world.clock.state
        if state in STATES_WITHOUT_WORLD and type(request) in REQUESTS_NEEDING_WORLD:
            raise IncorrectState(f"there is no world now: {NO_WORLD_HINTS[state]}")
        return self._handlers[type(request)](request)


def make_refusal(name: str, code: int, message: str) -> msgspec.Struct:
    """Make the response of a service that refuses a request."""
    service = SERVICES.get(name)
    response = service.response if service else DeleteEntityResponse
    if "result" not in response.__struct_fields__:
        response = DeleteEntityResponse
    status = {"status_message": message} if "status_message" in response.__struct_fields__ else {}
    return response(result=Result(int(code), message), **status)


NO_WORLD_HINTS = {
    State.NO_WORLD: "it is unloaded; load one with load_world",
    State.LOADING_WORLD: "another is being loaded; try again",
    State.QUITTING: "the server ends; start it again",
}
STATES_WITHOUT_WORLD = frozenset(NO_WORLD_HINTS)
SERVICES_WITHOUT_WORLD = frozenset({"set_simulation_state", "load_world", "unload_world"})
REQUESTS_NEEDING_WORLD = frozenset(
    service.request
    for service in SERVICES.values()
    if service.is_mutating and service.name not in SERVICES_WITHOUT_WORLD
)
"""Requests that change something in a world."""
