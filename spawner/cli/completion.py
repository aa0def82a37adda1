"""What the operator's commands offer a shell that asks how a name goes on."""

from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

import typer

from zensim.proto.bus import DEFAULT_ENDPOINT, BusConfig, open_bus
from zensim.proto.exit_codes import EXPECTED_FAILURES
from zensim.spawner.client import SimClient

Found = TypeVar("Found")

PATIENCE_S = 0.3
"""Nobody waits longer for a word; without an answer nothing is offered."""


def entity_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """List the entities whose names begin so; none when no server answers in time."""
    taken = ctx.params.get("names") or ()
    found = _asked(ctx, SimClient.entities)
    return [name for name in found if name.startswith(incomplete) and name not in taken]


def world_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """List the worlds that the server can load and that begin so."""
    found = _asked(ctx, SimClient.available_worlds)
    uris = [one.world_resource.uri for one in found]
    return [uri for uri in uris if uri.startswith(incomplete)]


def _asked(ctx: typer.Context, ask: Callable[[SimClient], Sequence[Found]]) -> Sequence[Found]:
    endpoint = ctx.params.get("connect") or DEFAULT_ENDPOINT
    world = ctx.params.get("world_name") or "default"
    try:
        with open_bus(BusConfig(connect=(endpoint,), open_timeout_s=PATIENCE_S)) as bus:
            return ask(SimClient(bus, world, PATIENCE_S))
    except EXPECTED_FAILURES:
        return ()


Name = Annotated[str, typer.Argument(help="Name of the entity.", autocompletion=entity_names)]
"""An entity that a command is about."""
