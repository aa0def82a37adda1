"""Ten box_bots and their programs as real processes, and close observation of them."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TypeVar

from benchmarks.figures import Figure, Limit
from tests.integration.processes import Server, running, serving, wait_for_agents
from tests.integration.robots import Robot, robot
from zensim.proto.bus import BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.topic_catalog import STATS

T = TypeVar("T")
ROBOTS = 10
ROBOTS_WHEN_SHORT = 2
SPACING_M = 5.0
CIRCLE = (0.2, 0.5)
"""Linear [m/s] and angular [rad/s] of a robot that drives and stays where it is: r = 0.4 m."""
POLL_S = 0.0003
MILLISECONDS = 1e3


@dataclass(frozen=True)
class Fleet:
    """A server and robots with an agent each, standing."""

    server: Server
    robots: list[Robot]

    def circle(self) -> None:
        """Let every robot drive in a circle until told otherwise."""
        for found in self.robots:
            found.command(*CIRCLE)


@contextmanager
def fleet(count: int, *serve_arguments: str) -> Iterator[Fleet]:
    """Run a server, robots far apart, and agents that let a command stand."""
    layout = ("--count", str(count), "--layout", "grid", "--spacing", str(SPACING_M))
    with serving(*serve_arguments) as server, ExitStack() as stack:
        done = server.zensim("fleet", "box_bot", *layout)
        if done.returncode:
            raise RuntimeError(f"no fleet was spawned: {done.stderr}")
        names = [f"box_bot{i}" for i in range(count)]
        connected = ("--connect", server.endpoint, "--quiet", "--cmd-vel-timeout", "0")
        for name in names:
            stack.enter_context(running("agent", name, *connected))
        wait_for_agents(server, names)
        yield Fleet(server, [robot(server.bus, name) for name in names])


def stats_of(found: Fleet) -> BusSubscription:
    """Listen to what the server says of itself each second."""
    return found.server.bus.subscribe(STATS.key("default"), 4096)


def observe(stats: BusSubscription, act: Callable[[], object]) -> list[Stats]:
    """Act, and return the statistics of the seconds that it took."""
    return next(observe_in_turns(stats, [act]))


def observe_in_turns(
    stats: BusSubscription, acts: Iterable[Callable[[], object]]
) -> Iterator[list[Stats]]:
    """Carry out one act after another; return the statistics of the seconds of each."""
    # From the end of a window of the server on, to the end of the one in which it ends.
    stats.take()
    poll_until(stats.newest)
    for act in acts:
        act()
        seen = stats.take()
        seen += poll_until(lambda: stats.take() or None)
        yield [decode(Stats, sample.payload, sample.encoding) for sample in seen]


def latest_steps(when: str, seen: list[Stats], limit: Limit | None = None) -> Figure:
    """Say how late the latest step of each second was."""
    samples = tuple(stats.late_max_s * MILLISECONDS for stats in seen)
    return Figure(
        what=f"latest step of each second, {when}", unit="ms", samples=samples, limit=limit
    )


def longest_work(when: str, seen: list[Stats], limit: Limit | None = None) -> Figure:
    """Say for how long the loop's own work held a step up in each second: CPU time."""
    samples = tuple(stats.busy_max_s * MILLISECONDS for stats in seen)
    what = f"longest own work before a step of each second, {when}"
    return Figure(what=what, unit="CPU ms", samples=samples, limit=limit)


def poll_until(ask: Callable[[], T | None], within_s: float = 10.0) -> T:
    """Ask until there is an answer, often enough to time it.

    Raises:
        TimeoutError: There was none.
    """
    deadline = time.monotonic() + within_s
    while (answer := ask()) is None:
        if time.monotonic() > deadline:
            raise TimeoutError(f"nothing came within {within_s:g} s")
        time.sleep(POLL_S)
    return answer


def milliseconds(call: Callable[[], object]) -> float:
    """Time one call [ms]."""
    start = time.perf_counter()
    call()
    return (time.perf_counter() - start) * MILLISECONDS
