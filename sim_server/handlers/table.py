"""One handler a service: request in, response out. Refusals become Results here and only here."""

import msgspec

from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import DeleteEntityResponse
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import IncorrectState
from zensim.sim_server.handlers.offers import OFFERS
from zensim.sim_server.later import Later


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
    response = service.response if service else DeleteEntityResponse
    if "result" not in response.__struct_fields__:
        response = DeleteEntityResponse
    told = {"status_message": message} if "status_message" in response.__struct_fields__ else {}
    return response(result=Result(int(code), message), **told)


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
HANDLERS = {one.service.request: one.handler for one in OFFERS}
