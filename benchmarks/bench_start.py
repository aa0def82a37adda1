"""Start and stop

From the exec of `zensim up --json` to its line that says that every robot has published odometry,
and with the page also that it is served; then from Ctrl-C until no process is left. `ready_s` is
the time in that line: without the start of the interpreter, and without the page. One run before is
not counted, so that the disk cache is warm. `CPU until ready` is the CPU time of all processes by
then, which other programs hardly change. `idle`: ten robots drive circles with the page and ROS 2,
without subscribers, with an agent for each robot and with a pool: cores of all programs, and their
memory as proportional sets (PSS) and as resident sets, which count shared pages in each. Floor: as
many interpreters at once that only import the outside libraries of agents and server.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import psutil

from benchmarks.figures import Figure, table
from benchmarks.machine import used_s
from benchmarks.ten_robots import ROBOTS, ROBOTS_WHEN_SHORT
from benchmarks.up_programs import find_programs
from tests.integration.processes import children, read_json_line, running

__all__ = ["rows", "table"]

RUNS = 5
PAGES = {"without page": ("--no-viewer",), "with page": ("--port", "0", "--no-open")}
AGENTS = ("per-robot", "pooled")
SETTLED_S, IDLE_S = 5.0, 10.0
MIB = 1 << 20
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
    for agents in AGENTS:
        yield from _measure_idling(robots, agents, is_short=is_short)
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


def _measure_idling(robots: int, agents: str, *, is_short: bool) -> Iterator[Figure]:
    """Measure idle programs without subscribers, each and together."""
    arguments = ("up", "--json", "--listen", "tcp/127.0.0.1:0", "--robots", str(robots))
    with running(*arguments, *PAGES["with page"], "--agents", agents) as up:
        ready_s = float(str(read_json_line(up)["ready_s"]))
        time.sleep(0.0 if is_short else SETTLED_S)
        programs = {group: pids for group, pids in find_programs(up).items() if pids}
        before = {pid: used_s(pid) for pids in programs.values() for pid in pids}
        began_s = time.monotonic()
        time.sleep(1.0 if is_short else IDLE_S)
        passed_s = time.monotonic() - began_s
        cores = {pid: (used_s(pid) - used) / passed_s for pid, used in before.items()}
        sets = {pid: psutil.Process(pid).memory_full_info() for pid in before}
    what = f"{robots} robots idle, {agents}"
    yield Figure(what=f"{what}: ready_s", unit="s", samples=(ready_s,))
    for group, pids in {"all programs": tuple(before), **programs}.items():
        figures = {
            "cores": sum(cores[pid] for pid in pids),
            "MiB, PSS": sum(sets[pid].pss for pid in pids) / MIB,
            "MiB, RSS": sum(sets[pid].rss for pid in pids) / MIB,
        }
        for unit, number in figures.items():
            yield Figure(what=f"{what}: {group}", unit=unit, samples=(number,))


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
