"""ROS 2: fleets

A thousand robots stand in a server. Two pools start and publish odometry and tf at 10 Hz, with ROS
2 and without (the floor). A fleet is ready when odometry of each robot has arrived, from the start
of the pools: on ROS 2 keys, and on plain keys. Then a session joins late and subscribes to the
tokens of all endpoints, as rmw_zenoh does, until it has all. Floor: as many tokens with short keys,
in as many sessions of this process, received by another that joins late.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

from benchmarks.bench_fleet_traffic import POOLS, pool
from benchmarks.figures import Figure, Limit, table
from benchmarks.fleet_server import CALL_TIMEOUT_S, PATIENCE_S
from benchmarks.machine import used_s
from benchmarks.ten_robots import POLL_S, poll_until, spawn
from tests.integration.processes import connected, free_endpoint, running
from zensim.proto.bus import Bus
from zensim.proto.ros2.rmw_keys import OFF
from zensim.spawner.client.sim_client import SimClient

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 1000, 3
RUNS = 3
HZ = 10.0
SERVE = ("--dynamics", "auto", "--step-hz", "100")
DOMAINS = {"floor, no ROS 2": (OFF, "*/odom", 0), "ROS 2": ("0", "0/*/odom/**", 1)}
"""Arguments of pools, key of their odometry, and index of the key chunk with the robot's name."""
TOKENS, PLAIN = "@ros2_lv/0/**", "bench/token"
TOKENS_OF_SESSION = 1000
"""Approximate number of tokens per session of a pool."""
DEPTH = 1 << 17
SETTLED_S = 3.0
READY = Limit("max", "<=", 5.0)
FOUND = Limit("max", "<=", 5.0)


@dataclass
class Starts:
    """Time [s] until fleets are ready, and CPU time of their pools."""

    ready_s: list[float] = field(default_factory=list)
    used_s: list[float] = field(default_factory=list)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure with and without ROS 2 in turns, then late joiners."""
    robots, runs = (ROBOTS_WHEN_SHORT, 1) if is_short else (ROBOTS, RUNS)
    domains = {face: one for face, one in DOMAINS.items() if one[0] != OFF or not is_short}
    starts, looks = {face: Starts() for face in domains}, []
    for _ in range(runs):
        for face, (domain, pattern, place) in domains.items():
            with _started(robots, domain) as (bus, start):
                start(starts[face], pattern, place)
                if domain != OFF:
                    looks.append(_join_late(bus, robots))
    yield from _figures(f"{robots} robots, {POOLS} pools", starts)
    counts, record_lateness, floor = zip(*looks, strict=True)
    late = f"{robots} robots: {max(counts)} tokens"
    yield Figure(what=f"{late} watched, late", unit="s", samples=record_lateness, limit=FOUND)
    yield Figure(what=f"{late} watched, late: floor, short keys", unit="s", samples=floor)


def _figures(label: str, starts: dict[str, Starts]) -> Iterator[Figure]:
    for face, found in starts.items():
        limit = READY if face == "ROS 2" else None
        samples = tuple(found.ready_s)
        yield Figure(what=f"{label}: ready, {face}", unit="s", samples=samples, limit=limit)
        used = tuple(found.used_s)
        yield Figure(what=f"{label}: CPU of the pools until then, {face}", unit="s", samples=used)


Start = Callable[[Starts, str, int], None]


@contextmanager
def _started(robots: int, domain: str) -> Iterator[tuple[Bus, Start]]:
    """Run a router and a server with robots; yield a function that starts the pools."""
    endpoint, ros = free_endpoint(), ("--ros-domain", domain)
    with ExitStack() as stack:
        router = stack.enter_context(running("router", "--listen", endpoint))
        bus = stack.enter_context(connected(endpoint, router))
        stack.enter_context(running("serve", "--connect", endpoint, *SERVE, *ros))
        client = SimClient(bus, timeout_s=CALL_TIMEOUT_S)
        client.wait_for_server(PATIENCE_S)
        spawn(client, robots)

        def start(found: Starts, pattern: str, place: int) -> None:
            words = ("agent", *pool(HZ), "--connect", endpoint, "--quiet", *ros)
            odom = bus.subscribe(pattern, DEPTH)
            began_s = time.monotonic()
            pids = [stack.enter_context(running(*words)).pid for _ in range(POOLS)]
            arrived: set[str] = set()

            def is_ready() -> bool | None:
                arrived.update(sample.key.split("/")[place] for sample in odom.take())
                return len(arrived) == robots or None

            poll_until(is_ready, PATIENCE_S)
            found.ready_s.append(time.monotonic() - began_s)
            found.used_s.append(sum(used_s(pid) for pid in pids))
            odom.close()

        yield bus, start


def _settled(bus: Bus, least: int) -> int:
    """Count the tokens when there are enough and they no longer change."""
    watch, tokens = bus.watch_tokens(TOKENS, DEPTH), set[str]()
    changed_s = began_s = time.monotonic()
    while len(tokens) < least or time.monotonic() < changed_s + SETTLED_S:
        for token, is_alive in watch.take():
            (tokens.add if is_alive else tokens.discard)(token)
            changed_s = time.monotonic()
        if changed_s > began_s + PATIENCE_S:
            raise TimeoutError(f"tokens still come and go after {PATIENCE_S:g} s")
        time.sleep(POLL_S)
    watch.close()
    return len(tokens)


def _join_late(bus: Bus, robots: int) -> tuple[int, float, float]:
    """Return the number of tokens, and the time [s] to receive them and as many plain ones."""
    count = _settled(bus, robots)
    seen_s = _seen_s(bus.endpoint, TOKENS, count)
    # A token is undeclared when its object is deleted.
    held = []
    with ExitStack() as stack:
        for start in range(0, count, TOKENS_OF_SESSION):
            session = stack.enter_context(bus.open_session())
            numbers = range(start, min(start + TOKENS_OF_SESSION, count))
            held += [session.token(f"{PLAIN}/{number}") for number in numbers]
        _settled_at(bus, f"{PLAIN}/*", count)
        return count, seen_s, _seen_s(bus.endpoint, f"{PLAIN}/*", count)


def _seen_s(endpoint: str, pattern: str, count: int) -> float:
    """Join, and wait for this number of tokens; return the time [s]."""
    began_s = time.monotonic()
    with connected(endpoint) as bus:
        _settled_at(bus, pattern, count)
        return time.monotonic() - began_s


def _settled_at(bus: Bus, pattern: str, count: int) -> None:
    watch = bus.watch_tokens(pattern, DEPTH)
    seen: set[str] = set()

    def has_all() -> bool | None:
        seen.update(token for token, is_alive in watch.take() if is_alive)
        return len(seen) >= count or None

    poll_until(has_all, PATIENCE_S)
    watch.close()
