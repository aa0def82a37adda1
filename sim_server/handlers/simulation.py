"""Time: play, pause, reset."""

from proto import services
from proto.result import SetSimulationStateCode
from proto.services import State
from sim_server.desk import Desk
from sim_server.errors import Refused, Unsupported


def get_simulation_state(
    desk: Desk, _: services.GetSimulationStateRequest
) -> services.GetSimulationStateResponse:
    """Tell whether time runs."""
    return services.GetSimulationStateResponse(services.SimulationState(desk.world.state))


def set_simulation_state(
    desk: Desk, request: services.SetSimulationStateRequest
) -> services.SetSimulationStateResponse:
    """Play or pause."""
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


def reset(desk: Desk, request: services.ResetSimulationRequest) -> services.ResetSimulationResponse:
    """Go back to the start."""
    known = services.ResetScope.TIME | services.ResetScope.STATE | services.ResetScope.SPAWNED
    if request.scope not in (services.ResetScope.ALL, request.scope & known):
        raise Unsupported(f"scope {request.scope} has unknown bits; use 0, 255 or a sum of 1, 2, 4")
    desk.world.reset(request.scope)
    return services.ResetSimulationResponse()
