"""`connect`, `launch` and `servers`: simulations on a server that runs, or on one of our own."""

import atexit
import os
import time
import weakref
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.api.api_errors import NotFound, Unreachable, Unsupported
from zensim.api.call_deadline import limit, limited
from zensim.api.local_deployment import LaunchAgentsConfig, LaunchConfig
from zensim.api.program_keeper import ProgramKeeper
from zensim.api.server_access import ServerAccess
from zensim.api.sim import Sim
from zensim.api.simulation import read_world_keywords
from zensim.api.world_access import api_errors
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError, ForkedProcess, JoinRefused, NoSession
from zensim.proto.bus.bus_session import Bus, open_bus_with_retry
from zensim.proto.bus.zenoh_runtime import require_threads
from zensim.proto.endpoints import DEFAULT_ENDPOINT, check_endpoint, with_free_port
from zensim.proto.join_tokens import TOKEN_VARIABLE, hide_token, is_join_address, read_join_address
from zensim.proto.messages.telemetry_messages import Info
from zensim.proto.settings.deployment_settings import ProgramSettings
from zensim.proto.settings.lockstep_settings import PATIENT, LockstepSettings
from zensim.proto.settings.network_settings import NetworkSettings
from zensim.proto.settings.pace_settings import PaceSettings
from zensim.proto.settings.ros_choice import HIDDEN, NAMESPACED
from zensim.proto.settings.server_settings import ServerSettings, WorldKeywords
from zensim.proto.settings.start_settings import StartSettings
from zensim.spawner.client.service_client import ServiceClient

if TYPE_CHECKING:
    from typing_extensions import Unpack

CONNECT_VARIABLE = "ZENSIM_CONNECT"
DEFAULT_WORLD = "default"
ANY_PORT = "tcp/127.0.0.1:0"
START_TIMEOUT_S = 30.0
POLL_S = 0.01
REFUSED_S = 0.2
"""Time in which a server that starts at this moment is still found."""
LIST_TIMEOUT_S, CALL_TIMEOUT_S = 1.0, 2.0
_OPEN: "weakref.WeakSet[Sim]" = weakref.WeakSet()
"""Simulations that are closed at the exit of this process."""


class ServerEntry(msgspec.Struct, frozen=True):
    """A server that replies."""

    world: str
    endpoint: str
    info: Info


def connect(
    endpoint: str | None = None,
    world: str | None = None,
    *,
    token: str | None = None,
    timeout_s: float = 5.0,
) -> Sim:
    """Connect to a running server.

    Args:
        endpoint: As `tcp/127.0.0.1:7447`; else `ZENSIM_CONNECT`, else the default on this host.
        world: Name of the world; the only one there is if it is not given.
        token: Join token of a secured server, or `@FILE` with one; else `ZENSIM_TOKEN`.
        timeout_s: Wall time.

    Raises:
        Unreachable: No server replies there.
        NotFound: There is no such world.
        Unsupported: This process was forked after a session was opened.
    """
    where, source = _choose_endpoint(token or endpoint)
    deadline = time.monotonic() + timeout_s
    with ExitStack() as stack, limited(timeout_s):
        bus = stack.enter_context(_open(where, source, timeout_s))
        name = world or _find_world(bus, deadline)
        if name not in (there := bus.list_worlds(limit(LIST_TIMEOUT_S))):
            raise NotFound(
                f"no world '{name}' at {bus.endpoint}",
                hint=f"there are {', '.join(there)}" if there else "start one with 'zensim serve'",
            )
        sim = Sim(ServerAccess(bus, name))
        # The simulation closes it.
        stack.pop_all()
    return _register(sim)


def launch(
    world: str | Path = "empty",
    *,
    rtf: float | None = None,
    agents: int = 1,
    sensors: int | None = None,
    timeout_s: float = START_TIMEOUT_S,
    **options: "Unpack[WorldKeywords]",
) -> Sim:
    """Start a server of our own, paused, which ends with the simulation or with this process.

    Args:
        world: Name of a world, or an SDF file.
        rtf: Let time advance by itself at this real-time factor; 0 = as fast as possible.
        agents: Pools that drive the robots; 0 = none.
        sensors: Processes that measure lidars and cameras; None = one when a robot needs it.
        timeout_s: Wall time of the start.
        options: See `WorldKeywords`; `engine` is PyBullet, where that is installed, unless it is
            given.

    Raises:
        Error: A program ended, took too long (Timeout), or see `connect` (Unsupported).
    """
    waiting = PATIENT if rtf is None else LockstepSettings()
    start = StartSettings(paused=rtf is None)
    usual = ServerSettings(start=start, pace=PaceSettings(rtf=rtf), lockstep=waiting)
    config = LaunchConfig(
        server=read_world_keywords(world, options, usual),
        network=NetworkSettings(listen=with_free_port(ANY_PORT)),
        agents=LaunchAgentsConfig(pools=agents),
        programs=ProgramSettings(sensors=sensors),
        ros_choice=HIDDEN,
        tf_choice=NAMESPACED,
    )
    return launch_configured(config, timeout_s)


def launch_configured(config: LaunchConfig, timeout_s: float = START_TIMEOUT_S) -> Sim:
    """Start the programs of a configuration; see `launch`.

    Raises:
        Error: A program ended at its start.
        Timeout: The server did not start in time.
    """
    return _register(_start(config, timeout_s))


def _start(config: LaunchConfig, timeout_s: float) -> Sim:
    with ExitStack() as stack, limited(timeout_s):
        with _fork_errors():
            require_threads()
        keeper = ProgramKeeper(config, timeout_s)
        stack.callback(keeper.close)
        bus = keeper.connect()
        stack.callback(bus.close)
        access = ServerAccess(
            bus,
            config.network.world_name,
            watch=keeper.check,
            on_close=keeper.close,
            starts_sensors=config.programs.sensors != 0,
        )
        sim = Sim(access)
        # The simulation closes all.
        stack.pop_all()
    return sim


def servers(endpoint: str | None = None, *, timeout_s: float = 2.0) -> tuple[ServerEntry, ...]:
    """List the servers that are reachable at an endpoint.

    Args:
        endpoint: See `connect`.
        timeout_s: Wall time.
    """
    where, source = _choose_endpoint(endpoint)
    with limited(timeout_s):
        try:
            bus = _open(where, source, timeout_s)
        except Unreachable:
            return ()
        with bus, api_errors():
            return tuple(
                ServerEntry(
                    name, bus.endpoint, ServiceClient(bus, name, limit(CALL_TIMEOUT_S)).info()
                )
                for name in bus.list_worlds(limit(LIST_TIMEOUT_S))
            )


def _choose_endpoint(endpoint: str | None) -> tuple[str, str]:
    """Choose an endpoint; say where it comes from."""
    with api_errors():
        if endpoint is not None:
            return _check_address(endpoint), "given"
        for name in (TOKEN_VARIABLE, CONNECT_VARIABLE):
            if variable := os.environ.get(name):
                return _check_address(variable), name
    return DEFAULT_ENDPOINT, "default"


def _check_address(address: str) -> str:
    if is_join_address(address):
        read_join_address(address)
        return address
    return check_endpoint(address)


@contextmanager
def _fork_errors() -> Iterator[None]:
    """Convert the error of a process that was forked too late."""
    try:
        yield
    except ForkedProcess as error:
        message, _, hint = str(error).partition("; ")
        raise Unsupported(message, slug="forked", hint=hint) from error


def _open(where: str, source: str, timeout_s: float) -> Bus:
    config, deadline = BusConfig(connect=(where,)), time.monotonic() + timeout_s
    try:
        with _fork_errors():
            try:
                return open_bus_with_retry(config, min(timeout_s, REFUSED_S))
            except NoSession:
                # A server that is far away, or busy: nothing else is known before the timeout.
                return open_bus_with_retry(config, max(0.0, deadline - time.monotonic()))
    except JoinRefused as error:
        raise Unreachable(str(error), slug="join_refused") from error
    except BusError as error:
        raise Unreachable(f"no server at {hide_token(where)} ({source})") from error


def _find_world(bus: Bus, deadline: float) -> str:
    while True:
        names = bus.list_worlds(limit(LIST_TIMEOUT_S))
        if len(names) == 1 or DEFAULT_WORLD in names:
            return DEFAULT_WORLD if DEFAULT_WORLD in names else names[0]
        if names:
            raise NotFound(f"there are {len(names)} worlds", hint=f"give one of {', '.join(names)}")
        if time.monotonic() > deadline:
            raise Unreachable(f"no server has a world at {bus.endpoint}")
        time.sleep(POLL_S)


def _register(sim: Sim) -> Sim:
    if not _OPEN:
        atexit.register(_close_all)
    _OPEN.add(sim)
    return sim


def _close_all() -> None:
    for sim in list(_OPEN):
        sim.close()
