"""An installation in separate processes: router, server, agents, and users of a fleet."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import psutil

from benchmarks.fleet_server import PATIENCE_S, program
from benchmarks.fleet_users import TALLY, Tally
from benchmarks.machine import used_s
from benchmarks.ten_robots import poll_until
from tests.integration.processes import connected, free_endpoint, running
from zensim.proto.bus import Bus, BusSubscription
from zensim.spawner.client.sim_client import SimClient

CALL_TIMEOUT_S = 60.0
TALLIES = 256
ALL_MOVE_S = 30.0
"""Time after the first command until all must move; otherwise a finding."""


@dataclass(frozen=True)
class Installation:
    """Running processes by role."""

    bus: Bus
    client: SimClient
    pids: Mapping[str, tuple[int, ...]]

    def used_s(self) -> dict[str, float]:
        """Get the accumulated CPU time of each group."""
        return {group: sum(used_s(pid) for pid in pids) for group, pids in self.pids.items()}


@contextmanager
def run_installation(
    serve: Sequence[str], agents: Sequence[Sequence[str]], *, has_router: bool = True
) -> Iterator[Installation]:
    """Run a server without robots, and agents with these arguments.

    The router is a process of its own, or that of the server.
    """
    endpoint = free_endpoint()
    with ExitStack() as stack:
        routers = (
            [stack.enter_context(running("router", "--listen", endpoint))] if has_router else []
        )
        how = "--connect" if has_router else "--listen"
        server = stack.enter_context(running("serve", how, endpoint, *serve))
        bus = stack.enter_context(connected(endpoint, (*routers, server)[0]))
        client = SimClient(bus, timeout_s=CALL_TIMEOUT_S)
        client.wait_for_server(PATIENCE_S)
        agents_started = [
            stack.enter_context(running("agent", *words, "--connect", endpoint, "--quiet"))
            for words in agents
        ]
        children = psutil.Process(server.pid).children(recursive=True)
        pids = {
            **({"router": (routers[0].pid,)} if routers else {}),
            "server": (server.pid, *(child.pid for child in children)),
            "agents": tuple(agent.pid for agent in agents_started),
        }
        yield Installation(bus, client, pids)


@contextmanager
def run_fleet_users(bus: Bus, count: int, hz: float) -> Iterator[tuple[BusSubscription, int]]:
    """Run the users of a fleet with this command rate; yield their tallies and pid."""
    tallies = bus.subscribe(TALLY, TALLIES)
    with program("fleet_users", bus.endpoint, str(count), f"{hz:g}") as process:
        yield tallies, process.pid
    tallies.close()


@dataclass(frozen=True)
class Span:
    """Measurements of about one second of an installation."""

    factor: float
    cores: Mapping[str, float]
    commands_hz: float
    odom_hz: float
    tf_hz: float
    moved: int
    """Robots that have moved."""


@dataclass(frozen=True)
class _Sample:
    wall_s: float
    time_s: float
    used_s: Mapping[str, float]
    tally: Tally


def observe(
    installation: Installation,
    tallies: BusSubscription,
    robots: int,
    seconds: float,
    act: Callable[[], object],
) -> list[Span]:
    """Act repeatedly after this number of robots moved; return measurements of every second."""
    give_up_s = time.monotonic() + ALL_MOVE_S

    def begun() -> _Sample | None:
        found = _take_sample(installation, tallies)
        is_late = time.monotonic() > give_up_s
        return found if found is not None and (is_late or found.tally.moved == robots) else None

    samples = [poll_until(begun, 2.0 * ALL_MOVE_S)]
    while samples[-1].wall_s - samples[0].wall_s < seconds:
        act()
        if (found := _take_sample(installation, tallies)) is not None:
            samples.append(found)
    return [_span(before, after) for before, after in pairwise(samples)]


def _take_sample(installation: Installation, tallies: BusSubscription) -> _Sample | None:
    """Sample all figures when a tally was received."""
    if (sample := tallies.newest()) is None:
        return None
    tally = msgspec.msgpack.decode(sample.payload, type=Tally)
    return _Sample(
        time.monotonic(), installation.client.info().sim_time_s, installation.used_s(), tally
    )


def _span(before: _Sample, after: _Sample) -> Span:
    wall_s = after.wall_s - before.wall_s
    told_s = after.tally.wall_s - before.tally.wall_s
    return Span(
        (after.time_s - before.time_s) / wall_s,
        {name: (spent_s - before.used_s[name]) / wall_s for name, spent_s in after.used_s.items()},
        (after.tally.commands - before.tally.commands) / told_s,
        (after.tally.odom - before.tally.odom) / told_s,
        (after.tally.tf - before.tally.tf) / told_s,
        after.tally.moved,
    )
