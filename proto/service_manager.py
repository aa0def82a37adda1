"""Notifies systemd that a program is ready, alive or ending: one datagram each, no library."""

import os
import socket
from collections.abc import Mapping
from contextlib import suppress
from typing import Final

SOCKET_VARIABLE: Final = "NOTIFY_SOCKET"
WATCHDOG_VARIABLE: Final = "WATCHDOG_USEC"
WATCHDOG_PID_VARIABLE: Final = "WATCHDOG_PID"
PARTS_OF_TIMEOUT: Final = 3
"""Number of notifications of the watchdog within its timeout."""


class ServiceManager:
    """The service manager that started this process, if there is one.

    Attributes:
        watchdog_period_s: Wall time between two notifications; None = there is no watchdog.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        """Read the variables of the service manager."""
        self._address = environment.get(SOCKET_VARIABLE, "")
        self.watchdog_period_s: float | None = None
        timeout = environment.get(WATCHDOG_VARIABLE, "")
        is_ours = environment.get(WATCHDOG_PID_VARIABLE, str(os.getpid())) == str(os.getpid())
        if self._address and timeout.isdecimal() and int(timeout) and is_ours:
            self.watchdog_period_s = int(timeout) * 1e-6 / PARTS_OF_TIMEOUT

    def notify(self, state: str) -> None:
        """Send a state such as `READY=1`; nothing without a service manager."""
        if not self._address:
            return
        # In Linux, an address that begins with @ is of the abstract name space.
        address = self._address.replace("@", "\0", 1) if self._address[0] == "@" else self._address
        kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC
        with suppress(OSError), socket.socket(socket.AF_UNIX, kind) as channel:
            channel.sendto(state.encode(), address)
