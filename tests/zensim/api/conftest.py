"""A server of its own for the tests of the API."""

from collections.abc import Iterator

import pytest

import zensim


@pytest.fixture(scope="module")
def server() -> Iterator[zensim.Sim]:
    """A paused server with one pool."""
    with zensim.launch(timeout_s=120.0) as sim:
        yield sim


@pytest.fixture
def sim(server: zensim.Sim) -> zensim.Sim:
    """The server, reset."""
    server.pause()
    server.reset()
    return server
