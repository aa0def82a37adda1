"""A server with a journal that is killed and restarted, and clients that retry."""

import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from tests.integration.processes import START_S, connected, free_endpoint, kill, running
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus
from zensim.proto.service_catalog import Request, Response, Service
from zensim.spawner.client.sim_client import SimClient

if TYPE_CHECKING:
    import subprocess

PATIENCE_S = 60.0
ANSWER_S = 2.0
POLL_S = 0.01


def ask(
    bus: Bus, service: Service[Request, Response], request: Request, request_id: str
) -> Response:
    """Call a service until it replies, always with the same request id.

    Raises:
        ServiceError: The server refused.
        TimeoutError: No reply within the timeout.
    """
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        with suppress(NoServer, TimeoutError):
            return bus.call(
                service, request, world="default", timeout_s=ANSWER_S, request_id=request_id
            )
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"{service.name} was not answered within {PATIENCE_S:g} s")
        time.sleep(POLL_S)


class RestartableServer:
    """A server with a journal, connected to a separate router."""

    def __init__(self, endpoint: str, folder: Path) -> None:
        self._arguments = ("serve", "--connect", endpoint, "--journal", str(folder))
        self._stack = ExitStack()
        self.process = self._start()

    def kill(self) -> None:
        """Kill the server."""
        kill(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._stack.close()

    def restart(self) -> None:
        """Restart the server."""
        self.process = self._start()

    def close(self) -> None:
        """End the server."""
        self._stack.close()

    def _start(self) -> "subprocess.Popen[str]":
        return self._stack.enter_context(running(*self._arguments))


@contextmanager
def run_restartable_server() -> Iterator[tuple[RestartableServer, Bus]]:
    """Run a router and a server that may be killed; yield the server and a session."""
    endpoint = free_endpoint()
    with (
        tempfile.TemporaryDirectory() as folder,
        running("router", "--listen", endpoint) as router,
        connected(endpoint, router) as bus,
    ):
        server = RestartableServer(endpoint, Path(folder))
        try:
            SimClient(bus).wait_for_server(START_S)
            yield server, bus
        finally:
            server.close()
