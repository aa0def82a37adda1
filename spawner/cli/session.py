"""What every command of the operator shares: the connection, the exit, the output."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer
from rich.console import Console

from proto.bus import DEFAULT_ENDPOINT, BusConfig, open_bus
from proto.exits import one_line_failures
from spawner.client import SimClient

Connect = Annotated[
    str, typer.Option("--connect", help="Router or server to join.", envvar="ZENSIM_CONNECT")
]
WorldName = Annotated[
    str, typer.Option("--world-name", help="World on the network.", envvar="ZENSIM_WORLD")
]
Timeout = Annotated[float, typer.Option("--timeout", help="Seconds to wait for an answer.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON on standard output.")]

progress_console = Console(stderr=True)
"""People's side: progress and notes go to standard error."""
data_console = Console(soft_wrap=True)
"""Programs' side: data goes to standard output."""


@contextmanager
def client_for(
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
    with one_line_failures(command):
        endpoint = connect or DEFAULT_ENDPOINT
        config = BusConfig(connect=(endpoint,), open_timeout_s=max(wait_s, 0.1))
        with open_bus(config) as bus:
            yield SimClient(bus, world, timeout_s)
