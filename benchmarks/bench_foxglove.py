"""Cost of the server for Foxglove

The process of `zensim foxglove` beside a source of odometry and transforms at 50 Hz. The client is
a program that reads all it gets. CPU is that of each second.
"""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from benchmarks.figures import Figure, Limit, table
from benchmarks.fleet_server import program
from benchmarks.machine import used_s
from benchmarks.message_source import Source, publishing
from tests.integration.processes import read_json_line, running
from zensim.proto.bus import BusConfig, open_bus
from zensim.proto.topic_catalog import ODOM

__all__ = ["rows", "table"]

ROBOTS, ROBOTS_WHEN_SHORT = 100, 3
HZ = 50.0
SECONDS, SECONDS_WHEN_SHORT = 20, 1
SETTLE_S = 3
START_S = 20.0
"""Time for a client to subscribe, while the source publishes already."""
TRANSFORMS_OF_ROBOT = 3
"""Transforms of a robot in a message of the source."""
MOST_WITHOUT_CLIENTS, MOST_TWO, MOST_ALL = 0.01, 0.05, 0.25


@dataclass(frozen=True)
class Second:
    """What a second cost, and what came."""

    cores: float
    odometry: int
    transforms: int


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure the server without a client, and with one of no, of two and of all topics."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    count = SECONDS_WHEN_SHORT if is_short else SECONDS
    what = f"{robots} robots publish"
    with _serve(robots, count) as (_, pid):
        cores = tuple(_measure_second(pid) for _ in range(count))
        yield _make_cores(f"{what}, no client", cores, MOST_WITHOUT_CLIENTS)
    clients: tuple[tuple[str, tuple[str, ...], float | None], ...] = (
        ("a client without topics", ("0",), MOST_WITHOUT_CLIENTS),
        ("a client with the odometry of two", ("2",), MOST_TWO),
        ("a client with /tf", ("0", "tf"), None),
        ("a client with /tf and all odometry", (str(robots), "tf"), MOST_ALL),
    )
    for name, wanted, most in clients[-1:] if is_short else clients:
        with _serve(robots, count) as (url, pid):
            seconds = _read(url, pid, wanted, count)
        yield _make_cores(f"{what}, {name}", tuple(one.cores for one in seconds), most)
    yield from _make_counts(what, seconds, robots)


@contextmanager
def _serve(robots: int, seconds: int) -> Iterator[tuple[str, int]]:
    with publishing(robots, HZ, seconds + SETTLE_S + START_S) as source:
        options = ("--port", "0", "--json", "--connect", source.endpoint)
        with _start_publishing(source), running("foxglove", *options) as process:
            yield str(read_json_line(process)["foxglove"]), process.pid


@contextmanager
def _start_publishing(source: Source) -> Iterator[None]:
    """Subscribe to one topic, as the source waits for a subscriber."""
    with open_bus(BusConfig(connect=(source.endpoint,))) as bus:
        subscription = bus.subscribe(ODOM.key("box_bot0"))
        source.read()
        yield
        subscription.close()


def _read(url: str, pid: int, wanted: tuple[str, ...], count: int) -> list[Second]:
    """Connect a client, and measure each second."""
    found = []
    with program("foxglove_reader", url, *wanted) as reader:
        assert reader.stdout is not None
        before_s, before_at = 0.0, time.perf_counter()
        for number in range(count + SETTLE_S):
            odometry, transforms = json.loads(reader.stdout.readline())
            used, now = used_s(pid), time.perf_counter()
            if number >= SETTLE_S:
                cores = (used - before_s) / (now - before_at)
                found.append(Second(cores, odometry, transforms))
            before_s, before_at = used, now
    return found


def _measure_second(pid: int) -> float:
    before_s, before_at = used_s(pid), time.perf_counter()
    time.sleep(1.0)
    return (used_s(pid) - before_s) / (time.perf_counter() - before_at)


def _make_counts(what: str, seconds: list[Second], robots: int) -> Iterator[Figure]:
    published = robots * HZ
    for name, samples in (
        ("odometry", tuple(one.odometry / published for one in seconds)),
        (
            "transforms",
            tuple(one.transforms / published / TRANSFORMS_OF_ROBOT for one in seconds),
        ),
    ):
        limit = Limit("median", ">=", 0.98, is_timed=True)
        yield Figure(
            what=f"{what}: {name} that came, of those published",
            unit="",
            samples=samples,
            limit=limit,
        )


def _make_cores(what: str, cores: tuple[float, ...], most: float | None) -> Figure:
    limit = None if most is None else Limit("median", "<=", most, is_timed=True)
    return Figure(what=f"{what}: CPU", unit="cores", samples=cores, limit=limit)
