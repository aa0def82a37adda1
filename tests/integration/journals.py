"""Servers with a journal, restarted in one folder."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from tests.integration.processes import START_S, Server, connected, running
from zensim.spawner.client.sim_client import SimClient

if TYPE_CHECKING:
    from subprocess import CompletedProcess


@contextmanager
def serving_with_journal(
    folder: Path, endpoint: str, *arguments: str, prefix: Sequence[str] = ()
) -> Iterator[Server]:
    """Run a server with a journal until the block ends."""
    command = ("serve", "--listen", endpoint, "--journal", str(folder), *arguments)
    with running(*command, prefix=prefix) as process, connected(endpoint, process) as bus:
        client = SimClient(bus, timeout_s=START_S)
        client.wait_for_server(START_S)
        yield Server(process, endpoint, bus, client)


def kill_hard(server: Server) -> None:
    """Kill a server with SIGKILL."""
    server.process.kill()
    server.process.wait()


def last_line(done: "CompletedProcess[str]") -> str:
    """Take the last line on standard error; fail when it is a traceback."""
    assert "Traceback" not in done.stderr
    return done.stderr.strip().splitlines()[-1]
