"""ROS 2's face

CPU time of the server and of a pool that drives 100 robots, a simulated second, with odometry and
tf at every state: without ROS 2, with its face and nobody who looks, and with one who looks at
everything on it. Floor: the same two processes with `--ros-domain off`, taken in turns. What is
asked is asked of the server's tick; this is stricter, as it counts all that both processes do: the
messages of a pool, and that the server's router passes them on.
"""

import json
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import psutil
import zenoh

from spawner.launch import spawn_fleet
from spawner.placement import fleet_places
from tests.benchmark.figures import Asked, Figure, table
from tests.integration.processes import Server, running, serving, wait_for_agents

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 100, 3
WINDOWS, WINDOW_S = 6, 2.0
UNSEEN = Asked("median", "<=", 1.03)
SEEN = Asked("median", "<=", 1.15)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure both, side by side in time."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    windows, window_s = (1, 0.2) if is_short else (WINDOWS, WINDOW_S)
    with ExitStack() as stack:
        plain = stack.enter_context(_driven(robots, "off"))
        faced = stack.enter_context(_driven(robots, "0"))
        quiet = [(_cost(plain, window_s), _cost(faced, window_s)) for _ in range(windows)]
        with _looking(faced[0]):
            seen = [(_cost(plain, window_s), _cost(faced, window_s)) for _ in range(windows)]
    yield from _figures(f"{robots} robots, nobody looks", quiet, UNSEEN)
    yield from _figures(f"{robots} robots, one looks at all", seen, SEEN)


def _figures(what: str, pairs: list[tuple[float, float]], asked: Asked) -> Iterator[Figure]:
    for whom, samples in zip(("floor, no ROS 2", "ROS 2"), zip(*pairs, strict=True), strict=True):
        yield Figure(what=f"{what}: {whom}", unit="ms CPU a simulated s", samples=tuple(samples))
    ratio = tuple(faced / plain for plain, faced in pairs)
    yield Figure(what=f"{what}: ROS 2 / floor", unit="", samples=ratio, asked=asked)


@contextmanager
def _driven(robots: int, domain: str) -> Iterator[tuple[Server, list[psutil.Process]]]:
    with serving("--ros-domain", domain) as server:
        places = fleet_places("box_bot", robots, "grid", 1.0)
        spawn_fleet(server.client, "box_bot", places, lambda _: None)
        arguments = ("agent", "--pool", "0", "--connect", server.endpoint, "--quiet")
        with running(*arguments, "--ros-domain", domain) as pool:
            wait_for_agents(server, [place.name for place in places])
            # Of the process itself: the server's reader of descriptions has nothing to do here.
            yield server, [psutil.Process(server.process.pid), psutil.Process(pool.pid)]


@contextmanager
def _looking(server: Server) -> Iterator[None]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([server.endpoint]))
    with zenoh.open(config) as session:
        channel: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(1)
        subscriber = session.declare_subscriber("0/**", channel)
        time.sleep(WINDOW_S)
        yield
        subscriber.undeclare()


def _cost(driven: tuple[Server, list[psutil.Process]], window_s: float) -> float:
    server, processes = driven
    began, before_s = server.client.info().sim_time_s, _used_s(processes)
    time.sleep(window_s)
    simulated_s = server.client.info().sim_time_s - began
    return 1000.0 * (_used_s(processes) - before_s) / simulated_s


def _used_s(processes: list[psutil.Process]) -> float:
    times = [process.cpu_times() for process in processes]
    return math.fsum(one.user + one.system for one in times)
