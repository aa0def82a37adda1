"""One real server for all tests of commands, empty and paused before each."""

from collections.abc import Iterator

import pytest

from proto.services import ResetScope, State
from tests.integration.processes import Server, serving


@pytest.fixture(scope="session")
def running_server() -> Iterator[Server]:
    with serving("--paused") as server:
        yield server


@pytest.fixture
def server(running_server: Server) -> Server:
    if running_server.client.simulation_state() != State.PAUSED:
        running_server.client.set_simulation_state(State.PAUSED)
    running_server.client.reset(ResetScope.ALL)
    return running_server
