"""Fleets: ten thousand robots

A server, which is its own router, with 10,000 kinematic box_bots; two pools drive them, and another
process commands each robot once a second. Steps and control are at 20 Hz unless told otherwise.
Drive commands are the steps that the server took a command for, of those whose state a pool got: it
counts both, and each sample is its second, scaled to pools times the control rate. A pool that is
too slow shows there, while the real-time factor stays at 1. Cores are those of server, pools and
sensor process, without the commanding process. Odometry is subscribed robot by robot. Subscribers
that come and go are ten, then a hundred, for 5 s each. With lidars, a hundred of the robots scan at
5 Hz, and all scans are subscribed. By wildcard, `zensim hz '*/odom'` runs beside, and then a
`zensim echo '*/odom'` whose output is not read; each pool publishes 10,000 messages a second to
both, and the server warns of what it withholds by an event. Rates are counts over the whole window
of the seconds, and gaps reach from its begin and to its end. With ROS 2 a session joins after the
seconds and watches all tokens, of 500 robots of each pool and of those with subscribers on keys of
ROS 2, until none came for 15 s; the time is that of the last one. Another one subscribes to the
odometry of the last robot, which is beyond those 500, as `ros2 topic echo` with a type does: a node
of ROS 2 sees that robot in its graph from then on. Memory is what came after the start without
robots. Floors: bare tokens with the keys of robots, declared in a session of another process, with
a session that joins late; the messages of the fleet, as many and as large, between processes that
compute nothing; and as many drives as robots, on circles in plain arrays, with one message for all:
what the arithmetic takes at this rate, without a network, an engine or neighbours.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from benchmarks.arrivals import ArrivalWindow
from benchmarks.bare_tokens import TOKENS_OF_ROBOT, DeclaredTokens, read_memory_kib
from benchmarks.figures import Figure, Limit, table
from benchmarks.fleet_commander import BEGINNING
from benchmarks.fleet_server import CALL_TIMEOUT_S, PATIENCE_S, line_with, program
from benchmarks.machine import used_s
from benchmarks.ten_robots import CIRCLE, MILLISECONDS, POLL_S, SPACING_M, poll_until
from tests.integration.processes import connected, free_endpoint, running
from zensim.proto import keys
from zensim.proto.bus import Bus, BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.spawn_messages import SpawnEntityOrder
from zensim.proto.messages.standard_messages import Odometry
from zensim.proto.messages.telemetry_messages import Event, Stats
from zensim.proto.ros2.rmw_keys import OFF, make_data_key
from zensim.proto.ros2.ros_graph import MAX_ROBOTS_ANNOUNCED
from zensim.proto.ros2.type_hash import hash_type
from zensim.proto.subscriber_search import WILDCARD_MESSAGES_HZ
from zensim.proto.topic_catalog import EVENTS, ODOM, SCAN, STATS
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.spawn_client import read_payload, spawn_many
from zensim.spawner.spawn.spawn_poses import make_fleet_layout

if TYPE_CHECKING:
    import subprocess

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 10_000, 20
POOLS = 2
SECONDS, SECONDS_WHEN_SHORT = 60.0, 1.0
SETTLE_S, SETTLE_WHEN_SHORT_S = 5.0, 0.5
"""Time from the claim of the last robot to the first second that counts."""
CHANGE_S, CHANGE_WHEN_SHORT_S = 5.0, 0.5
COMING_AND_GOING = (10, 0, 100, 0)
LONGEST_ECHO_S = 2.0
MOST_READER_MB, KIB, MEGABYTE = 150.0, 1024, 1e6
QUIET_S, QUIET_WHEN_SHORT_S = 15.0, 1.0
"""Time without a further token after which an observer has all."""
DRIVEN_S = 60.0
"""Longest wait for pools that drive; what is measured then shows that they do not."""
STATS_DEPTH, ODOM_DEPTH, SCAN_DEPTH, TOKENS_DEPTH = 64, 256, 4096, 1 << 18
EVENTS_DEPTH = 1 << 15
LIDARS, LIDARS_WHEN_SHORT = 100, 2
LIDAR, LIDAR_RATE, SCAN_HZ = "box_bot_lidar", "<update_rate>10</update_rate>", 5.0
LEAST_SCAN_HZ = 4.9
ROBOTS_WITH_BARE_TOKENS, ROBOTS_WITH_BARE_TOKENS_WHEN_SHORT = (500, 1000, 2000), (20,)
FLOOR_SAMPLES, FLOOR_STEPS = 15, 20
BARE_FLEET_S, BARE_FLEET_WINDOWS = 4.0, 5
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
    lidars: int = 0
    """Robots that scan, among all."""
    has_wildcard: bool = False
    """Whether `zensim hz` subscribes to the odometry of all robots."""
    domain: str = OFF
    factor: float = 0.99
    commands: Limit = NEARLY_ALL
    odom_hz: float = 19.5
    cores: float | None = None
    """Most cores of all processes."""
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
    Case("all by wildcard", has_wildcard=True, factor=0.95, commands=Limit("mean", ">=", 38.0)),
    Case("ten subscribers, a hundred lidars", listened=10, lidars=LIDARS),
    Case(
        "ROS 2, ten subscribers",
        listened=10,
        domain="0",
        commands=Limit("min", ">=", 38.0),
        server_kib=20.0,
        pool_kib=25.0,
    ),
)
CASES_WHEN_SHORT = (
    Case(
        "ROS 2, lidars, ten subscribers, others come and go, all by wildcard",
        listened=10,
        is_changing=True,
        lidars=LIDARS_WHEN_SHORT,
        has_wildcard=True,
        domain="0",
    ),
)
"""One installation in which everything happens."""


@dataclass(frozen=True)
class Users:
    """What subscribes to a fleet."""

    stats: BusSubscription
    odometry: dict[str, BusSubscription]
    """Subscriptions by key."""
    scans: BusSubscription | None
    change: Callable[[float], object]
    """Lets other subscribers come and go at a wall time [s]."""

    def take(self, seen: "Seen") -> None:
        """Keep what has arrived."""
        self.change(now_s := time.monotonic())
        for key, subscription in self.odometry.items():
            seen.arrivals.setdefault(key, []).extend(now_s for _ in subscription.take())
        for sample in self.scans.take() if self.scans is not None else ():
            seen.scans.setdefault(sample.key, []).append(now_s)
        for sample in self.stats.take():
            seen.stats.append(decode(Stats, sample.payload, sample.encoding))


@dataclass
class Seen:
    """What was measured."""

    window: ArrivalWindow = field(default_factory=lambda: ArrivalWindow(0.0, 0.0))
    stats: list[Stats] = field(default_factory=list)
    cores: dict[str, float] = field(default_factory=dict)
    arrivals: dict[str, list[float]] = field(default_factory=dict)
    """Wall times of odometry [s] by key."""
    scans: dict[str, list[float]] = field(default_factory=dict)
    """Wall times of scans [s] by key."""
    memory_kib: dict[str, float] = field(default_factory=dict)
    """Memory per robot by process, or per lidar for the sensors."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure each case, then the floors."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    for case in CASES_WHEN_SHORT if is_short else CASES:
        yield from _measured(case, robots, is_short=is_short)
    for count in ROBOTS_WITH_BARE_TOKENS_WHEN_SHORT if is_short else ROBOTS_WITH_BARE_TOKENS:
        yield from _measure_bare_tokens(count, QUIET_WHEN_SHORT_S if is_short else QUIET_S)
    yield from _measure_bare_fleet(robots, SECONDS_WHEN_SHORT if is_short else BARE_FLEET_S)
    label = f"floor: {robots} drives in arrays, 20 Hz"
    yield Figure(what=label, unit="cores", samples=tuple(_floor_cores(robots, 20.0)))


def _measured(case: Case, robots: int, *, is_short: bool) -> Iterator[Figure]:
    seen, seconds = Seen(), SECONDS_WHEN_SHORT if is_short else SECONDS
    with _started(case, robots, seen) as (bus, pids):
        users = _subscribe(case, bus, robots, is_short=is_short)
        hz = _start_hz(bus) if case.has_wildcard else None
        claimed_s = time.monotonic()
        _observe(Seen(), users, SETTLE_WHEN_SHORT_S if is_short else SETTLE_S)
        _wait_until_driven(users.stats, POOLS * case.hz)
        driven_s = time.monotonic() - claimed_s
        before = {name: used_s(pid) for name, pid in pids.items()}
        # What came while the pools were awaited is no part of the rates.
        users.take(Seen())
        began_s = time.monotonic()
        _observe(seen, users, seconds)
        seen.window = ArrivalWindow(began_s, time.monotonic())
        passed_s = seen.window.end_s - began_s
        seen.cores = {name: (used_s(pid) - before[name]) / passed_s for name, pid in pids.items()}
        shares = {"server": robots, "sensors": case.lidars}
        for name, pid in pids.items():
            own = shares.get(name, robots / POOLS)
            seen.memory_kib[name] = (read_memory_kib(pid) - seen.memory_kib[name]) / own
        label = f"{robots} robots, {case.label}"
        what = f"{label}: from the last claim to the first second measured"
        yield Figure(what=what, unit="s", samples=(driven_s,))
        yield from _figures(label, case, seen)
        if hz is not None:
            yield from _watch_wildcard(label, bus, hz, seconds)
        if case.domain != OFF:
            quiet_s = QUIET_WHEN_SHORT_S if is_short else QUIET_S
            yield from _watch_tokens(label, bus, users, robots, quiet_s)


def _subscribe(case: Case, bus: Bus, robots: int, *, is_short: bool) -> Users:
    names = [f"box_bot{number * robots // 10}" for number in range(10)][: case.listened]
    return Users(
        bus.subscribe(STATS.key("default"), STATS_DEPTH),
        {key: bus.subscribe(key, ODOM_DEPTH) for key in map(ODOM.key, names)},
        bus.subscribe(SCAN.key("*"), SCAN_DEPTH) if case.lidars else None,
        _make_change(case, bus, robots, is_short=is_short),
    )


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
        joined = ("--connect", endpoint, "--quiet", *ros)
        pids = {"server": server.pid}
        for number in range(POOLS):
            pool = running("agent", "--pool", "0", *joined)
            pids[f"pool {number + 1}"] = stack.enter_context(pool).pid
        if case.lidars:
            pids["sensors"] = stack.enter_context(running("sensors", "run", *joined)).pid
        agents = keys.alive_agents("default")
        poll_until(lambda: len(bus.list_tokens(agents)) == POOLS or None, PATIENCE_S)
        seen.memory_kib = {name: read_memory_kib(pid) for name, pid in pids.items()}
        stats = bus.subscribe(STATS.key("default"), STATS_DEPTH)
        _spawn(client, robots, case.lidars)
        _take_stats(stats, lambda one: one.claimed == robots or None)
        stats.close()
        line_with(BEGINNING, stack.enter_context(program("fleet_commander", endpoint, str(robots))))
        yield bus, pids


def _spawn(client: SimClient, robots: int, lidars: int) -> None:
    """Spawn robots on a grid; the last ones scan.

    Raises:
        RuntimeError: Some were refused.
    """
    places = make_fleet_layout("box_bot", robots, "grid", SPACING_M)
    text = read_builtin_model(LIDAR).replace(LIDAR_RATE, f"<update_rate>{SCAN_HZ:g}</update_rate>")
    with_lidar = msgspec.structs.replace(read_payload(LIDAR), text=text)
    parts = (
        (read_payload("box_bot"), places[: robots - lidars]),
        (with_lidar, places[robots - lidars :]),
    )
    for payload, part in parts:
        outcomes = spawn_many(client, payload, part, SpawnEntityOrder()) if part else ()
        if refused := [outcome for outcome in outcomes if outcome.message]:
            raise RuntimeError(f"{len(refused)} robots were refused, first {refused[0]}")


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


def _observe(seen: Seen, users: Users, seconds: float) -> None:
    """Keep statistics and arrivals, until the first second after this time [s] is over."""
    began_s = time.monotonic()
    while not seen.stats or time.monotonic() < began_s + seconds or len(seen.stats) < 2:
        users.take(seen)
        time.sleep(POLL_S)


def _figures(label: str, case: Case, seen: Seen) -> Iterator[Figure]:
    first, last = seen.stats[0], seen.stats[-1]
    factor = (last.sim_time_s - first.sim_time_s) / (last.usage.wall_s - first.usage.wall_s)
    due_hz = POOLS * case.hz
    commands = tuple(due_hz * _find_share(*span) for span in pairwise(seen.stats))
    at_least = Limit("mean", ">=", case.factor)
    yield Figure(what=f"{label}: real-time factor", unit="", samples=(factor,), limit=at_least)
    due = f"{label}: drive commands of {due_hz:g} due"
    yield Figure(what=due, unit="1/s", samples=commands, limit=case.commands)
    dropped = (last.dropped - first.dropped,)
    yield Figure(what=f"{label}: commands dropped", unit="", samples=dropped, limit=NO_DROPS)
    yield from _odometry_figures(label, case, seen)
    if case.lidars:
        yield _make_scan_figure(label, case, seen)
    most = None if case.cores is None else Limit("mean", "<=", case.cores)
    total = sum(seen.cores.values())
    yield Figure(what=f"{label}: CPU of all", unit="cores", samples=(total,), limit=most)
    for name, cores in seen.cores.items():
        yield Figure(what=f"{label}: CPU, {name}", unit="cores", samples=(cores,))
    for name, kib in seen.memory_kib.items():
        bound = case.server_kib if name == "server" else case.pool_kib
        limit = None if bound is None else Limit("mean", "<=", bound)
        what = f"{label}: memory of a {'lidar' if name == 'sensors' else 'robot'}, {name}"
        yield Figure(what=what, unit="KiB", samples=(kib,), limit=limit)


def _find_share(before: Stats, after: Stats) -> float:
    """Find the share of the states of all pools that the server took a command for."""

    def count(stats: Stats) -> tuple[int, int]:
        listed = stats.agent_commands.values()
        return sum(one.taken for one in listed), sum(one.due for one in listed)

    (taken_before, due_before), (taken, due) = count(before), count(after)
    return (taken - taken_before) / max(due - due_before, 1)


def _make_scan_figure(label: str, case: Case, seen: Seen) -> Figure:
    """Make a figure of the rate of each lidar; 0 for those without a scan."""
    rates = [seen.window.rate_hz(times_s) for times_s in seen.scans.values()]
    rates += [0.0] * (case.lidars - len(rates))
    limit = Limit("min", ">=", LEAST_SCAN_HZ, is_timed=True)
    what = f"{label}: scans of each lidar of {SCAN_HZ:g} due"
    return Figure(what=what, unit="Hz", samples=tuple(rates), limit=limit)


def _odometry_figures(label: str, case: Case, seen: Seen) -> Iterator[Figure]:
    if not seen.arrivals:
        return
    rates = [seen.window.rate_hz(times_s) for times_s in seen.arrivals.values()]
    gaps_ms = _find_gaps_ms(seen)
    limit = Limit("min", ">=", case.odom_hz, is_timed=True)
    what = f"{label}: odometry of each subscribed robot"
    yield Figure(what=what, unit="Hz", samples=tuple(rates), limit=limit)
    limit = Limit("max", "<=", 150.0)
    yield Figure(what=f"{label}: longest gap", unit="ms", samples=gaps_ms, limit=limit)


def _find_gaps_ms(seen: Seen) -> tuple[float, ...]:
    """Find the longest gap in the odometry of each subscribed robot."""
    longest_s = map(seen.window.longest_gap_s, seen.arrivals.values())
    return tuple(MILLISECONDS * one for one in longest_s)


def _watch_tokens(
    label: str, bus: Bus, users: Users, robots: int, quiet_s: float
) -> Iterator[Figure]:
    """Join late, and watch the tokens of all robots that are announced."""
    least = TOKENS_OF_ROBOT * POOLS * min(MAX_ROBOTS_ANNOUNCED, robots // POOLS)
    meanwhile, began_s = Seen(), time.monotonic()
    # The join blocks its thread, and arrivals are noted during it.
    with ThreadPoolExecutor(1) as executor:
        joining = executor.submit(_join_late, bus.endpoint, quiet_s)
        while not joining.done():
            users.take(meanwhile)
            time.sleep(POLL_S)
    meanwhile.window = ArrivalWindow(began_s, time.monotonic())
    count, seen_s = joining.result()
    asked, most = Limit("min", ">=", least), Limit("max", "<=", 10.0)
    yield Figure(what=f"{label}: tokens", unit="", samples=(count,), limit=asked)
    yield Figure(what=f"{label}: tokens seen, late", unit="s", samples=(seen_s,), limit=most)
    what = f"{label}: longest gap while the observer of tokens joins"
    yield Figure(what=what, unit="ms", samples=_find_gaps_ms(meanwhile))
    first_s, announced_s = _echo(bus.endpoint, f"box_bot{robots - 1}")
    most = Limit("max", "<=", LONGEST_ECHO_S)
    what = f"{label}: first odometry of the last robot on its key of ROS 2"
    yield Figure(what=what, unit="s", samples=(first_s,), limit=most)
    what = f"{label}: the last robot in the graph"
    yield Figure(what=what, unit="s", samples=(announced_s,))


@dataclass
class RunningHz:
    """`zensim hz` of the odometry of all robots, and the events of the server since its start."""

    process: "subprocess.Popen[str]"
    events: BusSubscription
    stack: ExitStack


def _start_hz(bus: Bus) -> RunningHz:
    stack, events = ExitStack(), bus.subscribe(EVENTS.key("default"), EVENTS_DEPTH)
    arguments = ("hz", ODOM.key("*"), "--connect", bus.endpoint, "--json", "--window", "20000")
    return RunningHz(stack.enter_context(running(*arguments)), events, stack)


def _watch_wildcard(label: str, bus: Bus, hz: RunningHz, seconds: float) -> Iterator[Figure]:
    """Read what `zensim hz` has seen; then run `zensim echo` for as long, without reading it."""
    with hz.stack:
        lines = [line_with("{", hz.process)]
        kib = read_memory_kib(hz.process.pid)
        hz.process.terminate()
        assert hz.process.stdout is not None
        lines += hz.process.stdout
        rates = [msgspec.json.decode(line)["rate_hz"] for line in lines]
    kinds = [decode(Event, one.payload, one.encoding).kind for one in hz.events.take()]
    with running("echo", ODOM.key("*"), "--connect", bus.endpoint) as echo:
        time.sleep(seconds)
        echo_kib = read_memory_kib(echo.pid)
    bound = Limit("max", "<=", POOLS * WILDCARD_MESSAGES_HZ * 1.1, is_timed=True)
    what = f"{label}: messages, zensim hz"
    yield Figure(what=what, unit="1/s", samples=tuple(rates), limit=bound)
    least = Limit("min", ">=", POOLS, is_timed=True)
    what, warned = f"{label}: events of a pool that withholds", kinds.count("warning")
    yield Figure(what=what, unit="", samples=(warned,), limit=least)
    most = Limit("max", "<=", MOST_READER_MB, is_timed=True)
    for name, used_kib in (("zensim hz", kib), ("zensim echo, not read", echo_kib)):
        megabytes = (used_kib * KIB / MEGABYTE,)
        yield Figure(what=f"{label}: memory, {name}", unit="MB", samples=megabytes, limit=most)


def _echo(endpoint: str, name: str) -> tuple[float, float]:
    """Subscribe to the odometry of a robot as a node of ROS 2 that knows its type.

    Returns:
        Times [s] until the first message, and until the topic is in the graph.
    """
    key = make_data_key(0, ODOM.key(name), Odometry.ros_type, hash_type(Odometry))
    with connected(endpoint) as node:
        began_s, odometry = time.monotonic(), node.subscribe(key, ODOM_DEPTH)
        poll_until(lambda: odometry.take() or None, PATIENCE_S)
        first_s = time.monotonic() - began_s
        token = f"@ros2_lv/0/*/*/*/MP/*/*/*/%{name}%{ODOM.suffix}/**"
        poll_until(lambda: node.list_tokens(token) or None, PATIENCE_S)
        return first_s, time.monotonic() - began_s


def _join_late(endpoint: str, quiet_s: float) -> tuple[int, float]:
    """Join, and watch tokens until none came for some time.

    Returns:
        Their number, and the time from the beginning until the last one [s].
    """
    began_s = changed_s = time.monotonic()
    with connected(endpoint) as observer:
        watch, tokens = observer.watch_tokens("@ros2_lv/0/**", TOKENS_DEPTH), set[str]()
        # The first token may take longer than the pauses between the others.
        while (now_s := time.monotonic()) < changed_s + (quiet_s if tokens else PATIENCE_S):
            for token, is_alive in watch.take():
                (tokens.add if is_alive else tokens.discard)(token)
                changed_s = now_s
            time.sleep(POLL_S)
        watch.close()
    return len(tokens), (changed_s if tokens else now_s) - began_s


def _measure_bare_tokens(robots: int, quiet_s: float) -> Iterator[Figure]:
    """Declare the tokens of robots without anything else, and join late."""
    endpoint = free_endpoint()
    with ExitStack() as stack:
        router = stack.enter_context(running("router", "--listen", endpoint))
        stack.enter_context(connected(endpoint, router))
        before_kib = read_memory_kib(router.pid)
        process = stack.enter_context(program("bare_tokens", endpoint, str(robots)))
        declared = msgspec.json.decode(line_with("{", process), type=DeclaredTokens)
        router_kib = (read_memory_kib(router.pid) - before_kib) / robots
        count, seen_s = _join_late(endpoint, quiet_s)
    label = f"floor: {declared.count} bare tokens of {robots} robots"
    yield Figure(what=f"{label}: tokens seen", unit="", samples=(count,))
    yield Figure(what=f"{label}: seen, late", unit="s", samples=(seen_s,))
    yield Figure(what=f"{label}: memory of a robot, router", unit="KiB", samples=(router_kib,))
    own_kib = declared.kib / robots
    yield Figure(what=f"{label}: memory of a robot, session", unit="KiB", samples=(own_kib,))


def _measure_bare_fleet(robots: int, seconds: float) -> Iterator[Figure]:
    """Exchange the messages of a fleet without computing anything."""
    endpoint, pids = free_endpoint(), {}
    with ExitStack() as stack:
        for name, arguments in {
            "server": ("server", endpoint, str(robots)),
            **{f"pool {n + 1}": ("pool", endpoint, str(robots), str(n)) for n in range(POOLS)},
        }.items():
            process = stack.enter_context(program("bare_fleet", *arguments))
            line_with("ready", process)
            pids[name] = process.pid
        line_with(BEGINNING, stack.enter_context(program("fleet_commander", endpoint, str(robots))))
        time.sleep(SETTLE_WHEN_SHORT_S)
        windows = [_use_cores(pids, seconds) for _ in range(BARE_FLEET_WINDOWS)]
    label = f"floor: messages of {robots} robots alone, CPU"
    totals = tuple(sum(window.values()) for window in windows)
    yield Figure(what=f"{label} of all", unit="cores", samples=totals)
    for name in pids:
        samples = tuple(window[name] for window in windows)
        yield Figure(what=f"{label}, {name}", unit="cores", samples=samples)


def _use_cores(pids: dict[str, int], seconds: float) -> dict[str, float]:
    """Find the cores that processes use in the next seconds."""
    before_s, began_s = {name: used_s(pid) for name, pid in pids.items()}, time.monotonic()
    time.sleep(seconds)
    passed_s = time.monotonic() - began_s
    return {name: (used_s(pid) - before_s[name]) / passed_s for name, pid in pids.items()}


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
