"""Replies while a server restores its journal: its state at once, all else when it serves."""

from __future__ import annotations

import sys
from collections import deque
from importlib.metadata import version
from threading import Event, Thread
from typing import TYPE_CHECKING, Final

from zensim.proto import keys
from zensim.proto.messages.simulation_messages import (
    GetSimulationStateResponse,
    SimulationState,
    State,
)
from zensim.proto.messages.telemetry_messages import PROTOCOL, Info
from zensim.proto.service_catalog import GET_SIMULATION_STATE, INFO
from zensim.sim_server.runtime.loop_channels import declare_services
from zensim.sim_server.runtime.response_encoding import encode_response

if TYPE_CHECKING:
    import msgspec

    from zensim.proto.network_protocols import ServerNetwork, ServiceCall
    from zensim.sim_server.journal.restore_progress import RestoreProgress

POLL_S: Final = 0.01
SWITCH_INTERVAL_S: Final = 0.001
"""Longest that the thread waits for the interpreter, a few times for a reply; usually 5 ms."""
MAX_HELD: Final = 4096
"""Requests that wait for the end of a restore; more end without a value."""
MAX_HELD_BYTES: Final = 64 << 20
"""Bytes of the payloads of requests that wait."""


class RestoreReplies:
    """Replies to `info` and `get_simulation_state` in a thread, and holds other requests."""

    def __init__(
        self, network: ServerNetwork, world: str, progress: RestoreProgress, *, is_secured: bool
    ) -> None:
        """Declare the services of a world; `start` replies."""
        self._world = world
        self._progress = progress
        self._services = declare_services(network, world, is_secured=is_secured)
        self._version = version("zensim")
        self._held: deque[ServiceCall] = deque()
        self._held_bytes = 0
        self._is_over = Event()
        self._usual_interval_s = sys.getswitchinterval()
        self._thread = Thread(target=self._run, name="restore-replies", daemon=True)

    def start(self) -> None:
        """Start the thread that replies."""
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        self._thread.start()

    def close(self) -> None:
        """End the thread; the loop takes the requests from now on."""
        sys.setswitchinterval(self._usual_interval_s)
        self._is_over.set()
        if self._thread.is_alive():
            self._thread.join()

    def take(self) -> list[ServiceCall]:
        """See `ServiceCallSource`; call it after `close`."""
        held, self._held = list(self._held), deque()
        return [*held, *self._take_new()]

    def _take_new(self) -> list[ServiceCall]:
        return [call for service in self._services for call in service.take()]

    def _run(self) -> None:
        while not self._is_over.wait(POLL_S):
            self.poll()

    def poll(self) -> None:
        """Reply to the requests received, or hold them."""
        for call in self._take_new():
            if (response := self._make_response(call.name)) is not None:
                encoded = encode_response(call, response)
                key = keys.service(self._world, call.name, call.user)
                call.reply(encoded.payload, encoded.encoding, key)
            elif len(self._held) < MAX_HELD and self._held_bytes + call.size <= MAX_HELD_BYTES:
                self._held.append(call)
                self._held_bytes += call.size
            else:
                call.drop()

    def _make_response(self, service: str) -> msgspec.Struct | None:
        if service == GET_SIMULATION_STATE.name:
            return GetSimulationStateResponse(state=SimulationState(State.LOADING_WORLD))
        if service != INFO.name:
            return None
        return Info(
            world=self._world,
            version=self._version,
            protocol=PROTOCOL,
            state="restoring",
            restored=self._progress.done,
            to_restore=self._progress.total,
        )
