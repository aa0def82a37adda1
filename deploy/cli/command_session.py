"""What all client commands share: name completion, the client, the consoles."""

import logging
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Annotated, Any, TypeVar

import msgspec
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure, list_expected_failures
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.names import check_name
from zensim.proto.near_names import name_choices
from zensim.proto.options.command_options import ClientOptions, ConnectionOptions
from zensim.proto.printable_text import print_lines, printable_lines
from zensim.proto.topic_discovery import list_topics
from zensim.proto.verbosity import configure_logging
from zensim.spawner.client.sim_client import SimClient

Item = TypeVar("Item")
ABSENT_ENTITY = re.compile(r"entity '(?P<name>[^']+)' does not exist")
LOG = logging.getLogger(__name__)

COMPLETION_TIMEOUT_S = 0.3
"""Limit on the delay of the shell; after it there are no suggestions."""
OPEN_TIMEOUT_S = 2.0
MIN_TIMEOUT_S, MAX_TIMEOUT_S = 0.01, 86_400.0
MIN_OPEN_TIMEOUT_S = 0.1
MAX_LINE_WIDTH = 10_000
"""Width [characters] of a table that is written to a file or a pipe."""


def complete_entity_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Find the entities whose names start with a text; none without a reply in time."""
    given = ctx.params.get("names") or ()
    names = _query(ctx, SimClient.entities)
    return [name for name in names if name.startswith(incomplete) and name not in given]


def complete_world_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Find the worlds of the server whose names start with a text."""
    worlds = _query(ctx, SimClient.available_worlds)
    uris = [world.world_resource.uri for world in worlds]
    return [uri for uri in uris if uri.startswith(incomplete)]


def complete_robots(ctx: typer.Context, incomplete: str) -> list[str]:
    """Find the namespaces of the robots that start with a text."""

    def find(client: SimClient) -> list[str]:
        models = client.models()
        return [
            one.namespace
            for one in models.entities
            if one.namespace and models.models[one.model].drive is not None
        ]

    return [name for name in _query(ctx, find) if name.startswith(incomplete)]


def complete_topics(ctx: typer.Context, incomplete: str) -> list[str]:
    """Find the topics that start with a text."""

    def find(client: SimClient) -> list[str]:
        return [one.key for one in list_topics(client.bus, client.world, client.models())]

    return [key for key in _query(ctx, find) if key.startswith(incomplete)]


def _query(ctx: typer.Context, call: Callable[[SimClient], Sequence[Item]]) -> Sequence[Item]:
    endpoint = ctx.params.get("connect") or DEFAULT_ENDPOINT
    world = ctx.params.get("world_name") or "default"
    try:
        with open_bus(BusConfig(connect=(endpoint,), open_timeout_s=COMPLETION_TIMEOUT_S)) as bus:
            return call(SimClient(bus, world, COMPLETION_TIMEOUT_S))
    except list_expected_failures():
        return ()


EntityName = Annotated[
    str,
    typer.Argument(
        metavar="NAME", help="Name of the entity.", autocompletion=complete_entity_names
    ),
]


class PrintableConsole(Console):
    """A console that prints no control characters of texts."""

    def render_str(self, text: str, **options: Any) -> Text:  # noqa: ANN401  as rich does
        """Convert a text, such as the cell of a table."""
        return super().render_str(printable_lines(text), **options)

    def on_broken_pipe(self) -> None:
        """End as `exit_on_failure` does: a reader that has read enough is not a failure."""
        raise BrokenPipeError


progress_console = PrintableConsole(stderr=True)
"""Console of progress bars and notes, which must not mix with data."""
data_console = PrintableConsole(soft_wrap=True, markup=False)


def print_json(value: object) -> None:
    """Print a value as one line of JSON to standard output."""
    print_lines(msgspec.json.encode(value).decode())


def print_table(table: Table) -> None:
    """Print a table to standard output; not wrapped unless that is a terminal."""
    is_bounded = data_console.is_terminal
    console = (
        data_console
        if is_bounded
        else PrintableConsole(soft_wrap=True, markup=False, width=MAX_LINE_WIDTH)
    )
    console.print(table)


@contextmanager
def open_client(
    command: str, options: ConnectionOptions, *, wait_s: float = OPEN_TIMEOUT_S
) -> Iterator[SimClient]:
    """Open a client; an expected failure inside ends the command with one line and a status.

    Args:
        command: Verb that starts the error line.
        options: An empty endpoint stands for the default endpoint.
        wait_s: Timeout of the connection [s].
    """
    with exit_on_failure(command):
        check_name(options.world_name, "world name")
        timeout_s = options.timeout if isinstance(options, ClientOptions) else 10.0
        _check_seconds("--timeout", timeout_s, MIN_TIMEOUT_S)
        _check_seconds("--wait", wait_s, 0.0)
        endpoint = options.connect or DEFAULT_ENDPOINT
        config = BusConfig(connect=(endpoint,), open_timeout_s=max(wait_s, MIN_OPEN_TIMEOUT_S))
        configure_logging()
        with open_bus(config) as bus:
            LOG.info("connected to %s, world=%s", bus.endpoint, options.world_name)
            client = SimClient(bus, options.world_name, timeout_s)
            try:
                yield client
            except ServiceError as error:
                name_similar_entities(client, error)
                raise


def name_similar_entities(client: SimClient, error: ServiceError) -> None:
    """Name the entities that there are in a refusal because there is none of this name."""
    absent = ABSENT_ENTITY.search(error.message)
    if absent is None or error.code != ResultCode.NOT_FOUND:
        return
    with suppress(*list_expected_failures()):
        choices = name_choices(absent["name"], client.entities())
        advice = f"there are {choices}" if choices else "there are none"
        error.message = f"{error.message[: absent.end()]}; {advice}"


def _check_seconds(option: str, given_s: float, least_s: float) -> None:
    if not least_s <= given_s <= MAX_TIMEOUT_S:
        raise ValueError(
            f"{option} must be {least_s:g} to {MAX_TIMEOUT_S:g} seconds, got {given_s:g}"
        )
