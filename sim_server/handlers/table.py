"""One handler a service: request in, response out. Refusals become Results here and only here."""

from collections.abc import Callable

import msgspec

from proto import assets, claims, services, stepping, telemetry
from proto.catalog import SERVICES
from proto.result import Result
from sim_server.desk import Desk
from sim_server.handlers import agents, entities, files, info, pacing, simulation, states
from sim_server.later import Later
from sim_server.spawning import spawn_when_read


def handle(desk: Desk, request: msgspec.Struct) -> msgspec.Struct | Later:
    """Carry out a request, or begin to.

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


HANDLERS: dict[type[msgspec.Struct], Callable[[Desk, msgspec.Struct], msgspec.Struct | Later]] = {
    services.SpawnEntityOrder: spawn_when_read,  # type: ignore[dict-item]
    services.DeleteEntityRequest: entities.delete,  # type: ignore[dict-item]
    services.GetEntitiesRequest: entities.get_entities,  # type: ignore[dict-item]
    services.GetEntityStateRequest: states.get_state,  # type: ignore[dict-item]
    services.SetEntityStateRequest: states.set_state,  # type: ignore[dict-item]
    services.GetSimulationStateRequest: simulation.get_simulation_state,  # type: ignore[dict-item]
    services.SetSimulationStateRequest: simulation.set_simulation_state,  # type: ignore[dict-item]
    services.StepSimulationRequest: pacing.step,  # type: ignore[dict-item]
    stepping.SimulateStepsRequest: pacing.simulate_steps,  # type: ignore[dict-item]
    stepping.CancelStepsRequest: pacing.cancel_steps,  # type: ignore[dict-item]
    stepping.RunToRequest: pacing.run_to,  # type: ignore[dict-item]
    stepping.SetSpeedRequest: pacing.set_speed,  # type: ignore[dict-item]
    services.ResetSimulationRequest: simulation.reset,  # type: ignore[dict-item]
    services.GetSimulatorFeaturesRequest: info.features,  # type: ignore[dict-item]
    claims.ClaimEntityRequest: agents.claim,  # type: ignore[dict-item]
    telemetry.GetModelsRequest: entities.get_models,  # type: ignore[dict-item]
    assets.MissingAssetsRequest: files.missing_assets,  # type: ignore[dict-item]
    assets.PutAssetRequest: files.put_asset,  # type: ignore[dict-item]
    assets.GetAssetRequest: files.get_asset,  # type: ignore[dict-item]
    telemetry.InfoRequest: info.info,  # type: ignore[dict-item]
}
