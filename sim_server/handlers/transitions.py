"""The state of the simulation: telling it, and going from one to another."""

from zensim.proto.messages.result_messages import SetSimulationStateCode
from zensim.proto.messages.simulation_messages import (
    GetSimulationStateRequest,
    GetSimulationStateResponse,
    ResetScope,
    SetSimulationStateRequest,
    SetSimulationStateResponse,
    SimulationState,
    State,
)
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import Refused, SimError
from zensim.sim_server.world.phases import LEADS_TO, NAMES, why_not


def get_simulation_state(desk: Desk, _: GetSimulationStateRequest) -> GetSimulationStateResponse:
    """Tell whether time runs."""
    return GetSimulationStateResponse(SimulationState(desk.world.state))


def set_simulation_state(
    desk: Desk, request: SetSimulationStateRequest
) -> SetSimulationStateResponse:
    """Play, pause, stop or quit."""
    wanted, present = request.state.state, desk.world.state
    if wanted == present:
        raise Refused(
            SetSimulationStateCode.ALREADY_IN_TARGET_STATE,
            f"the simulation is {desk.world.state_name} already",
        )
    if wanted not in LEADS_TO[present]:
        raise Refused(SetSimulationStateCode.INCORRECT_TRANSITION, why_not(wanted, present))
    if wanted in (State.STOPPED, State.QUITTING):
        desk.stepping.abort(f"the simulation is {NAMES[State(wanted)]}")
    if wanted == State.STOPPED:
        _go_to_start(desk)
    desk.world.enter(State(wanted))
    return SetSimulationStateResponse()


def _go_to_start(desk: Desk) -> None:
    try:
        desk.world.reset(ResetScope.ALL)
    except SimError as error:
        raise Refused(SetSimulationStateCode.STATE_TRANSITION_ERROR, str(error)) from error
