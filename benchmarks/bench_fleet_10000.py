"""Fleets: ten thousand robots

A server, which is its own router, with 10,000 kinematic box_bots; two pools drive them, and another
process commands each robot once a second. Steps and control are at 20 Hz unless told otherwise.
Drive commands are the steps that the server took a command for, of those whose state a pool got: it
counts both, and each sample is its second, scaled to pools times the control rate. A pool that is
too slow shows there, while the real-time factor stays at 1. Cores are those of server and pools,
without the commanding process. Odometry is subscribed robot by robot, and counted over the whole
window of the seconds.
"""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

from benchmarks.bench_overview import CLAIMED_WITHIN_S, ask
from benchmarks.figures import Figure, table
from benchmarks.fleet_commander import BEGINNING
from benchmarks.fleet_server import line_with, program
from benchmarks.installation import Installation, run_installation
from benchmarks.ten_robots import POLL_S, poll_until, spawn
from tests.integration.processes import eventually
from zensim.proto.bus.bus_session import BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.ros2.rmw_keys import OFF
from zensim.proto.topic_catalog import ODOM, STATS

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 10_000, 20
POOLS = 2
SECONDS, SECONDS_WHEN_SHORT = 60.0, 1.0
SETTLE_S, SETTLE_WHEN_SHORT_S = 5.0, 0.5
"""Time from the first command of all robots to the first second that counts."""
STATS_DEPTH, ODOM_DEPTH = 64, 4096


@dataclass(frozen=True)
class Case:
    """What is asked of a fleet."""

    label: str
    hz: float = 20.0
    listened: int = 0
    """Robots whose odometry is subscribed all the time."""
    domain: str = OFF


CASES = (
    Case("no subscribers"),
    Case("ten subscribers", listened=10),
    Case("ten subscribers, 50 Hz", hz=50.0, listened=10),
    Case("ROS 2, ten subscribers", listened=10, domain="0"),
)


@dataclass(frozen=True)
class Seen:
    """What was measured."""

    stats: list[Stats]
    odom_hz: tuple[float, ...]
    """Rates of each subscribed robot."""
    cores: Mapping[str, float]


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure each case."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    for case in CASES[-1:] if is_short else CASES:
        seen = _run(case, robots, is_short=is_short)
        yield from _figures(f"{robots} robots, {case.label}", case, seen)


def _run(case: Case, robots: int, *, is_short: bool) -> Seen:
    ros = ("--ros-domain", case.domain)
    rates = ("--step-hz", f"{case.hz:g}", "--control-hz", f"{case.hz:g}")
    serve = ("--dynamics", "kinematic", *rates, *ros)
    with run_installation(serve, (("--pool", "0", *ros),) * POOLS, has_router=False) as crew:
        spawn(crew.client, robots)
        eventually(lambda: ask(crew).claimed == robots, CLAIMED_WITHIN_S, "claiming")
        with program("fleet_commander", crew.bus.endpoint, str(robots)) as commander:
            line_with(BEGINNING, commander)
            eventually(lambda: ask(crew).driven == robots, CLAIMED_WITHIN_S, "driving")
            names = [f"box_bot{number * robots // 10}" for number in range(case.listened)]
            odometry = [crew.bus.subscribe(ODOM.key(name), ODOM_DEPTH) for name in names]
            time.sleep(SETTLE_WHEN_SHORT_S if is_short else SETTLE_S)
            return _observe(crew, odometry, SECONDS_WHEN_SHORT if is_short else SECONDS)


def _observe(crew: Installation, odometry: list[BusSubscription], seconds: float) -> Seen:
    """Keep statistics and count odometry, until the first second after this time [s] is over."""
    stats = crew.bus.subscribe(STATS.key("default"), STATS_DEPTH)
    poll_until(stats.newest)
    found, counts = list[Stats](), [0] * len(odometry)
    for one in odometry:
        one.take()
    used_s, began_s = crew.used_s(), time.monotonic()
    while time.monotonic() < began_s + seconds or len(found) < 2:
        found += [decode(Stats, sample.payload, sample.encoding) for sample in stats.take()]
        counts = [count + len(one.take()) for count, one in zip(counts, odometry, strict=True)]
        time.sleep(POLL_S)
    passed_s = time.monotonic() - began_s
    cores = {name: (now_s - used_s[name]) / passed_s for name, now_s in crew.used_s().items()}
    return Seen(found, tuple(count / passed_s for count in counts), cores)


def _figures(label: str, case: Case, seen: Seen) -> Iterator[Figure]:
    first, last = seen.stats[0], seen.stats[-1]
    factor = (last.sim_time_s - first.sim_time_s) / (last.usage.wall_s - first.usage.wall_s)
    yield Figure(what=f"{label}: real-time factor", unit="", samples=(factor,))
    due_hz = POOLS * case.hz
    commands = tuple(due_hz * _find_share(*span) for span in pairwise(seen.stats))
    yield Figure(what=f"{label}: drive commands of {due_hz:g} due", unit="1/s", samples=commands)
    dropped = (last.dropped - first.dropped,)
    yield Figure(what=f"{label}: commands dropped", unit="", samples=dropped)
    if seen.odom_hz:
        what = f"{label}: odometry of each subscribed robot"
        yield Figure(what=what, unit="Hz", samples=seen.odom_hz)
    for name, cores in {"of all": sum(seen.cores.values()), **seen.cores}.items():
        what = f"{label}: CPU{' ' if name == 'of all' else ', '}{name}"
        yield Figure(what=what, unit="cores", samples=(cores,))


def _find_share(before: Stats, after: Stats) -> float:
    """Find the share of the states of all pools that the server took a command for."""

    def count(stats: Stats) -> tuple[int, int]:
        listed = stats.agent_commands.values()
        return sum(one.taken for one in listed), sum(one.due for one in listed)

    (taken_before, due_before), (taken, due) = count(before), count(after)
    return (taken - taken_before) / max(due - due_before, 1)
