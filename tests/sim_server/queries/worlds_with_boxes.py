"""A server whose world has two boxes, and responses that come in time slices."""

from typing import TypeVar

import msgspec

from tests.models import a_box, on_ground
from tests.sim_server.fakes import WallTime, a_spawn, a_world, handle_request, make_parts
from zensim.sim_server.service_parts import DeferredResponse, ServerParts

Response = TypeVar("Response", bound=msgspec.Struct)


def parts_with_boxes() -> ServerParts:
    """A fixed box `near` at x = 3, and `far` at x = 6, which can be pushed; with a ground plane."""
    world = a_world()
    for name, x, is_static in (("near", 3.0, True), ("far", 6.0, False)):
        model = a_box(is_static=is_static)
        world.spawn(a_spawn(name, model=model, base=on_ground(x)))
    parts = make_parts(world, WallTime())
    parts.current_world.model = msgspec.structs.replace(
        parts.current_world.model, ground_plane=True
    )
    return parts


def respond(parts: ServerParts, request: msgspec.Struct, kind: type[Response]) -> Response:
    """Handle a request to its end."""
    response = handle_request(parts, request)
    if isinstance(response, DeferredResponse):
        while not response.is_ready():
            pass
        response = response.outcome()
    assert isinstance(response, kind)
    return response
