"""Single agents and pools of one

Ten agents of one robot each, as `zensim agent NAME` (robots one by one) and as `zensim agent --pool
1` (rows of arrays), on a server whose robots are there already: CPU time of the agents until each
robot is claimed, then while all drive circles, commanded at 10 Hz, and one process subscribes to
odometry, tf and joint states of all. A sample of the former is a run, of the latter a second. The
work of one drive state is measured in this process, on a bus in memory. docs/adr/0036 decides by
these figures.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TypeAlias

from benchmarks.drive_states import make_claims, make_drive_states
from benchmarks.figures import Figure, table
from benchmarks.machine import used_s
from benchmarks.ten_robots import CIRCLE, ROBOTS, SPACING_M
from tests.fakes import MemoryBus
from tests.integration.processes import Server, running, serving, wait_for_agents
from tests.integration.robots import robot
from zensim.robot_agent.pool.pooled_robots import PooledRobots
from zensim.robot_agent.robots import IndividualRobots

__all__ = ["rows", "table"]

RUNS, SECONDS = 3, 10
STATES, STATES_WHEN_SHORT = 2000, 20
COMMANDS_HZ = 10
TOPICS = ("odom", "tf", "joint_states")
MICROSECONDS = 1e6
MODEL = "box_bot"
Robots: TypeAlias = IndividualRobots | PooledRobots
CONTAINERS: dict[str, Callable[[MemoryBus, int], Robots]] = {
    "one by one": IndividualRobots,
    "pool": PooledRobots,
}


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the work per state, then the processes."""
    for robots in (1, ROBOTS):
        for name, make in CONTAINERS.items():
            states = STATES_WHEN_SHORT if is_short else STATES
            yield from _state_figures(f"{robots} robots, {name}", make, robots, states)
    robots = 1 if is_short else ROBOTS
    starts: dict[str, list[float]] = {name: [] for name in CONTAINERS}
    waits: dict[str, list[float]] = {name: [] for name in CONTAINERS}
    cores: dict[str, list[float]] = {name: [] for name in CONTAINERS}
    # In turns, so that other load affects both equally.
    for _ in range(1 if is_short else RUNS):
        for name in CONTAINERS:
            wait_s, start_s, seconds = _run(name, robots, 1 if is_short else SECONDS)
            waits[name].append(wait_s)
            starts[name].append(start_s)
            cores[name] += seconds
    for name in CONTAINERS:
        who = f"{robots} agents, {name}: "
        yield Figure(what=f"{who}exec to claimed", unit="s", samples=tuple(waits[name]))
        yield Figure(what=f"{who}CPU until claimed", unit="s", samples=tuple(starts[name]))
        yield Figure(what=f"{who}CPU, driving", unit="cores", samples=tuple(cores[name]))


def _state_figures(
    name: str, make: Callable[[MemoryBus, int], Robots], robots: int, count: int
) -> Iterator[Figure]:
    bus = MemoryBus()
    held = make(bus, 0)
    held.add_claims(make_claims(robots))
    states = make_drive_states(robots)
    held.advance(next(states))
    yield Figure(
        what=f"{name}: a state answered",
        unit="CPU us",
        samples=_cpu_us(count, lambda: held.advance(next(states)), lambda: None),
    )
    for topic in TOPICS:
        bus.subscribe(f"*/{topic}", 1)
    for _ in range(robots):
        held.reply_to_queries()
    yield Figure(
        what=f"{name}: all topics published",
        unit="CPU us",
        samples=_cpu_us(count, held.publish, lambda: held.advance(next(states))),
    )


def _cpu_us(
    count: int, act: Callable[[], object], before: Callable[[], object]
) -> tuple[float, ...]:
    took = []
    for _ in range(count):
        before()
        start_s = time.thread_time()
        act()
        took.append((time.thread_time() - start_s) * MICROSECONDS)
    return tuple(took)


def _run(container: str, robots: int, seconds: int) -> tuple[float, float, list[float]]:
    """Return wall and CPU time [s] until all robots are claimed, and CPU [cores] per second."""
    layout = ("--robots", str(robots), "--layout", "grid", "--spacing", str(SPACING_M))
    with serving() as server, ExitStack() as stack:
        if (done := server.zensim("fleet", MODEL, *layout)).returncode:
            raise RuntimeError(f"no fleet was spawned: {done.stderr}")
        names = [f"{MODEL}{i}" for i in range(robots)]
        words = [(name,) if container == "one by one" else ("--pool", "1") for name in names]
        connected = ("--connect", server.endpoint, "--quiet", "--on-release", "stop")
        start_s = time.perf_counter()
        agents = [stack.enter_context(running("agent", *one, *connected)) for one in words]
        wait_for_agents(server, names)
        wait_s = time.perf_counter() - start_s
        pids = [agent.pid for agent in agents]
        return wait_s, sum(map(used_s, pids)), _drive(server, names, pids, seconds)


def _drive(server: Server, names: list[str], pids: list[int], seconds: int) -> list[float]:
    robots = [robot(server.bus, name) for name in names]
    others = [server.bus.subscribe(f"*/{topic}", 4096) for topic in TOPICS[1:]]
    cores = []
    for second in range(seconds + 1):
        before_s, start_s = sum(map(used_s, pids)), time.perf_counter()
        for _ in range(COMMANDS_HZ):
            for one in robots:
                one.command(*CIRCLE)
                one.read()
            for subscription in others:
                subscription.take()
            time.sleep(1.0 / COMMANDS_HZ)
        if second:  # publishers are declared in the first
            cores.append((sum(map(used_s, pids)) - before_s) / (time.perf_counter() - start_s))
    return cores
