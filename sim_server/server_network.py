"""The network of a server, which is there before its world is restored."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import open_bus_with_retry
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.service_catalog import INFO
from zensim.sim_server.journal.restore_progress import RestoreProgress, count_restorable
from zensim.sim_server.runtime.restore_replies import RestoreReplies
from zensim.sim_server.runtime.time_slice import request_short_time_slice
from zensim.sim_server.server_config import ServerConfig, WorldAlreadyServed

if TYPE_CHECKING:
    from contextlib import ExitStack

    from zensim.proto.bus.bus_session import Bus

INFO_TIMEOUT_S = 2.0


class RestoringNetwork:
    """The network of a server, and replies while its journal is read and restored.

    A large world takes seconds, and to read the journal of 10,000 entities a fifth of one.
    """

    def __init__(self, config: ServerConfig, cleanup: ExitStack) -> None:
        self.progress = RestoreProgress(total=count_restorable(config.journal))
        self.replies: RestoreReplies | None = None
        self._config = config
        self._cleanup = cleanup
        self._bus: Bus | None = None

    def open(self, *, is_restoring: bool = True) -> Bus:
        """Open it if it is not open; reply if there is something to restore."""
        config, cleanup = self._config, self._cleanup
        if self._bus is None:
            self._bus = _open_network(config, cleanup)
        if is_restoring and self.replies is None:
            is_secured = bool(config.secure_folder)
            replies = RestoreReplies(
                self._bus, config.world_name, self.progress, is_secured=is_secured
            )
            replies.start()
            cleanup.callback(replies.close)
            self.replies = replies
        return self._bus


def _open_network(config: ServerConfig, cleanup: ExitStack) -> Bus:
    bus = cleanup.enter_context(open_bus_with_retry(config.bus or BusConfig(), config.wait_s))
    # A secured server has a router of its own.
    if not config.secure_folder and _has_server(bus, config.world_name):
        raise WorldAlreadyServed(
            f"world '{config.world_name}' already has a server at {bus.endpoint}; "
            "stop it, or use `world_name` with another"
        )
    bus.prepare_reply_threads(request_short_time_slice)
    return bus


def _has_server(bus: Bus, world: str) -> bool:
    """Whether another server serves the world; our own new router has no other server."""
    if bus.config.mode == "router":
        return False
    try:
        bus.call(INFO, InfoRequest(), world=world, timeout_s=INFO_TIMEOUT_S)
    except NoServer:
        return bool(bus.list_tokens(keys.alive_server(world)))
    except TimeoutError:
        return True
    return True
