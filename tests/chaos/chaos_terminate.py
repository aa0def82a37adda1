"""A server that is asked to end

SIGTERM to a server with robots that drive: it must end with status 0, take its token with it, and
leave no process behind.
"""

import time
from collections.abc import Iterator

import psutil

from proto import keys
from proto.bus import BusConfig, open_bus
from tests.benchmark.figures import Asked, Figure
from tests.chaos.recovery import ROBOTS_WHEN_SHORT, crew
from tests.integration.processes import children, eventually, free_endpoint, joined, running

ROUNDS, ROUNDS_WHEN_SHORT = 10, 1


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Terminate servers."""
    took, faults = [], []
    for _ in range(ROUNDS_WHEN_SHORT if is_short else ROUNDS):
        seconds, fault = _terminate()
        took.append(seconds)
        faults.append(float(fault))
    yield Figure(
        what="SIGTERM to the end", unit="s", samples=tuple(took), asked=Asked("max", "<=", 2.0)
    )
    yield Figure(
        what="statuses other than 0, tokens and processes left",
        unit="",
        samples=tuple(faults),
        asked=Asked("max", "<=", 0.0),
    )


def _terminate() -> tuple[float, int]:
    endpoint = free_endpoint()
    with (
        running("router", "--listen", endpoint) as router,
        joined(endpoint, router),
        running("serve", "--connect", endpoint) as server,
        crew(endpoint, ROBOTS_WHEN_SHORT) as found,
    ):
        found.drive_s()
        started = children(server.pid)
        begin_s = time.monotonic()
        server.terminate()
        status = server.wait(20.0)
        took_s = time.monotonic() - begin_s
        eventually(lambda: not any(map(psutil.pid_exists, started)), 5.0, "ending")
        with open_bus(BusConfig(connect=(endpoint,))) as bus:
            return took_s, (status != 0) + len(bus.alive(keys.alive_server("*")))
