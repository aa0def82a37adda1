"""Claims of agents."""

from proto import claims
from proto.names import InvalidName, check_name
from proto.result import ClaimCode, Result
from sim_server.desk import Desk
from sim_server.errors import IncorrectState, Refused


def claim(desk: Desk, request: claims.ClaimEntityRequest) -> claims.ClaimEntityResponse:
    """Make an agent the driver of entities."""
    try:
        agent = check_name(request.agent, "agent")
    except InvalidName as error:
        raise Refused(ClaimCode.AGENT_INVALID, str(error)) from error
    if agent not in desk.alive_agents:
        raise IncorrectState(f"agent '{agent}' has no liveliness token; declare it before claiming")
    if not request.entities:
        raise Refused(ClaimCode.NOT_DRIVABLE, "no entity was named; name at least one")
    granted = desk.world.claim(agent, request.entities, request.on_release)
    return claims.ClaimEntityResponse(
        Result(), granted, desk.world.step_ns, desk.world.control_steps
    )
