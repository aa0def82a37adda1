"""The router of a secured server: a process of its own, since users change by its restart."""

import json
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from typing import TYPE_CHECKING, Final

import msgspec

from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError, EndpointTaken
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.bus.zenoh_runtime import log_handshakes
from zensim.proto.child_process import STDOUT
from zensim.proto.endpoints import is_endpoint_taken, to_client_endpoint
from zensim.proto.printable_text import print_lines
from zensim.proto.stop_signal import StopFlag
from zensim.proto.supervisor import PREPARED_START_MODULE, ProgramDied, Supervisor
from zensim.sim_server.security.join_log import JoinLog
from zensim.sim_server.security.secure_folder import SecureFolder, open_secure_folder
from zensim.sim_server.security.user_sessions import SessionChange

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import LivelinessToken
    from zensim.proto.child_process import Process

LOG = logging.getLogger(__name__)
POLL_S: Final = 0.05
WATCH_PERIOD_S: Final = 0.2
REOPEN_TIMEOUT_S: Final = 10.0
"""Time to open a port again, which may be in use for a moment after its router closed."""
JSON_ENCODING: Final = "application/json"
VERB: Final = "router"
"""Verb of the program that `secured_router` starts."""


def run_router_process(world: str) -> None:
    """Be the router of a secured server on this host, until a signal; print where it listens.

    Raises:
        MissingFolder: There is no such server.
        FolderInUse: See there.
        BusError: The router cannot listen.
    """
    folder = open_secure_folder(world)
    endpoint = folder.settings.endpoint
    handshakes = HandshakeReader()

    def announce() -> None:
        print_lines(json.dumps({"endpoints": [endpoint]}))
        handshakes.start()

    run_secured_router(folder, endpoint, StopFlag(), announce, handshakes.take)


def run_secured_router(
    folder: SecureFolder,
    endpoint: str,
    should_stop: Callable[[], bool],
    announce: Callable[[], None],
    take_refusals: Callable[[], list[SessionChange]],
) -> None:
    """Route until `should_stop`; a change of the users restarts the router and ends all links.

    Args:
        folder: Of the users that it admits.
        endpoint: To listen on.
        should_stop: Asked every `POLL_S`.
        announce: Called once, when it listens.
        take_refusals: Takes the joins that it refused.

    Raises:
        BusError: The router cannot listen.
        FolderInUse: See there.
    """
    is_announced = False
    with folder.routing():
        while not should_stop():
            folder.forget_admitted()
            admitted = folder.list_active()
            with _reopen(folder.make_router_config(endpoint), is_first=not is_announced) as bus:
                if not is_announced:
                    announce()
                    is_announced = True
                reports = RouterReports(bus, folder.settings.world)
                servers = bus.watch_tokens(keys.alive_server(folder.settings.world))
                while not should_stop() and folder.list_active() == admitted:
                    reports.poll(take_refusals())
                    if any(is_alive for _, is_alive in servers.take()):
                        folder.note_admitted(admitted)
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


class HandshakeReader:
    """Takes over standard output, to which Zenoh writes its log, and reads it in a thread."""

    def __init__(self) -> None:
        self._refused: SimpleQueue[SessionChange] = SimpleQueue()

    def start(self) -> None:
        """Begin; nothing else can be printed from now on."""
        reading, writing = os.pipe()
        os.dup2(writing, STDOUT)
        os.close(writing)
        log_handshakes()
        threading.Thread(target=self._run, args=(reading,), name="log", daemon=True).start()

    def take(self) -> list[SessionChange]:
        """Take the joins that were refused since the last call."""
        return [self._refused.get() for _ in range(self._refused.qsize())]

    def _run(self, reading: int) -> None:
        log = JoinLog()
        with os.fdopen(reading, errors="replace") as lines:
            for line in lines:
                if (refused := log.read(line)) is not None:
                    self._refused.put(refused)
                elif "RUST_LOG" in os.environ:
                    print_lines(line, err=True, nl=False)


class RouterReports:
    """What a router says to its server: a liveliness token for each link, and refused joins."""

    def __init__(self, bus: Bus, world: str) -> None:
        self._bus = bus
        self._world = world
        self._links = bus.watch_links()
        self._refusals = bus.advertise(keys.router_refusals(world), JSON_ENCODING)
        self._tokens: dict[str, LivelinessToken] = {}
        """Tokens by key."""

    def poll(self, refused: list[SessionChange]) -> None:
        """Declare the tokens of new links, undeclare those of closed ones, publish refusals."""
        for one in refused:
            self._refusals.send(msgspec.json.encode(one))
        for session, address, is_open in self._links.take():
            key = keys.router_link(self._world, session, address)
            if is_open and key not in self._tokens:
                self._tokens[key] = self._bus.token(key)
            elif not is_open and (token := self._tokens.pop(key, None)) is not None:
                token.close()


class StartedRouter:
    """A router that starts, while its server does other work."""

    def __init__(
        self, folder: SecureFolder, process: "Process | None", on_listening: Callable[[], None]
    ) -> None:
        self._folder = folder
        self._output = process.stdout if process is not None else None
        self._on_listening = on_listening

    def wait(self) -> BusConfig:
        """Wait until it listens; return the configuration of the server's session.

        Raises:
            ProgramDied: It ended at its start.
        """
        line = self._output.readline() if self._output is not None else b""
        if not line or "endpoints" not in json.loads(line):
            raise ProgramDied("the router of the secured server ended at its start")
        self._on_listening()
        return self._folder.make_server_config(to_client_endpoint(self._folder.settings.endpoint))


@contextmanager
def secured_router(folder: SecureFolder, command: str) -> Iterator[StartedRouter]:
    """Run the router of a folder as a process.

    Args:
        folder: Its settings say where the router listens.
        command: That a log line names when the router is started again.

    Raises:
        EndpointTaken: Another program listens there.
    """
    settings = folder.settings
    if is_endpoint_taken(settings.endpoint):
        raise EndpointTaken(
            f"another process listens at {settings.endpoint}; stop it, or use `listen` with "
            "another port"
        )
    supervisor = Supervisor(lambda program, status: _log_restart(command, program.name, status))
    is_over = threading.Event()
    keeper = threading.Thread(
        target=_keep, args=(supervisor, is_over), name="secured router", daemon=True
    )
    try:
        program = supervisor.start(
            "router",
            (VERB, json.dumps(settings.world)),
            is_restarted=True,
            is_essential=False,
            module=PREPARED_START_MODULE,
        )
        yield StartedRouter(folder, program.process, keeper.start)
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
