"""Memory over half an hour

One client spawns and deletes a box_bot twice a second for half an hour. Before that it does so 2100
times without a pause, which fills the cache of 4096 responses that retries get. Memory is that of
the server's process, read every ten seconds; its growth is the slope of the line through all.

Then robots come and go as fast as possible, each kind on a server of its own: with new names or the
same one, with a lidar or without sensors, with a subscriber that waits for a scan of each, with ROS
2 or without, and driven by a pool whose odometry is awaited, beside a page with a visitor. The
growth of each process is the slope over the cycles after the first third, which fill caches.
"""

import os
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass

import psutil

from benchmarks.figures import Figure, Limit
from tests.integration.page_user import PageUser
from tests.integration.processes import START_S, Server, eventually, running, serving
from tests.integration.sensor_runs import lidar_bot, running_sensors
from tests.integration.test_view import viewing
from zensim.proto.bus.bus_session import BusSubscription
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.topic_catalog import ODOM, SCAN, TopicSpec

WARM_UP_ROUNDS, WARM_UP_ROUNDS_WHEN_SHORT = 2100, 200
SOAK_S, SOAK_WHEN_SHORT_S = 1800.0, 3.0
ROUND_S, READ_EVERY_S = 0.5, 10.0
HOUR_S = 3600.0
MEGABYTE = 1e6
ORDER = SpawnEntityOrder(name="r1", entity_resource=Resource(uri="box_bot"))
CYCLES, CYCLES_WHEN_SHORT = 10_000, 12
CYCLES_VARIABLE = "ZENSIM_SOAK_CYCLES"
"""Fewer cycles of each kind, for a look."""
READINGS = 60
WARM_SHARE = 1 / 3
DEPTH = 100
KILOBYTE = 1e3


@dataclass(frozen=True)
class SoakKind:
    """How robots come and go.

    Attributes:
        has_new_names: Whether each has a name of its own.
        has_sensors: Whether each has a lidar, and there is a sensor process.
        awaited: Topic whose first message is awaited before a robot is deleted.
        is_driven: Whether there is a pool of agents.
        has_ros: Whether there are ROS 2 keys and tokens.
        has_page: Whether a page follows the world for a visitor.
    """

    has_new_names: bool
    has_sensors: bool = False
    awaited: TopicSpec | None = None
    is_driven: bool = False
    has_ros: bool = True
    has_page: bool = False

    def __str__(self) -> str:
        """Describe it."""
        words = ["new names" if self.has_new_names else "one name"]
        words += ["lidar"] * self.has_sensors + ["pool"] * self.is_driven
        words += ["page"] * self.has_page
        words += [f"subscriber of {self.awaited.suffix}"] if self.awaited is not None else []
        return ", ".join([*words, "ROS 2" if self.has_ros else "no ROS 2"])


KINDS = tuple(
    kind
    for has_new_names in (True, False)
    for kind in (
        SoakKind(has_new_names),
        SoakKind(has_new_names, has_ros=False),
        SoakKind(has_new_names, has_sensors=True),
        SoakKind(has_new_names, has_sensors=True, awaited=SCAN),
        SoakKind(has_new_names, has_sensors=True, awaited=SCAN, has_ros=False),
        SoakKind(has_new_names, is_driven=True, awaited=ODOM, has_page=True),
    )
)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Spawn and delete at a steady rate, and measure the memory of the server."""
    with serving() as server:
        memory = psutil.Process(server.process.pid)
        before_mb = _read_mb(memory)
        for _ in range(WARM_UP_ROUNDS_WHEN_SHORT if is_short else WARM_UP_ROUNDS):
            _spawn_and_delete(server)
        warm_mb = _read_mb(memory)
        read = _soak(server, memory, SOAK_WHEN_SHORT_S if is_short else SOAK_S)
    yield Figure(
        what="growth in the rounds before",
        unit="MB",
        samples=(warm_mb - before_mb,),
        limit=Limit("max", "<=", 10.0),
    )
    yield Figure(
        what="growth in an hour",
        unit="MB",
        samples=(find_slope(read) * HOUR_S,),
        # Within seconds, one block of the allocator is worth hundreds of megabytes an hour.
        limit=None if is_short else Limit("max", "<=", 2.0),
    )
    yield Figure(
        what="growth from the first to the last reading",
        unit="MB",
        samples=(read[-1][1] - read[0][1],),
        limit=Limit("max", "<=", 1.5),
    )
    cycles = int(os.environ.get(CYCLES_VARIABLE, CYCLES))
    for kind in KINDS:
        yield from _soak_kind(kind, CYCLES_WHEN_SHORT if is_short else cycles, is_short=is_short)


def _soak_kind(kind: SoakKind, cycles: int, *, is_short: bool) -> Iterator[Figure]:
    """Let robots of a kind come and go, and measure each process."""
    with ExitStack() as stack:
        ros = ("--ros-domain", "0" if kind.has_ros else "off")
        server = stack.enter_context(serving(*ros))
        programs = {"server": server.process.pid}
        if kind.has_sensors:
            programs["sensors"] = stack.enter_context(running_sensors(server, "s", options=ros))[
                0
            ].pid
        if kind.is_driven:
            # Nobody reads its log: two lines for each robot would fill the pipe after 386.
            pool = ("agent", "--pool", "0", "--quiet", *ros, "--connect", server.endpoint)
            programs["pool"] = stack.enter_context(running(*pool)).pid
        if kind.has_page:
            url, page = stack.enter_context(viewing(server.endpoint))
            stack.enter_context(closing(PageUser(url)))
            programs["page"] = page.pid
        read = _cycle(server, kind, cycles, programs)
    for program, points in read.items():
        slope_b = find_slope([one for one in points if one[0] >= WARM_SHARE * cycles])
        yield Figure(
            what=f"growth of the {program} a cycle: {kind}",
            unit="kB",
            samples=(slope_b / KILOBYTE,),
            limit=None if is_short else Limit("max", "<=", 0.5),
        )


def _cycle(
    server: Server, kind: SoakKind, cycles: int, programs: dict[str, int]
) -> dict[str, list[tuple[float, float]]]:
    """Spawn and delete; return cycles and memory [bytes] of each program."""
    read: dict[str, list[tuple[float, float]]] = {program: [] for program in programs}
    topic = kind.awaited
    messages = server.bus.subscribe(topic.key("*"), DEPTH) if topic is not None else None
    model = Resource(resource_string=lidar_bot()) if kind.has_sensors else ORDER.entity_resource
    for cycle in range(cycles):
        name = f"r{cycle}" if kind.has_new_names else "r0"
        order = SpawnEntityOrder(name=name, entity_namespace=name, entity_resource=model)
        server.client.spawn(order)
        if messages is not None and topic is not None:
            eventually(_find(messages, topic.key(name)), START_S, f"a message of {name}")
        server.client.delete(name)
        if cycle % max(1, cycles // READINGS) == 0:
            for program, pid in programs.items():
                read[program].append((float(cycle), float(psutil.Process(pid).memory_info().rss)))
    return read


def _find(messages: BusSubscription, key: str) -> Callable[[], bool]:
    return lambda: any(one.key == key for one in messages.take())


def _soak(server: Server, memory: psutil.Process, duration_s: float) -> list[tuple[float, float]]:
    """Spawn and delete for some time; return times [s] and memory [MB]."""
    begin_s = due_s = time.monotonic()
    read = [(0.0, _read_mb(memory))]
    while (elapsed_s := time.monotonic() - begin_s) < duration_s:
        if elapsed_s - read[-1][0] >= READ_EVERY_S:
            read.append((elapsed_s, _read_mb(memory)))
        _spawn_and_delete(server)
        due_s += ROUND_S
        time.sleep(max(0.0, due_s - time.monotonic()))
    return [*read, (elapsed_s, _read_mb(memory))]


def _spawn_and_delete(server: Server) -> None:
    server.client.spawn(ORDER)
    server.client.delete(ORDER.name)


def find_slope(points: list[tuple[float, float]]) -> float:
    """Find the slope of the line nearest to points."""
    slope, _ = statistics.linear_regression(*zip(*points, strict=True))
    return float(slope)


def _read_mb(memory: psutil.Process) -> float:
    return float(memory.memory_info().rss / MEGABYTE)
