"""One handler a service: request in, response out. Refusals become Results here and only here."""

from collections.abc import Callable

import msgspec

from proto import assets, claims, services, stepping, telemetry, worlds
from proto.catalog import SERVICES
from proto.result import Result
from proto.services import State
from sim_server.desk import Desk
from sim_server.errors import IncorrectState
from sim_server.handlers import (
    agents,
    entities,
    files,
    info,
    pacing,
    simulation,
    states,
    transitions,
)
from sim_server.handlers import worlds as world_handlers
from sim_server.later import Later
from sim_server.spawning import spawn_when_read


def handle(desk: Desk, request: msgspec.Struct) -> msgspec.Struct | Later:
    """Carry out a request, or begin to.

    Raises:
        SimError: It is refused.
    """
    if desk.world.state in WORLDLESS and type(request) in NEEDS_WORLD:
        raise IncorrectState(f"there is no world now: {NO_WORLD_HINTS[desk.world.state]}")
    return HANDLERS[type(request)](desk, request)


def refusal(name: str, code: int, message: str) -> msgspec.Struct:
    """Make a service's response that says no."""
    service = SERVICES.get(name)
    response = service.response if service else services.DeleteEntityResponse
    if "result" not in response.__struct_fields__:
        response = services.DeleteEntityResponse
    return response(result=Result(int(code), message))


NO_WORLD_HINTS = {
    State.NO_WORLD: "it is unloaded; load one with load_world",
    State.LOADING_WORLD: "another is being loaded; try again",
    State.QUITTING: "the server ends; start it again",
}
WORLDLESS = frozenset(NO_WORLD_HINTS)
WITHOUT_WORLD = frozenset({"set_simulation_state", "load_world", "unload_world"})
NEEDS_WORLD = frozenset(
    service.request
    for service in SERVICES.values()
    if service.is_mutating and service.name not in WITHOUT_WORLD
)
"""What only a world can do: all that changes something in it."""
HANDLERS: dict[type[msgspec.Struct], Callable[[Desk, msgspec.Struct], msgspec.Struct | Later]] = {
    services.SpawnEntityOrder: spawn_when_read,  # type: ignore[dict-item]
    services.DeleteEntityRequest: entities.delete,  # type: ignore[dict-item]
    services.GetEntitiesRequest: entities.get_entities,  # type: ignore[dict-item]
    services.GetEntityStateRequest: states.get_state,  # type: ignore[dict-item]
    services.SetEntityStateRequest: states.set_state,  # type: ignore[dict-item]
    services.GetSimulationStateRequest: transitions.get_simulation_state,  # type: ignore[dict-item]
    services.SetSimulationStateRequest: transitions.set_simulation_state,  # type: ignore[dict-item]
    services.StepSimulationRequest: pacing.step,  # type: ignore[dict-item]
    stepping.SimulateStepsRequest: pacing.simulate_steps,  # type: ignore[dict-item]
    stepping.CancelStepsRequest: pacing.cancel_steps,  # type: ignore[dict-item]
    stepping.RunToRequest: pacing.run_to,  # type: ignore[dict-item]
    stepping.SetSpeedRequest: pacing.set_speed,  # type: ignore[dict-item]
    services.ResetSimulationRequest: simulation.reset,  # type: ignore[dict-item]
    worlds.LoadWorldRequest: world_handlers.load_world,  # type: ignore[dict-item]
    worlds.UnloadWorldRequest: world_handlers.unload_world,  # type: ignore[dict-item]
    worlds.GetCurrentWorldRequest: world_handlers.get_current_world,  # type: ignore[dict-item]
    worlds.GetAvailableWorldsRequest: world_handlers.get_available_worlds,  # type: ignore[dict-item]
    services.GetSimulatorFeaturesRequest: info.features,  # type: ignore[dict-item]
    claims.ClaimEntityRequest: agents.claim,  # type: ignore[dict-item]
    telemetry.GetModelsRequest: entities.get_models,  # type: ignore[dict-item]
    assets.MissingAssetsRequest: files.missing_assets,  # type: ignore[dict-item]
    assets.PutAssetRequest: files.put_asset,  # type: ignore[dict-item]
    assets.GetAssetRequest: files.get_asset,  # type: ignore[dict-item]
    telemetry.InfoRequest: info.info,  # type: ignore[dict-item]
}
