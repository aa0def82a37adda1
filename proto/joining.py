"""Joining a network that may not be there yet: programs may start in any order."""

import time
from itertools import cycle

import msgspec

from zensim.proto.bus import Bus, BusConfig, Unreachable, open_bus

OPEN_TIMEOUTS_S = (0.25, 0.25, 0.25, 0.25, 2.0)
"""Short, so that a router is found as soon as it is up; now and then long, for a far one."""


def join(config: BusConfig, wait_s: float) -> Bus:
    """Open a session as soon as somebody listens at the endpoints.

    Raises:
        Unreachable: Nobody did within the wait.
        BusError: See `open_bus`.
    """
    deadline_s = time.monotonic() + wait_s
    timeouts = cycle(OPEN_TIMEOUTS_S)
    while True:
        attempt = msgspec.structs.replace(config, open_timeout_s=next(timeouts))
        try:
            return open_bus(attempt)
        except Unreachable:
            if time.monotonic() >= deadline_s:
                raise
