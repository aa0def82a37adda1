"""Fleets: ten thousand robots

A server, which is its own router, with 10,000 kinematic box_bots; two pools drive them, and another
process commands each robot once a second. Steps and control are at 20 Hz unless told otherwise.
Drive commands are those that the server took: it counts them each second, and so many are due as
pools times the control rate. A pool that is too slow shows there, while the real-time factor stays
at 1. Cores are those of the server and of both pools, without the commanding process. Odometry is
subscribed robot by robot. Subscribers that come and go are ten, then a hundred, for 5 s each. With
ROS 2 a session joins after the seconds and watches all tokens. Memory is what came after the start
without robots. The floor moves as many drives on circles in plain arrays, and writes one message
for all: what the arithmetic takes at this rate, without a network, an engine or neighbours.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import psutil

from benchmarks.figures import Figure, Limit, table
from benchmarks.fleet_server import CALL_TIMEOUT_S, PATIENCE_S, program, spawn
from benchmarks.machine import used_s
from benchmarks.ten_robots import CIRCLE, POLL_S, poll_until
from tests.integration.processes import connected, free_endpoint, running
from zensim.proto import keys
from zensim.proto.bus import Bus, BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.ros2.rmw_keys import OFF
from zensim.proto.topic_catalog import ODOM, STATS
from zensim.spawner.client.sim_client import SimClient

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 10_000, 20
POOLS = 2
SECONDS, SECONDS_WHEN_SHORT = 60.0, 2.0
SETTLE_S, SETTLE_WHEN_SHORT_S = 5.0, 0.5
"""From the claim of the last robot to the first second that counts."""
CHANGE_S, CHANGE_WHEN_SHORT_S = 5.0, 0.5
COMING_AND_GOING = (10, 0, 100, 0)
DRIVEN_S = 60.0
"""Longest wait for pools that drive; what is measured then shows that they do not."""
STATS_DEPTH, ODOM_DEPTH, TOKENS_DEPTH = 64, 256, 1 << 18
TOKENS_OF_ROBOT = 6
SETTLED_S = 3.0
"""Time without a new token after which there are no more."""
KIBIBYTES = 1024.0
FLOOR_SAMPLES, FLOOR_STEPS = 15, 20
NEARLY_ALL = Limit("mean", ">=", 39.5)
NO_DROPS = Limit("max", "<=", 0.0)


@dataclass(frozen=True)
class Case:
    """What is asked of a fleet."""

    label: str
    hz: float = 20.0
    listened: int = 0
    """Robots whose odometry is subscribed all the time."""
    is_changing: bool = False
    """Whether other subscribers come and go."""
    domain: str = OFF
    factor: float = 0.99
    commands: Limit = NEARLY_ALL
    odom_hz: float = 19.5
    cores: float | None = None
    """Most of all processes."""
    server_kib: float | None = None
    pool_kib: float | None = None


CASES = (
    Case("no subscribers", cores=1.1, server_kib=10.0, pool_kib=20.0),
    Case("ten subscribers", listened=10, cores=1.2),
    Case(
        "ten subscribers, 50 Hz",
        hz=50.0,
        listened=10,
        factor=0.98,
        commands=Limit("mean", ">=", 98.0),
        odom_hz=49.0,
    ),
    Case(
        "subscribers come and go",
        is_changing=True,
        factor=0.98,
        commands=Limit("min", ">=", 38.0),
    ),
    Case(
        "ROS 2, ten subscribers",
        listened=10,
        domain="0",
        commands=Limit("min", ">=", 38.0),
        server_kib=20.0,
        pool_kib=25.0,
    ),
)
CASES_WHEN_SHORT = CASES[-2:]


@dataclass
class Seen:
    """What was measured."""

    stats: list[Stats] = field(default_factory=list)
    cores: dict[str, float] = field(default_factory=dict)
    arrivals: dict[str, list[float]] = field(default_factory=dict)
    """Wall times of odometry [s] by key."""
    memory_kib: dict[str, float] = field(default_factory=dict)
    """A robot."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure each case, then the floor."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    for case in CASES_WHEN_SHORT if is_short else CASES:
        yield from _measured(case, robots, is_short=is_short)
    label = f"floor: {robots} drives in arrays, 20 Hz"
    yield Figure(what=label, unit="cores", samples=tuple(_floor_cores(robots, 20.0)))


def _measured(case: Case, robots: int, *, is_short: bool) -> Iterator[Figure]:
    seen, seconds = Seen(), SECONDS_WHEN_SHORT if is_short else SECONDS
    with _started(case, robots, seen) as (bus, pids):
        names = [f"box_bot{number * robots // 10}" for number in range(10)][: case.listened]
        listened = {key: bus.subscribe(key, ODOM_DEPTH) for key in map(ODOM.key, names)}
        stats = bus.subscribe(STATS.key("default"), STATS_DEPTH)
        change = _make_change(case, bus, robots, is_short=is_short)
        claimed_s = time.monotonic()
        settle_s = SETTLE_WHEN_SHORT_S if is_short else SETTLE_S
        _observe(Seen(), stats, listened, settle_s, change)
        _wait_until_driven(stats, POOLS * case.hz)
        driven_s = time.monotonic() - claimed_s
        before = {name: used_s(pid) for name, pid in pids.items()}
        began_s = time.monotonic()
        _observe(seen, stats, listened, seconds, change)
        passed_s = time.monotonic() - began_s
        seen.cores = {name: (used_s(pid) - before[name]) / passed_s for name, pid in pids.items()}
        for name, pid in pids.items():
            memory = psutil.Process(pid).memory_info().rss / KIBIBYTES
            own = robots if name == "server" else robots / POOLS
            seen.memory_kib[name] = (memory - seen.memory_kib[name]) / own
        label = f"{robots} robots, {case.label}"
        what = f"{label}: from the last claim to the first second measured"
        yield Figure(what=what, unit="s", samples=(driven_s,))
        yield from _figures(label, case, seen)
        if case.domain != OFF:
            yield from _watch_tokens(label, bus, robots)


@contextmanager
def _started(case: Case, robots: int, seen: Seen) -> Iterator[tuple[Bus, dict[str, int]]]:
    """Run server, pools and the commanding process until all robots are claimed."""
    endpoint, ros = free_endpoint(), ("--ros-domain", case.domain)
    rates = ("--step-hz", f"{case.hz:g}", "--control-hz", f"{case.hz:g}")
    with ExitStack() as stack:
        serve = ("serve", "--listen", endpoint, "--dynamics", "kinematic", *rates, *ros)
        server = stack.enter_context(running(*serve))
        bus = stack.enter_context(connected(endpoint, server))
        client = SimClient(bus, timeout_s=CALL_TIMEOUT_S)
        client.wait_for_server(PATIENCE_S)
        pool = ("agent", "--pool", "0", "--connect", endpoint, "--quiet", *ros)
        pids = {"server": server.pid}
        for number in range(POOLS):
            pids[f"pool {number + 1}"] = stack.enter_context(running(*pool)).pid
        agents = keys.alive_agents("default")
        poll_until(lambda: len(bus.list_tokens(agents)) == POOLS or None, PATIENCE_S)
        for name, pid in pids.items():
            seen.memory_kib[name] = psutil.Process(pid).memory_info().rss / KIBIBYTES
        stats = bus.subscribe(STATS.key("default"), STATS_DEPTH)
        spawn(client, robots)
        _take_stats(stats, lambda one: one.claimed == robots or None)
        stats.close()
        stack.enter_context(program("fleet_commander", endpoint, str(robots)))
        yield bus, pids


def _take_stats(stats: BusSubscription, is_wanted: Callable[[Stats], bool | None]) -> None:
    """Wait for statistics as wanted."""

    def look() -> bool | None:
        sample = stats.newest()
        return None if sample is None else is_wanted(decode(Stats, sample.payload, sample.encoding))

    poll_until(look, PATIENCE_S)


def _wait_until_driven(stats: BusSubscription, due_hz: float) -> None:
    """Wait for a second with most of the drive commands; measure without it after a patience."""
    give_up_s, last = time.monotonic() + DRIVEN_S, Stats()
    while time.monotonic() < give_up_s:
        for sample in stats.take():
            before, last = last, decode(Stats, sample.payload, sample.encoding)
            passed_s = last.usage.wall_s - before.usage.wall_s
            if before.usage.wall_s and last.commands - before.commands >= 0.9 * due_hz * passed_s:
                return
        time.sleep(POLL_S)


def _make_change(case: Case, bus: Bus, robots: int, *, is_short: bool) -> Callable[[float], object]:
    """Make a function of the wall time that lets subscribers come and go."""
    held: list[BusSubscription] = []
    period_s = CHANGE_WHEN_SHORT_S if is_short else CHANGE_S
    steps = iter(COMING_AND_GOING * 1000)
    next_s = time.monotonic()

    def change(now_s: float) -> None:
        nonlocal next_s
        if now_s >= next_s:
            next_s += period_s
            while held:
                held.pop().close()
            wanted = min(next(steps), robots)
            names = [f"box_bot{number * robots // wanted}" for number in range(wanted)]
            held.extend(bus.subscribe(ODOM.key(name), ODOM_DEPTH) for name in names)

    return change if case.is_changing else lambda _: None


def _observe(
    seen: Seen,
    stats: BusSubscription,
    listened: dict[str, BusSubscription],
    seconds: float,
    change: Callable[[float], object],
) -> None:
    """Keep statistics and arrivals, until the first second after this time [s] is over."""
    began_s = time.monotonic()
    while not seen.stats or time.monotonic() < began_s + seconds or len(seen.stats) < 2:
        change(time.monotonic())
        for key, subscription in listened.items():
            now_s = time.monotonic()
            seen.arrivals.setdefault(key, []).extend(now_s for _ in subscription.take())
        for sample in stats.take():
            seen.stats.append(decode(Stats, sample.payload, sample.encoding))
        time.sleep(POLL_S)


def _figures(label: str, case: Case, seen: Seen) -> Iterator[Figure]:
    spans = list(pairwise(seen.stats))
    walls_s = [after.usage.wall_s - before.usage.wall_s for before, after in spans]
    first, last = seen.stats[0], seen.stats[-1]
    factor = (last.sim_time_s - first.sim_time_s) / (last.usage.wall_s - first.usage.wall_s)
    commands = tuple(
        (after.commands - before.commands) / wall_s
        for (before, after), wall_s in zip(spans, walls_s, strict=True)
    )
    at_least = Limit("mean", ">=", case.factor)
    yield Figure(what=f"{label}: real-time factor", unit="", samples=(factor,), limit=at_least)
    due = f"{label}: drive commands of {POOLS * case.hz:g} due"
    yield Figure(what=due, unit="1/s", samples=commands, limit=case.commands)
    dropped = (last.dropped - first.dropped,)
    yield Figure(what=f"{label}: commands dropped", unit="", samples=dropped, limit=NO_DROPS)
    yield from _odometry_figures(label, case, seen)
    most = None if case.cores is None else Limit("mean", "<=", case.cores)
    total = sum(seen.cores.values())
    yield Figure(what=f"{label}: CPU of all", unit="cores", samples=(total,), limit=most)
    for name, cores in seen.cores.items():
        yield Figure(what=f"{label}: CPU, {name}", unit="cores", samples=(cores,))
    for name, kib in seen.memory_kib.items():
        bound = case.server_kib if name == "server" else case.pool_kib
        limit = None if bound is None else Limit("mean", "<=", bound)
        what = f"{label}: memory of a robot, {name}"
        yield Figure(what=what, unit="KiB", samples=(kib,), limit=limit)


def _odometry_figures(label: str, case: Case, seen: Seen) -> Iterator[Figure]:
    if not seen.arrivals:
        return
    span_s = seen.stats[-1].usage.wall_s - seen.stats[0].usage.wall_s
    rates, gaps_ms = [], []
    for times_s in seen.arrivals.values():
        inner = [one for one in times_s if one <= times_s[0] + span_s]
        rates.append((len(inner) - 1) / (inner[-1] - inner[0]) if len(inner) > 1 else 0.0)
        gaps_ms.append(1e3 * max((b - a for a, b in pairwise(inner)), default=1e3 * span_s))
    limit = Limit("min", ">=", case.odom_hz)
    what = f"{label}: odometry of each subscribed robot"
    yield Figure(what=what, unit="Hz", samples=tuple(rates), limit=limit)
    limit = Limit("max", "<=", 150.0)
    yield Figure(what=f"{label}: longest gap", unit="ms", samples=tuple(gaps_ms), limit=limit)


def _watch_tokens(label: str, bus: Bus, robots: int) -> Iterator[Figure]:
    """Join late, and watch all tokens until no more come."""
    with connected(bus.endpoint) as observer:
        began_s = changed_s = time.monotonic()
        watch, tokens = observer.watch_tokens("@ros2_lv/**", TOKENS_DEPTH), set[str]()
        while time.monotonic() < changed_s + SETTLED_S:
            for token, is_alive in watch.take():
                (tokens.add if is_alive else tokens.discard)(token)
                changed_s = time.monotonic()
            time.sleep(POLL_S)
        watch.close()
    least, most = Limit("min", ">=", TOKENS_OF_ROBOT * robots), Limit("max", "<=", 10.0)
    counted = (float(len(tokens)),)
    yield Figure(what=f"{label}: tokens", unit="", samples=counted, limit=least)
    seen_s = (changed_s - began_s,)
    yield Figure(what=f"{label}: tokens seen, late", unit="s", samples=seen_s, limit=most)


def _floor_cores(robots: int, hz: float) -> Sequence[float]:
    """Move drives on circles in plain arrays; return the cores that this takes at a rate."""
    pose = np.zeros((robots, 3))
    speeds, turns = np.full(robots, CIRCLE[0]), np.full(robots, CIRCLE[1])
    found = []
    for _ in range(FLOOR_SAMPLES):
        began_s = time.process_time()
        for _ in range(FLOOR_STEPS):
            middle = pose[:, 2] + turns * (0.5 / hz)
            pose[:, 0] += speeds * np.cos(middle) / hz
            pose[:, 1] += speeds * np.sin(middle) / hz
            pose[:, 2] += turns / hz
            np.concatenate([pose, speeds[:, None], turns[:, None]], axis=1).tobytes()
        found.append((time.process_time() - began_s) / FLOOR_STEPS * hz)
    return found
