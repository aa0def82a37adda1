"""SimClient: a typed method for each service."""

import time
from collections.abc import Callable

from proto import catalog
from proto.assets import MissingAssetsRequest, MissingAssetsResponse, PutAssetRequest
from proto.bus import Bus, NoServer
from proto.catalog import Request, Response, Service
from proto.services import (
    DeleteEntityRequest,
    EntityState,
    GetEntitiesRequest,
    GetEntityStateRequest,
    GetSimulationStateRequest,
    GetSimulatorFeaturesRequest,
    ResetScope,
    ResetSimulationRequest,
    SetEntityStateRequest,
    SetSimulationStateRequest,
    SimulationState,
    SimulatorFeatures,
    SpawnEntityOrder,
    SpawnEntityReport,
    State,
    StepSimulationRequest,
)
from proto.telemetry import EntityModel, GetModelsRequest, GetModelsResponse, Info, InfoRequest

CALL_TIMEOUT_S = 10.0
SPAWN_TIMEOUT_S = 30.0
"""A server on a busy machine takes long over a large description."""
POLL_S = 0.05


class SimClient:
    """One world's services; refusals raise ServiceError, silence TimeoutError or NoServer."""

    def __init__(self, bus: Bus, world: str = "default", timeout_s: float = CALL_TIMEOUT_S) -> None:
        self.bus = bus
        self.world = world
        self._timeout_s = timeout_s

    def wait_for_server(self, timeout_s: float, on_wait: Callable[[], None] | None = None) -> Info:
        """Ask for info until somebody answers.

        Raises:
            NoServer: Nobody did within the timeout.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                return self.info()
            except (NoServer, TimeoutError):
                if time.monotonic() >= deadline:
                    raise
            if on_wait is not None:
                on_wait()
            time.sleep(POLL_S)

    def _call(self, service: Service[Request, Response], request: Request) -> Response:
        return self.bus.call(service, request, world=self.world, timeout_s=self._timeout_s)

    def info(self) -> Info:
        """Ask who is there."""
        return self.bus.call(
            catalog.INFO, InfoRequest(), world=self.world, timeout_s=min(self._timeout_s, 2.0)
        )

    def spawn(self, order: SpawnEntityOrder) -> SpawnEntityReport:
        """Put one entity into the world."""
        timeout_s = max(self._timeout_s, SPAWN_TIMEOUT_S)
        return self.bus.call(catalog.SPAWN_ENTITY, order, world=self.world, timeout_s=timeout_s)

    def missing_assets(self, sha256s: tuple[str, ...]) -> MissingAssetsResponse:
        """Ask which files the server does not have."""
        return self._call(catalog.MISSING_ASSETS, MissingAssetsRequest(sha256s))

    def put_asset(self, sha256: str, *, offset: int, total: int, data: bytes) -> int:
        """Send a piece of a file, and return how many bytes of it are there."""
        request = PutAssetRequest(sha256, offset, total, data)
        return self._call(catalog.PUT_ASSET, request).received

    def delete(self, entity: str) -> None:
        """Take one entity out."""
        self._call(catalog.DELETE_ENTITY, DeleteEntityRequest(entity))

    def entities(self) -> tuple[str, ...]:
        """Name all entities."""
        return self._call(catalog.GET_ENTITIES, GetEntitiesRequest()).entities

    def entity_state(self, entity: str) -> EntityState:
        """Ask where one entity is, in the world frame."""
        return self._call(catalog.GET_ENTITY_STATE, GetEntityStateRequest(entity)).state

    def set_entity_state(self, entity: str, state: EntityState) -> None:
        """Put an entity at a pose, with a twist."""
        request = SetEntityStateRequest(entity, state, set_pose=True, set_twist=True)
        self._call(catalog.SET_ENTITY_STATE, request)

    def models(self, entities: tuple[str, ...] = ()) -> GetModelsResponse:
        """Ask how entities look; all of them unless named."""
        return self._call(catalog.GET_MODELS, GetModelsRequest(entities))

    def entity_model(self, entity: str) -> EntityModel:
        """Ask for the namespace, agent and model number of one entity."""
        return self.models((entity,)).entities[0]

    def simulation_state(self) -> State:
        """Ask whether it plays."""
        response = self._call(catalog.GET_SIMULATION_STATE, GetSimulationStateRequest())
        return State(response.state.state)

    def set_simulation_state(self, state: State) -> None:
        """Play or pause."""
        self._call(catalog.SET_SIMULATION_STATE, SetSimulationStateRequest(SimulationState(state)))

    def step(self, steps: int) -> None:
        """Advance a paused world, and return when it is done."""
        self.bus.call(
            catalog.STEP_SIMULATION,
            StepSimulationRequest(steps),
            world=self.world,
            timeout_s=max(self._timeout_s, steps * 0.05),
        )

    def reset(self, scope: int = ResetScope.DEFAULT) -> None:
        """Go back to the start."""
        self._call(catalog.RESET_SIMULATION, ResetSimulationRequest(scope))

    def features(self) -> SimulatorFeatures:
        """Ask what the server can do."""
        return self._call(catalog.GET_SIMULATOR_FEATURES, GetSimulatorFeaturesRequest()).features
