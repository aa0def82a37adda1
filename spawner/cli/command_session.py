"""What every command shares: common options, name completion, the connection and the consoles."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, TypeVar

import typer
from rich.console import Console
from rich.table import Table

from zensim.proto.bus import DEFAULT_ENDPOINT, BusConfig, open_bus
from zensim.proto.exit_codes import EXPECTED_FAILURES, exit_on_failure
from zensim.proto.names import check_name
from zensim.spawner.client.sim_client import SimClient

Found = TypeVar("Found")

COMPLETION_TIMEOUT_S = 0.3
"""Nobody waits longer for a word; without an answer nothing is offered."""


def complete_entity_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """List the entities whose names begin so; none when no server answers in time."""
    taken = ctx.params.get("names") or ()
    found = _query(ctx, SimClient.entities)
    return [name for name in found if name.startswith(incomplete) and name not in taken]


def complete_world_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """List the worlds that the server can load and that begin so."""
    found = _query(ctx, SimClient.available_worlds)
    uris = [one.world_resource.uri for one in found]
    return [uri for uri in uris if uri.startswith(incomplete)]


def _query(ctx: typer.Context, ask: Callable[[SimClient], Sequence[Found]]) -> Sequence[Found]:
    endpoint = ctx.params.get("connect") or DEFAULT_ENDPOINT
    world = ctx.params.get("world_name") or "default"
    try:
        with open_bus(BusConfig(connect=(endpoint,), open_timeout_s=COMPLETION_TIMEOUT_S)) as bus:
            return ask(SimClient(bus, world, COMPLETION_TIMEOUT_S))
    except EXPECTED_FAILURES:
        return ()


EntityName = Annotated[
    str, typer.Argument(help="Name of the entity.", autocompletion=complete_entity_names)
]
"""An entity that a command is about."""


Connect = Annotated[
    str, typer.Option("--connect", help="Router or server to join.", envvar="ZENSIM_CONNECT")
]
WorldName = Annotated[
    str, typer.Option("--world-name", help="World on the network.", envvar="ZENSIM_WORLD")
]
Timeout = Annotated[float, typer.Option("--timeout", help="Seconds to wait for an answer.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON on standard output.")]

MIN_TIMEOUT_S, MAX_TIMEOUT_S = 0.01, 86_400.0
OPEN_TIMEOUT_S = 0.1
MAX_LINE_WIDTH = 10_000
"""Characters of a line that no terminal shows."""

progress_console = Console(stderr=True)
"""People's side: progress and notes go to standard error."""
data_console = Console(soft_wrap=True, markup=False)
"""Programs' side: data goes to standard output."""


def print_table(table: Table) -> None:
    """Print a table as data: as wide as it is unless a terminal bounds it."""
    is_bounded = data_console.is_terminal
    console = (
        data_console if is_bounded else Console(soft_wrap=True, markup=False, width=MAX_LINE_WIDTH)
    )
    console.print(table)


@contextmanager
def open_client(
    command: str, connect: str, world: str, timeout_s: float = 10.0, *, wait_s: float = 2.0
) -> Iterator[SimClient]:
    """Open a client; a failure inside ends the command with one line and a status.

    Args:
        command: The verb, as the line names it.
        connect: Endpoint; the default one when empty.
        world: Name on the network.
        timeout_s: How long a call may take.
        wait_s: How long to wait for somebody to listen at the endpoint.
    """
    with exit_on_failure(command):
        check_name(world, "world name")
        _check_seconds("--timeout", timeout_s, MIN_TIMEOUT_S)
        _check_seconds("--wait", wait_s, 0.0)
        endpoint = connect or DEFAULT_ENDPOINT
        config = BusConfig(connect=(endpoint,), open_timeout_s=max(wait_s, OPEN_TIMEOUT_S))
        with open_bus(config) as bus:
            yield SimClient(bus, world, timeout_s)


def _check_seconds(option: str, given_s: float, least_s: float) -> None:
    if not least_s <= given_s <= MAX_TIMEOUT_S:
        raise ValueError(
            f"{option} {given_s:g} is out of range; use {least_s:g} to {MAX_TIMEOUT_S:g} seconds"
        )
