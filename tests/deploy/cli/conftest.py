"""One real server for all tests of commands, empty and paused before each."""

from collections.abc import Iterator

import pytest

from tests.deploy.cli.commands import run_at
from tests.integration.processes import Server, serving
from zensim.deploy.cli.spawn_commands import app as spawn_app
from zensim.proto.messages.simulation_messages import ResetScope, State


@pytest.fixture(scope="session")
def running_server() -> Iterator[Server]:
    with serving("--paused") as server:
        yield server


@pytest.fixture
def server(running_server: Server) -> Server:
    if running_server.client.simulation_state() in (State.NO_WORLD, State.STOPPED):
        running_server.client.load_world("empty")
    if running_server.client.simulation_state() != State.PAUSED:
        running_server.client.set_simulation_state(State.PAUSED)
    running_server.client.reset(ResetScope.ALL)
    return running_server


@pytest.fixture
def two(server: Server) -> Server:
    """A server with two robots."""
    run_at(server, spawn_app, "spawn", "box_bot", "-n", "r1", "-x", "1", "-Y", "0.5")
    run_at(server, spawn_app, "spawn", "box_bot", "-n", "r2", "-ns", "team/r2", "-y", "-3")
    return server
