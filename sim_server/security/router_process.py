"""The router of a secured server: a process of its own, since users change by its restart."""

import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from zensim.proto import keys
from zensim.proto.bus import Bus, BusConfig, BusError, EndpointTaken, open_bus
from zensim.proto.endpoints import is_endpoint_taken, to_client_endpoint
from zensim.proto.supervisor import ProgramDied, Supervisor
from zensim.sim_server.security.secure_folder import SecureFolder

LOG = logging.getLogger(__name__)
POLL_S: Final = 0.1
WATCH_PERIOD_S: Final = 0.2
REOPEN_TIMEOUT_S: Final = 10.0
"""A port may be in use for a moment after its router closed."""


def run_secured_router(
    folder: SecureFolder,
    endpoint: str,
    should_stop: Callable[[], bool],
    announce: Callable[[], None],
) -> None:
    """Route until `should_stop`; a change of the users restarts the router and ends all links.

    Raises:
        BusError: The router cannot listen.
    """
    is_announced = False
    while not should_stop():
        admitted = folder.list_active()
        with _reopen(folder.make_router_config(endpoint), is_first=not is_announced) as bus:
            queries = bus.serve(keys.router_peer(folder.settings.world, "*"))
            if not is_announced:
                announce()
                is_announced = True
            while not should_stop() and folder.list_active() == admitted:
                for query in queries.take():
                    address = bus.find_peer(keys.last_chunk(query.key))
                    query.reply(address.encode(), "text/plain")
                time.sleep(POLL_S)


@contextmanager
def _reopen(config: BusConfig, *, is_first: bool) -> Iterator[Bus]:
    deadline_s = time.monotonic() + (0.0 if is_first else REOPEN_TIMEOUT_S)
    while True:
        try:
            bus = open_bus(config)
            break
        except BusError:
            if time.monotonic() >= deadline_s:
                raise
            time.sleep(POLL_S)
    with bus:
        yield bus


@contextmanager
def secured_router(folder: SecureFolder, command: str) -> Iterator[BusConfig]:
    """Run the router of a folder as a process; give the configuration of the server's session.

    Args:
        folder: Its settings say where the router listens.
        command: That a log line names when the router is started again.

    Raises:
        EndpointTaken: Another program listens there.
        ProgramDied: The router ended at its start.
    """
    settings = folder.settings
    if is_endpoint_taken(settings.endpoint):
        raise EndpointTaken(
            f"another process listens at {settings.endpoint}; stop it, or use --listen with "
            "another port"
        )
    supervisor = Supervisor(lambda program, status: _log_restart(command, program.name, status))
    is_over = threading.Event()
    keeper = threading.Thread(
        target=_keep, args=(supervisor, is_over), name="secured router", daemon=True
    )
    try:
        words = ("router", "--secured-world", settings.world, "--json")
        program = supervisor.start("router", words, is_restarted=True, is_essential=False)
        assert program.process is not None
        assert program.process.stdout is not None
        line = program.process.stdout.readline()
        if not line or "endpoints" not in json.loads(line):
            raise ProgramDied("the router of the secured server ended at its start")
        keeper.start()
        yield folder.make_server_config(to_client_endpoint(settings.endpoint))
    finally:
        is_over.set()
        if keeper.is_alive():
            keeper.join()
        supervisor.close()


def _keep(supervisor: Supervisor, is_over: threading.Event) -> None:
    while not is_over.wait(WATCH_PERIOD_S):
        supervisor.watch()


def _log_restart(command: str, name: str, status: int) -> None:
    LOG.warning("restarting program=%s of=%s status=%d", name, command, status)
