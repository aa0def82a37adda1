"""ServiceClient: a typed method for each service, over a network or in this process."""

from zensim.proto import service_catalog
from zensim.proto.messages.asset_messages import (
    MissingAssetsRequest,
    MissingAssetsResponse,
    PutAssetRequest,
)
from zensim.proto.messages.entity_messages import (
    ANY_BOUNDS,
    Bounds,
    CastRaysRequest,
    CastRaysResponse,
    EntityFilters,
    EntityInfo,
    EntityState,
    GetEntitiesRequest,
    GetEntitiesStatesOrder,
    GetEntityBoundsOrder,
    GetEntityInfoRequest,
    GetEntityStateOrder,
    SetEntityInfoRequest,
    SetEntityStateRequest,
    TagsFilter,
)
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import (
    CancelStepsRequest,
    GetSimulationStateRequest,
    GetSimulatorFeaturesRequest,
    ResetScope,
    ResetSimulationRequest,
    RunToRequest,
    RunToResponse,
    SetSimulationStateRequest,
    SetSpeedRequest,
    SimulationState,
    SimulatorFeatures,
    State,
    StepSimulationRequest,
)
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    GetNamedPoseBoundsRequest,
    GetNamedPosesRequest,
    GetSpawnablesRequest,
    NamedPose,
    Resource,
    Spawnable,
    SpawnEntitiesOrder,
    SpawnEntitiesResponse,
    SpawnEntityOrder,
    SpawnEntityReport,
)
from zensim.proto.messages.standard_messages import NANOSECONDS, OccupancyGrid, time_from_ns
from zensim.proto.messages.telemetry_messages import (
    EntityModel,
    GetModelsRequest,
    GetModelsResponse,
    Info,
    InfoRequest,
)
from zensim.proto.messages.world_messages import (
    GetAvailableWorldsRequest,
    GetCurrentWorldRequest,
    GetMapRequest,
    LoadWorldReport,
    LoadWorldRequest,
    UnloadWorldRequest,
    WorldResource,
)
from zensim.proto.network_protocols import CallingNetwork
from zensim.proto.service_catalog import Request, Response, Service

CALL_TIMEOUT_S = 10.0
LOAD_TIMEOUT_S = 60.0
"""A world may have 2000 models."""
SPAWN_TIMEOUT_S = 30.0
"""Longest wait for a spawn: a large description on a busy host."""
TIMEOUT_PER_SPAWN_S = 0.1
"""Wait per entity of a batch."""
TIMEOUT_PER_STEP_S = 0.05
"""Wait per requested step."""


class ServiceClient:
    """Client of the services of one world.

    Methods raise ServiceError if the server refuses, TimeoutError or NoServer without a reply.
    """

    def __init__(
        self, network: CallingNetwork, world: str = "default", timeout_s: float = CALL_TIMEOUT_S
    ) -> None:
        self._network = network
        self.world = world
        self._timeout_s = timeout_s

    def _call(self, service: Service[Request, Response], request: Request) -> Response:
        return self._network.call(service, request, world=self.world, timeout_s=self._timeout_s)

    def info(self) -> Info:
        """Get version, engine, time and load of the server."""
        return self._network.call(
            service_catalog.INFO,
            InfoRequest(),
            world=self.world,
            timeout_s=min(self._timeout_s, 2.0),
        )

    def spawn(self, order: SpawnEntityOrder) -> SpawnEntityReport:
        """Spawn one entity."""
        timeout_s = max(self._timeout_s, SPAWN_TIMEOUT_S)
        return self._network.call(
            service_catalog.SPAWN_ENTITY, order, world=self.world, timeout_s=timeout_s
        )

    def spawn_all(self, order: SpawnEntitiesOrder) -> SpawnEntitiesResponse:
        """Spawn many entities, with a result for each, also if refused."""
        timeout_s = max(self._timeout_s, len(order.spawn_requests) * TIMEOUT_PER_SPAWN_S)
        try:
            return self._network.call(
                service_catalog.SPAWN_ENTITIES, order, world=self.world, timeout_s=timeout_s
            )
        except ServiceError as error:
            if isinstance(error.response, SpawnEntitiesResponse) and error.response.results:
                return error.response
            raise

    def missing_assets(self, sha256s: tuple[str, ...]) -> MissingAssetsResponse:
        """Find the files that the server lacks."""
        return self._call(service_catalog.MISSING_ASSETS, MissingAssetsRequest(sha256s))

    def put_asset(self, sha256: str, *, offset: int, total: int, data: bytes) -> int:
        """Upload a chunk of a file, and return the number of bytes that the server has."""
        request = PutAssetRequest(sha256, offset, total, data)
        return self._call(service_catalog.PUT_ASSET, request).received

    def delete(self, entity: str) -> None:
        """Delete an entity."""
        self._call(service_catalog.DELETE_ENTITY, DeleteEntityRequest(entity))

    def entities(self, filters: EntityFilters | None = None) -> tuple[str, ...]:
        """List the names of all entities that pass the filters."""
        request = GetEntitiesRequest(filters or EntityFilters())
        return self._call(service_catalog.GET_ENTITIES, request).entities

    def entity_states(
        self, filters: EntityFilters | None = None, reference_frame: str = ""
    ) -> dict[str, EntityState]:
        """Get poses and twists of entities at one step, in the world or another frame."""
        request = GetEntitiesStatesOrder(filters or EntityFilters(), reference_frame)
        reply = self._call(service_catalog.GET_ENTITIES_STATES, request)
        return dict(zip(reply.entities, reply.states, strict=True))

    def entity_state(self, entity: str, reference_frame: str = "") -> EntityState:
        """Get pose and twist of an entity, in the world or another frame."""
        request = GetEntityStateOrder(entity, reference_frame)
        return self._call(service_catalog.GET_ENTITY_STATE, request).state

    def entity_info(self, entity: str) -> EntityInfo:
        """Get category, description and tags of an entity."""
        return self._call(service_catalog.GET_ENTITY_INFO, GetEntityInfoRequest(entity)).info

    def set_entity_info(self, entity: str, info: EntityInfo) -> None:
        """Replace category, description and tags of an entity."""
        self._call(service_catalog.SET_ENTITY_INFO, SetEntityInfoRequest(entity, info))

    def entity_bounds(self, entity: str, kind: int = ANY_BOUNDS) -> Bounds:
        """Get the bounds of an entity in the frame of its base link; see `BoundsType`."""
        return self._call(
            service_catalog.GET_ENTITY_BOUNDS, GetEntityBoundsOrder(entity, kind)
        ).bounds

    def map(self, request: GetMapRequest) -> OccupancyGrid:
        """Get a map of what is fixed in the world."""
        return self._call(service_catalog.GET_MAP, request).map

    def cast_rays(self, request: CastRaysRequest) -> CastRaysResponse:
        """Find what rays hit first."""
        return self._call(service_catalog.CAST_RAYS, request)

    def spawnables(self) -> tuple[Spawnable, ...]:
        """List the models that can be spawned by URI."""
        return self._call(service_catalog.GET_SPAWNABLES, GetSpawnablesRequest()).spawnables

    def named_poses(self, tags: TagsFilter | None = None) -> tuple[NamedPose, ...]:
        """List the named poses of the world that pass the filter."""
        request = GetNamedPosesRequest(tags or TagsFilter())
        return self._call(service_catalog.GET_NAMED_POSES, request).poses

    def named_pose_bounds(self, name: str) -> Bounds:
        """Get the bounds of a named pose in its own frame; empty = unbounded."""
        request = GetNamedPoseBoundsRequest(name)
        return self._call(service_catalog.GET_NAMED_POSE_BOUNDS, request).bounds

    def set_entity_state(
        self, entity: str, state: EntityState, *, has_pose: bool = True, has_twist: bool = True
    ) -> None:
        """Set pose, twist or both of an entity, in the frame of the header."""
        request = SetEntityStateRequest(entity, state, set_pose=has_pose, set_twist=has_twist)
        self._call(service_catalog.SET_ENTITY_STATE, request)

    def models(
        self, entities: tuple[str, ...] = (), *, wants_descriptions: bool = False
    ) -> GetModelsResponse:
        """Get the models of the named entities, or of all; see `GetModelsRequest`."""
        request = GetModelsRequest(entities, wants_descriptions)
        return self._call(service_catalog.GET_MODELS, request)

    def entity_model(self, entity: str) -> EntityModel:
        """Get namespace, agent and model index of an entity."""
        return self.models((entity,)).entities[0]

    def simulation_state(self) -> State:
        """Get the state of the simulation."""
        response = self._call(service_catalog.GET_SIMULATION_STATE, GetSimulationStateRequest())
        return State(response.state.state)

    def set_simulation_state(self, state: State) -> None:
        """Set the state of the simulation."""
        self._call(
            service_catalog.SET_SIMULATION_STATE, SetSimulationStateRequest(SimulationState(state))
        )

    def step(self, steps: int) -> None:
        """Advance a paused simulation, and wait for completion."""
        self._network.call(
            service_catalog.STEP_SIMULATION,
            StepSimulationRequest(steps),
            world=self.world,
            timeout_s=self._step_timeout_s(steps),
        )

    def cancel_steps(self, goal_id: str = "") -> tuple[str, ...]:
        """Cancel a goal, or all goals; return the ids of the canceled ones."""
        return self._call(service_catalog.CANCEL_STEPS, CancelStepsRequest(goal_id)).goal_ids

    def run_to(self, time_ns: int, timeout_s: float | None = None) -> RunToResponse:
        """Advance a paused simulation to the first step at or after a simulation time [ns]."""
        if timeout_s is None:
            timeout_s = self._step_timeout_s(self.steps_until(time_ns))
        request = RunToRequest(time_from_ns(time_ns))
        return self._network.call(
            service_catalog.RUN_TO, request, world=self.world, timeout_s=timeout_s
        )

    def steps_until(self, time_ns: int) -> int:
        """Count the steps to the first one at or after a time [ns]; negative if that is past."""
        info = self.info()
        if info.state == "restoring":
            raise TimeoutError("the server restores its journal; wait until it has")
        now_ns = round(info.sim_time_s * NANOSECONDS)
        return -((now_ns - time_ns) // max(1, info.step_ns))

    def set_speed(self, real_time_factor: float) -> None:
        """Set the target real-time factor; 0 = as fast as possible."""
        self._call(service_catalog.SET_SPEED, SetSpeedRequest(real_time_factor))

    def _step_timeout_s(self, steps: int) -> float:
        return max(self._timeout_s, steps * TIMEOUT_PER_STEP_S)

    def reset(self, scope: int = ResetScope.DEFAULT) -> None:
        """Reset the parts of the simulation in `scope`."""
        self._call(service_catalog.RESET_SIMULATION, ResetSimulationRequest(scope))

    def load_world(
        self,
        uri: str = "",
        text: str = "",
        *,
        is_strict: bool = False,
        may_lack_assets: bool = False,
    ) -> LoadWorldReport:
        """Replace the world by a named one or an SDF text; its state is STOPPED."""
        request = LoadWorldRequest(Resource(uri, text), is_strict, may_lack_assets)
        return self._network.call(
            service_catalog.LOAD_WORLD,
            request,
            world=self.world,
            timeout_s=max(self._timeout_s, LOAD_TIMEOUT_S),
        )

    def unload_world(self) -> None:
        """Unload the world, and delete all entities."""
        self._call(service_catalog.UNLOAD_WORLD, UnloadWorldRequest())

    def current_world(self) -> WorldResource:
        """Get the current world."""
        return self._call(service_catalog.GET_CURRENT_WORLD, GetCurrentWorldRequest()).world

    def available_worlds(
        self, tags: TagsFilter | None = None, sources: tuple[str, ...] = ()
    ) -> tuple[WorldResource, ...]:
        """List the worlds that can be loaded and pass the filter."""
        request = GetAvailableWorldsRequest(sources, tags or TagsFilter())
        return self._call(service_catalog.GET_AVAILABLE_WORLDS, request).worlds

    def features(self) -> SimulatorFeatures:
        """Get the features of the server."""
        return self._call(
            service_catalog.GET_SIMULATOR_FEATURES, GetSimulatorFeaturesRequest()
        ).features
