"""Start and stop

From the exec of `zensim up --json` to its line that says that every robot has published odometry,
and with the page also that it is served; then from Ctrl-C until no process is left. `ready_s` is
the time in that line: without the start of the interpreter, and without the page. One run before is
not counted, so that the disk cache is warm. `CPU until ready` is the CPU time of all processes by
then, which other programs hardly change. Floor: as many interpreters at once that only import the
outside libraries of agents and server.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks.figures import Figure, table
from benchmarks.machine import used_s
from benchmarks.ten_robots import ROBOTS, ROBOTS_WHEN_SHORT
from tests.integration.processes import children, read_json_line, running

__all__ = ["rows", "table"]

RUNS = 5
PAGES = {"without page": ("--no-viewer",), "with page": ("--port", "0", "--no-open")}
AGENT = "import zenoh, msgspec, xxhash"
SERVER = "import zenoh, msgspec, rich, typer, numpy, pybullet, lxml.etree"


@dataclass(frozen=True)
class Run:
    """Durations of one `zensim up`: from exec, as reported, and to exit; and its CPU time."""

    wall_s: float
    ready_s: float
    used_s: float
    end_s: float


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure starts with and without the page, and their floor."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    for page, options in list(PAGES.items())[-1:] if is_short else PAGES.items():
        runs = [_run(robots, options) for _ in range(1 if is_short else RUNS + 1)]
        yield from _figures(f"{robots} robots, {page}", runs if is_short else runs[1:])
    floors = [_import_all(robots) for _ in range(1 if is_short else RUNS + 1)]
    yield Figure(
        what=f"floor: {robots + 1} interpreters import libraries",
        unit="s",
        samples=tuple(floors if is_short else floors[1:]),
    )


def _figures(what: str, runs: list[Run]) -> Iterator[Figure]:
    yield Figure(what=f"{what}: exec to ready", unit="s", samples=tuple(r.wall_s for r in runs))
    yield Figure(what=f"{what}: ready_s", unit="s", samples=tuple(run.ready_s for run in runs))
    yield Figure(
        what=f"{what}: CPU until ready", unit="s", samples=tuple(run.used_s for run in runs)
    )
    yield Figure(what=f"{what}: Ctrl-C to gone", unit="s", samples=tuple(r.end_s for r in runs))


def _run(robots: int, options: tuple[str, ...]) -> Run:
    arguments = ("up", "--json", "--listen", "tcp/127.0.0.1:0", "--robots", str(robots))
    start_s = time.perf_counter()
    with running(*arguments, *options) as up:
        line = read_json_line(up)
        ready_s = time.perf_counter()
        worked_s = sum(used_s(pid) for pid in (up.pid, *children(up.pid)))
        up.send_signal(signal.SIGINT)
        up.wait(10.0)
        end_s = time.perf_counter()
    return Run(ready_s - start_s, float(str(line["ready_s"])), worked_s, end_s - ready_s)


def _import_all(robots: int) -> float:
    start_s = time.perf_counter()
    imports = [SERVER, *[AGENT] * robots]
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", text], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        for text in imports
    ]
    for process in processes:
        _, complaint = process.communicate()
        if process.returncode:
            raise RuntimeError(f"{process.args!r} failed: {complaint.decode()}")
    return time.perf_counter() - start_s
