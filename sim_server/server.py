"""Start of a server: check its configuration, reply while a world is restored, then serve it.

What a server consists of is imported late: that takes most of a start, and a server whose journal
has entities replies before it.
"""

from __future__ import annotations

import gc
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.json_logs import CONTEXT
from zensim.proto.process_memory import limit_malloc_arenas
from zensim.proto.program_status import SERVER_TURN_S, make_program_status
from zensim.proto.rosout import LogCollector
from zensim.sim_server.server_config import ServerConfig, validate_config
from zensim.sim_server.server_extra import server_extra
from zensim.sim_server.server_network import RestoringNetwork

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zensim.proto.bus.bus_session import Bus
    from zensim.proto.stop_signal import StopFlag


def run_server(
    config: ServerConfig, stop: StopFlag, on_ready: Callable[[Bus, ServerConfig], None]
) -> None:
    """Run a server until a signal stops it; it finishes the requests that it has accepted.

    Raises:
        ConfigError: The configuration is not valid.
        WorldAlreadyServed: Another server has this world.
        BusError: The network is not available.
        JournalError: The journal cannot be used.
        MissingServerExtra: The packages of the server extra are not installed.
    """
    config = msgspec.structs.replace(validate_config(config), requested=config)
    limit_malloc_arenas()
    status = make_program_status(config.world_name, SERVER_TURN_S)
    CONTEXT.world = config.world_name
    stop.on_stop = status.drain
    with ExitStack() as cleanup:
        collector = LogCollector()
        if config.ros.domain is not None:
            collector.start()
        cleanup.callback(collector.stop)
        cleanup.enter_context(_no_garbage_collection())
        network = RestoringNetwork(config, cleanup)
        # A process that tests entities is a fork of this one, which must have no other threads.
        if network.progress.total:
            network.open()
        import_served_world()
        from zensim.sim_server.served_world import ServerHooks, serve_world

        hooks = ServerHooks(stop, on_ready, status, network, collector)
        serve_world(config, hooks, cleanup)


def import_served_world() -> None:
    """Import what a server consists of.

    Raises:
        MissingServerExtra: The packages of the server extra are not installed.
    """
    with server_extra():
        import zensim.sim_server.served_world  # noqa: F401


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Disable garbage collection: the objects of a start stay, and it takes a fifth of its time."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
