"""Memory over half an hour

One client spawns and deletes a box_bot twice a second for half an hour. Before that it does so 2100
times without a pause, which fills the cache of 4096 responses that retries get. Memory is that of
the server's process, read every ten seconds; its growth is the slope of the line through all.
"""

import statistics
import time
from collections.abc import Iterator

import psutil

from benchmarks.figures import Figure, Limit
from tests.integration.processes import Server, serving
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder

WARM_UP_ROUNDS, WARM_UP_ROUNDS_WHEN_SHORT = 2100, 200
SOAK_S, SOAK_WHEN_SHORT_S = 1800.0, 3.0
ROUND_S, READ_EVERY_S = 0.5, 10.0
HOUR_S = 3600.0
MEGABYTE = 1e6
ORDER = SpawnEntityOrder(name="r1", entity_resource=Resource(uri="box_bot"))


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
