"""Joins that a router refuses, read from the log of Zenoh, the only place that has them."""

import re
from collections import deque
from typing import Final

from zensim.sim_server.security.user_sessions import SessionChange

COLOUR: Final = re.compile(r"\x1b\[[0-9;]*m")
CONNECTED: Final = re.compile(r"Accepted TLS connection on \S+: (\S+)\. ")
DECIDED: Final = "zenoh_transport::unicast::establishment::accept"
"""Target of the line that ends each handshake, whatever its outcome."""
REFUSALS: Final = (
    (re.compile(r"UsrPwd extension.*Invalid password"), "wrong password"),
    (re.compile(r"UsrPwd extension.*Invalid user"), "unknown, revoked or expired user"),
    (re.compile(r"invalid peer certificate: (\w+)"), "certificate refused"),
)
MAX_HANDSHAKES: Final = 1000


class JoinLog:
    """Reads the lines of the log one by one."""

    def __init__(self) -> None:
        self._handshakes: deque[str] = deque(maxlen=MAX_HANDSHAKES)
        """Addresses of connections whose outcome is not logged yet, oldest first."""

    def read(self, line: str) -> SessionChange | None:
        """Read a line; return the join that it refuses."""
        text = COLOUR.sub("", line)
        if connected := CONNECTED.search(text):
            self._handshakes.append(f"tls/{connected[1]}")
            return None
        address = self._take_address() if DECIDED in text else ""
        for pattern, reason in REFUSALS:
            if pattern.search(text):
                return SessionChange(action="refused", address=address, reason=reason)
        return None

    def _take_address(self) -> str:
        """Take the address of a handshake: of several, what they have in common."""
        if not self._handshakes:
            return ""
        hosts = {one.rpartition(":")[0] for one in self._handshakes}
        is_only = len(self._handshakes) == 1
        address = self._handshakes.popleft()
        if is_only:
            return address
        return hosts.pop() if len(hosts) == 1 else ""
