"""Programs that are terminated

SIGTERM, one after another, to an agent that waits for its robot, to one that drives, to a page with
a client, and to a server with a journal and a driving robot: each must exit with status 0,
undeclare its tokens, and leave no process.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import psutil

from benchmarks.figures import Figure, Limit
from tests.chaos.recovery import ROBOTS_WHEN_SHORT, run_driven_fleet
from tests.integration.page_client import connect_page, encode_camera
from tests.integration.processes import (
    END_S,
    START_S,
    children,
    connected,
    eventually,
    free_endpoint,
    running,
)
from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus

if TYPE_CHECKING:
    import subprocess

ROUNDS, ROUNDS_WHEN_SHORT = 10, 1
LIMITS_S = {
    "agent that waits for its robot": 0.5,
    "agent that drives": 0.5,
    "page that is looked at": 1.0,
    "server": 2.0,
}


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Terminate all programs, round by round."""
    rounds = [_round() for _ in range(ROUNDS_WHEN_SHORT if is_short else ROUNDS)]
    for what, limit_s in LIMITS_S.items():
        yield Figure(
            what=f"{what}: SIGTERM to the end",
            unit="s",
            samples=tuple(ends[what][0] for ends in rounds),
            limit=Limit("max", "<=", limit_s, is_timed=True),
        )
    yield Figure(
        what="statuses other than 0, tokens and processes left",
        unit="",
        samples=tuple(float(sum(faults for _, faults in ends.values())) for ends in rounds),
        limit=Limit("max", "<=", 0.0),
    )


def _round() -> dict[str, tuple[float, int]]:
    """End all programs; return the time [s] and the number of faults of each."""
    endpoint = free_endpoint()
    there = ("--connect", endpoint)
    with ExitStack() as stack:
        router = stack.enter_context(running("router", "--listen", endpoint))
        bus = stack.enter_context(connected(endpoint, router))
        folder = stack.enter_context(TemporaryDirectory())
        server = stack.enter_context(running("serve", *there, "--journal", folder))
        found = stack.enter_context(run_driven_fleet(endpoint, ROBOTS_WHEN_SHORT))
        patient = ("agent", "r9", "--name", "patient", "--wait", str(START_S * 3.0))
        waiting = stack.enter_context(running(*patient, *there))
        view = stack.enter_context(running("view", *there, "--port", "0"))
        assert view.stdout is not None
        page = stack.enter_context(connect_page(view.stdout.readline().split()[1]))
        page.send(encode_camera())
        page.recv(timeout=END_S)
        eventually(lambda: "patient" in _agents(bus), START_S, "joining")
        found.drive_s()
        processes = (waiting, found.agents[0], view, server)
        ends = {what: _end(one) for what, one in zip(LIMITS_S, processes, strict=True)}
        took_s, faults = ends["server"]
        ends["server"] = took_s, faults + len(bus.list_tokens(keys.alive_server("*")))
        return ends


def _end(process: "subprocess.Popen[str]") -> tuple[float, int]:
    started = children(process.pid)
    begin_s = time.monotonic()
    process.terminate()
    status = process.wait(END_S)
    took_s = time.monotonic() - begin_s
    eventually(lambda: not any(map(psutil.pid_exists, started)), END_S, "ending")
    return took_s, int(status != 0)


def _agents(bus: Bus) -> list[str]:
    return [keys.parse_agent(key) for key in bus.list_tokens(keys.alive_agents("default"))]
