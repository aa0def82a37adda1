"""Going back to the start."""

from zensim.proto import services
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import Unsupported


def reset(desk: Desk, request: services.ResetSimulationRequest) -> services.ResetSimulationResponse:
    """Go back to the start."""
    known = services.ResetScope.TIME | services.ResetScope.STATE | services.ResetScope.SPAWNED
    if request.scope not in (services.ResetScope.ALL, request.scope & known):
        raise Unsupported(f"scope {request.scope} has unknown bits; use 0, 255 or a sum of 1, 2, 4")
    desk.world.reset(request.scope)
    return services.ResetSimulationResponse()
