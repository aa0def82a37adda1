"""Cost of ten robots

`zensim up` with its page served and not open: first the robots stand without subscribers, then they
drive circles, commanded at 10 Hz, and one process subscribes to all odometry and tf. That process
is this one and is not among `all processes`. A sample is a second, or a process for memory; CPU is
in cores: seconds of CPU time per second. Floor of memory: an interpreter with the outside libraries
of an agent and one open session.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import psutil

from benchmarks.figures import Figure, Limit, table
from benchmarks.ten_robots import CIRCLE, ROBOTS, ROBOTS_WHEN_SHORT
from benchmarks.up_programs import find_programs
from tests.integration.processes import connected, read_json_line, running
from tests.integration.robots import Robot, robot
from zensim.proto.bus import BusSubscription
from zensim.proto.topic_catalog import TF
from zensim.spawner.client.sim_client import SimClient

__all__ = ["rows", "table"]

SECONDS = 30
SECONDS_WHEN_SHORT = 1
COMMANDS_HZ = 10
MEGABYTES = 1e-6
FACTOR = Limit("mean", ">=", 0.99)
CPU = Limit("mean", "<=", 1.0)
RSS = Limit("max", "<=", 70.0)
BARE = """
import msgspec, sys, time, typer, zenoh
config = zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["%s"]}}')
with zenoh.open(config):
    print(flush=True)
    time.sleep(60)
"""

Groups = Mapping[str, list[psutil.Process]]


@dataclass
class Seconds:
    """Measurements of each second."""

    factor: list[float] = field(default_factory=list)
    cores: dict[str, list[float]] = field(default_factory=dict)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure real-time factor, CPU and memory."""
    seconds = SECONDS_WHEN_SHORT if is_short else SECONDS
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    arguments = ("--robots", str(robots), "--listen", "tcp/127.0.0.1:0", "--viewer-port", "0")
    with running("up", "--json", "--no-open", *arguments) as up:
        endpoint = str(read_json_line(up)["endpoint"])
        groups = _groups(up)
        with connected(endpoint) as bus:
            client = SimClient(bus)
            standing = _watched(groups, client, seconds, lambda: None)
            found = [robot(bus, f"box_bot{i}") for i in range(robots)]
            tf = bus.subscribe(TF.key("*"), 4096)
            driving = _watched(groups, client, seconds, lambda: _command(found, tf))
        yield from _second_figures("standing", standing)
        yield from _second_figures("driving", driving)
        yield from _memory_figures(groups)
        yield Figure(what="floor: RSS of a bare session", unit="MB", samples=(_bare_mb(endpoint),))


def _groups(up: "subprocess.Popen[str]") -> Groups:
    """Group the processes by program."""
    found = {group: list(map(psutil.Process, pids)) for group, pids in find_programs(up).items()}
    return {group: processes for group, processes in found.items() if processes}


def _watched(
    groups: Groups, client: SimClient, seconds: int, command: Callable[[], None]
) -> Seconds:
    """Sample once per second, and command in between."""
    seen = Seconds(cores={group: [] for group in (*groups, "this process")})
    every = {**groups, "this process": [psutil.Process()]}
    before = {group: _worked_s(members) for group, members in every.items()}
    simulated_s, start_s = client.info().sim_time_s, time.perf_counter()
    for _ in range(seconds):
        for _ in range(COMMANDS_HZ):
            command()
            time.sleep(1.0 / COMMANDS_HZ)
        now_s = client.info().sim_time_s
        elapsed_s = time.perf_counter() - start_s
        seen.factor.append((now_s - simulated_s) / elapsed_s)
        for group, members in every.items():
            worked_s = _worked_s(members)
            seen.cores[group].append((worked_s - before[group]) / elapsed_s)
            before[group] = worked_s
        simulated_s, start_s = now_s, start_s + elapsed_s
    return seen


def _worked_s(processes: list[psutil.Process]) -> float:
    return sum(times.user + times.system for times in (p.cpu_times() for p in processes))


def _command(robots: list[Robot], tf: BusSubscription) -> None:
    for found in robots:
        found.command(*CIRCLE)
        found.read()
    tf.take()


def _second_figures(when: str, seen: Seconds) -> Iterator[Figure]:
    ours = [cores for group, cores in seen.cores.items() if group != "this process"]
    yield Figure(
        what=f"{when}: real-time factor", unit="", samples=tuple(seen.factor), limit=FACTOR
    )
    yield Figure(
        what=f"{when}: CPU, all processes",
        unit="cores",
        samples=tuple(sum(second) for second in zip(*ours, strict=True)),
        limit=CPU,
    )
    for group, cores in seen.cores.items():
        yield Figure(what=f"{when}: CPU, {group}", unit="cores", samples=tuple(cores))


def _memory_figures(groups: Groups) -> Iterator[Figure]:
    for group, members in groups.items():
        used = [process.memory_full_info() for process in members]
        yield Figure(
            what=f"RSS, {group}",
            unit="MB",
            samples=tuple(one.rss * MEGABYTES for one in used),
            limit=RSS if group == "agents" else None,
        )
        yield Figure(
            what=f"USS, {group}", unit="MB", samples=tuple(one.uss * MEGABYTES for one in used)
        )


def _bare_mb(endpoint: str) -> float:
    process = psutil.Popen([sys.executable, "-c", BARE % endpoint], stdout=subprocess.PIPE)
    try:
        process.stdout.readline()
        return float(process.memory_info().rss * MEGABYTES)
    finally:
        process.terminate()
        process.communicate()
