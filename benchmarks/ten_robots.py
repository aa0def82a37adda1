"""Ten box_bots with real processes, and their statistics."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TypeVar

import msgspec

from benchmarks.figures import Figure
from tests.integration.processes import Server, running, serving, wait_for_agents
from tests.integration.robots import Robot, robot
from zensim.proto.bus.bus_session import BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.spawn_messages import SpawnEntityOrder
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.topic_catalog import STATS
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.spawn_client import read_payload, spawn_many
from zensim.spawner.spawn.spawn_poses import make_fleet_layout

T = TypeVar("T")
ROBOTS = 10
ROBOTS_WHEN_SHORT = 2
SPACING_M = 5.0
CIRCLE = (0.2, 0.5)
"""Linear [m/s] and angular [rad/s] velocity on a circle of r = 0.4 m."""
POLL_S = 0.0003
MILLISECONDS = 1e3


@dataclass(frozen=True)
class Fleet:
    """A server and robots at rest with one agent each."""

    server: Server
    robots: list[Robot]
    agents: tuple[int, ...]
    """Processes of the agents, or of the pool."""

    def circle(self) -> None:
        """Command every robot to drive in a circle."""
        for found in self.robots:
            found.command(*CIRCLE)


def spawn(
    client: SimClient, count: int, *, prefix: str = "box_bot", at: tuple[float, float] = (0.0, 0.0)
) -> None:
    """Spawn robots on a grid with this origin [m], all between two steps.

    Raises:
        RuntimeError: Some were refused.
    """
    places = [
        msgspec.structs.replace(place, x=place.x + at[0], y=place.y + at[1])
        for place in make_fleet_layout(prefix, count, "grid", SPACING_M)
    ]
    outcomes = spawn_many(client, read_payload("box_bot"), places, SpawnEntityOrder())
    if refused := [outcome for outcome in outcomes if outcome.message]:
        raise RuntimeError(f"{len(refused)} robots were refused, first {refused[0]}")


@contextmanager
def fleet(count: int, *serve_arguments: str, is_pooled: bool = False) -> Iterator[Fleet]:
    """Run a server, robots far apart, and agents without a command timeout, or one pool."""
    with serving(*serve_arguments) as server, ExitStack() as stack:
        spawn(server.client, count)
        names = [f"box_bot{i}" for i in range(count)]
        connected = ("--connect", server.endpoint, "--quiet", "--cmd-vel-timeout", "0")
        agents = [
            stack.enter_context(running("agent", *given, *connected)).pid
            for given in ([("--pool", "0")] if is_pooled else [(name,) for name in names])
        ]
        wait_for_agents(server, names)
        yield Fleet(server, [robot(server.bus, name) for name in names], tuple(agents))


def stats_of(found: Fleet) -> BusSubscription:
    """Subscribe to the server's statistics of each second."""
    return found.server.bus.subscribe(STATS.key("default"), 4096)


def observe(stats: BusSubscription, act: Callable[[], object]) -> list[Stats]:
    """Act, and return the statistics of the seconds meanwhile."""
    return next(observe_in_turns(stats, [act]))


def observe_in_turns(
    stats: BusSubscription, acts: Iterable[Callable[[], object]]
) -> Iterator[list[Stats]]:
    """Run actions in turn; return the statistics of the seconds of each."""
    # From the end of a statistics window to the end of that in which the action ends.
    stats.take()
    poll_until(stats.newest)
    for act in acts:
        act()
        seen = stats.take()
        seen += poll_until(lambda: stats.take() or None)
        yield [decode(Stats, sample.payload, sample.encoding) for sample in seen]


def latest_steps(when: str, seen: list[Stats]) -> Figure:
    """Make a figure of the latest step of each second."""
    samples = tuple(stats.late_max_s * MILLISECONDS for stats in seen)
    return Figure(what=f"latest step of each second, {when}", unit="ms", samples=samples)


def longest_work(when: str, seen: list[Stats]) -> Figure:
    """Make a figure of the loop's longest own work before a step in each second: CPU time."""
    samples = tuple(stats.busy_max_s * MILLISECONDS for stats in seen)
    what = f"longest own work before a step of each second, {when}"
    return Figure(what=what, unit="CPU ms", samples=samples)


def poll_until(ask: Callable[[], T | None], within_s: float = 10.0) -> T:
    """Poll until a function returns a value, with a short period.

    Raises:
        TimeoutError: No value within the timeout.
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
