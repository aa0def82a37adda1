"""Going back to the start."""

from zensim.proto.messages.simulation_messages import (
    ResetScope,
    ResetSimulationRequest,
    ResetSimulationResponse,
)
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import Unsupported


def reset(desk: Desk, request: ResetSimulationRequest) -> ResetSimulationResponse:
    """Go back to the start."""
    known = ResetScope.TIME | ResetScope.STATE | ResetScope.SPAWNED
    if request.scope not in (ResetScope.ALL, request.scope & known):
        raise Unsupported(f"scope {request.scope} has unknown bits; use 0, 255 or a sum of 1, 2, 4")
    desk.world.reset(request.scope)
    return ResetSimulationResponse()
