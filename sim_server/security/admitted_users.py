"""Users of a secured server as its loop asks for them, and the addresses of their sessions."""

import time
from typing import Final

from zensim.proto import keys
from zensim.proto.bus import Bus
from zensim.proto.security.roles import User
from zensim.sim_server.security.secure_folder import SecureFolder

ADDRESS_TIMEOUT_S: Final = 1.0
KEPT_S: Final = 5.0
"""A session that connects again may have another address."""
MAX_KEPT: Final = 1000


class AdmittedUsers:
    """The users of a folder, whose sessions are linked to the router of the server."""

    def __init__(self, folder: SecureFolder, bus: Bus, world: str) -> None:
        self._folder = folder
        self._bus = bus
        self._world = world
        self._addresses: dict[str, tuple[str, float]] = {}
        """Address and wall time [s] of its query, by session."""

    def find_user(self, name: str) -> User | None:
        """Find a user that is admitted now."""
        return self._folder.find_user(name)

    def find_address(self, session: str) -> str:
        """Find the address of a session, as the router has it; empty if it is not linked."""
        now_s = time.monotonic()
        address, asked_s = self._addresses.get(session, ("", -KEPT_S))
        if now_s - asked_s < KEPT_S:
            return address
        if len(self._addresses) >= MAX_KEPT:
            self._addresses.clear()
        replies = self._bus.get(keys.router_peer(self._world, session), ADDRESS_TIMEOUT_S)
        address = replies[0].payload.decode(errors="replace") if replies else ""
        self._addresses[session] = address, now_s
        return address
