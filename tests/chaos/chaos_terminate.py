"""Programs that are asked to end

SIGTERM to a server with robots that drive: it must end with status 0, take its token with it, and
leave no process behind. Then SIGTERM to each program as it works or waits, which must end with
status 0 as well: an agent that drives, one that waits for its robot, a server with a journal, and
a page that is looked at.
"""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import psutil

from proto import keys
from proto.bus import Bus, BusConfig, open_bus
from tests.benchmark.figures import Asked, Figure
from tests.chaos.recovery import ROBOTS_WHEN_SHORT, crew
from tests.integration.bare_page import a_camera, bare_page
from tests.integration.journals import kept_in
from tests.integration.processes import (
    END_S,
    START_S,
    children,
    driven,
    eventually,
    free_endpoint,
    joined,
    running,
    serving,
)

if TYPE_CHECKING:
    import subprocess

ROUNDS, ROUNDS_WHEN_SHORT = 10, 1
LIMITS_S = {
    "agent that drives": 0.5,
    "agent that waits for its robot": 0.5,
    "server with a journal": 2.0,
    "page that is looked at": 1.0,
}


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Terminate servers, then each of the programs."""
    rounds = range(ROUNDS_WHEN_SHORT if is_short else ROUNDS)
    yield from _figures("server", 2.0, [_terminate() for _ in rounds])
    ends: dict[str, list[tuple[float, int]]] = {what: [] for what in LIMITS_S}
    for _ in rounds:
        with _programs() as programs:
            for what, process in programs.items():
                ends[what].append(_end(process))
    for what, limit_s in LIMITS_S.items():
        yield from _figures(what, limit_s, ends[what])


def _figures(what: str, limit_s: float, ends: list[tuple[float, int]]) -> Iterator[Figure]:
    yield Figure(
        what=f"{what}: SIGTERM to the end",
        unit="s",
        samples=tuple(took_s for took_s, _ in ends),
        asked=Asked("max", "<=", limit_s, is_timed=True),
    )
    yield Figure(
        what=f"{what}: statuses other than 0, tokens and processes left",
        unit="",
        samples=tuple(float(faults) for _, faults in ends),
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
        took_s, faults = _end(server)
        with open_bus(BusConfig(connect=(endpoint,))) as bus:
            return took_s, faults + len(bus.alive(keys.alive_server("*")))


def _end(process: "subprocess.Popen[str]") -> tuple[float, int]:
    """Ask a program to end; tell how long it took, and what was wrong with how it ended."""
    started = children(process.pid)
    begin_s = time.monotonic()
    process.terminate()
    status = process.wait(END_S)
    took_s = time.monotonic() - begin_s
    eventually(lambda: not any(map(psutil.pid_exists, started)), END_S, "ending")
    return took_s, int(status != 0)


@contextmanager
def _programs() -> Iterator[dict[str, "subprocess.Popen[str]"]]:
    """Run one of each, at work."""
    with ExitStack() as stack:
        server = stack.enter_context(serving())
        there = ("--connect", server.endpoint)
        server.zensim("spawn", "box_bot", "--name", "r1")
        (driving,) = stack.enter_context(driven(server, "r1")).values()
        waiting = stack.enter_context(running("agent", "r9", "--name", "patient", *there))
        eventually(lambda: "patient" in _agents(server.bus), START_S, "joining")
        folder = Path(stack.enter_context(TemporaryDirectory()))
        kept = stack.enter_context(kept_in(folder, free_endpoint()))
        view = stack.enter_context(running("view", *there, "--port", "0"))
        assert view.stdout is not None
        page = stack.enter_context(bare_page(view.stdout.readline().split()[1]))
        page.send(a_camera())
        page.recv(timeout=END_S)
        yield dict(zip(LIMITS_S, (driving, waiting, kept.process, view), strict=True))


def _agents(bus: Bus) -> list[str]:
    return [keys.agent_of(key) for key in bus.alive(keys.alive_agents("default"))]
