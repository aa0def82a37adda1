"""Sensors

Lockstep runs of robots with noisy lidars, with one sensor process and with two of other names;
hashed are the bytes of every scan. Then the sensor process of `zensim up` is killed with SIGKILL,
and restarted by it: the time until there are scans of all robots again, and the longest gap between
the stamps of a robot's odometry meanwhile, in which everything else goes on.
"""

import signal
import time
from collections.abc import Iterator
from itertools import pairwise

from benchmarks.bench_sensors import MODEL
from benchmarks.figures import Figure, Limit
from benchmarks.up_programs import find_programs
from tests.integration.processes import START_S, eventually, kill, running_up
from tests.integration.sensor_runs import DEPTH, record_lockstep_scans
from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus, BusSubscription
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import NANOSECONDS, Odometry, ns_from_time
from zensim.proto.topic_catalog import ODOM, SCAN

PROCESSES = (("only",), ("z_first", "a_second"))
ROBOTS, ROBOTS_WHEN_SHORT = 20, 2
STEPS, STEPS_WHEN_SHORT = 2400, 120
KILLED_AMONG, KILLED_AMONG_WHEN_SHORT = 100, 2
KILLS, KILLS_WHEN_SHORT = 5, 1
ODOM_HZ = 10.0


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Compare the scans of lockstep runs, then kill sensor processes."""
    yield _find_different_runs(
        ROBOTS_WHEN_SHORT if is_short else ROBOTS, STEPS_WHEN_SHORT if is_short else STEPS
    )
    robots = KILLED_AMONG_WHEN_SHORT if is_short else KILLED_AMONG
    yield from _kill(robots, KILLS_WHEN_SHORT if is_short else KILLS)


def _find_different_runs(robots: int, steps: int) -> Figure:
    runs = [record_lockstep_scans(robots, steps, names).digests() for names in PROCESSES]
    return Figure(
        what=f"different hashes of {steps} steps of {robots} robots, one and two processes",
        unit="",
        samples=(float(len({tuple(found.items()) for found in runs})),),
        limit=Limit("max", "<=", 1.0),
    )


def _kill(robots: int, kills: int) -> Iterator[Figure]:
    count = ("--robots", str(robots), "--layout", "grid", "--agents", "pooled")
    rates = ("--odom-hz", str(ODOM_HZ), "--tf-hz", str(ODOM_HZ), "--dynamics", "auto")
    with running_up("--model", MODEL, "--no-viewer", *count, *rates) as (process, _, bus):
        odom = bus.subscribe(ODOM.key("*"), DEPTH)
        scans = bus.subscribe(SCAN.key("*"), DEPTH)
        _wait_for_all(scans, robots)
        odom.take()
        took_s = tuple(
            _kill_once(bus, scans, robots, find_programs(process)["sensors"]) for _ in range(kills)
        )
        gaps_s = _find_gaps_s(odom)
    yield Figure(
        what=f"scans of {robots} robots again after SIGKILL",
        unit="s",
        samples=took_s,
        limit=Limit("max", "<=", 3.0, is_timed=True),
    )
    yield Figure(
        what=f"longest gap of a robot's odometry meanwhile, of {ODOM_HZ:g} Hz",
        unit="s",
        samples=gaps_s,
        limit=Limit("max", "<=", 2.5 / ODOM_HZ, is_timed=True),
    )


def _kill_once(bus: Bus, scans: BusSubscription, robots: int, pids: tuple[int, ...]) -> float:
    killed_s = time.monotonic()
    for pid in pids:
        kill(pid, signal.SIGKILL)
    pattern = keys.active_sensors("default", "*")
    eventually(lambda: not bus.list_tokens(pattern), START_S, "the end of the sensor process")
    scans.take()
    _wait_for_all(scans, robots)
    return time.monotonic() - killed_s


def _wait_for_all(scans: BusSubscription, robots: int) -> None:
    heard: set[str] = set()

    def has_all() -> bool:
        heard.update(sample.key for sample in scans.take())
        return len(heard) == robots

    eventually(has_all, START_S, "scans of all robots")


def _find_gaps_s(odom: BusSubscription) -> tuple[float, ...]:
    """Find the longest gap between two stamps of each robot [s, simulation time]."""
    stamps: dict[str, list[int]] = {}
    for sample in odom.take():
        message = decode(Odometry, sample.payload, sample.encoding)
        stamps.setdefault(sample.key, []).append(ns_from_time(message.header.stamp))
    return tuple(
        max(after - before for before, after in pairwise(found)) / NANOSECONDS
        for found in stamps.values()
    )
