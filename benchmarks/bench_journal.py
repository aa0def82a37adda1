"""Journal

The same spawns and deletes at random moments while ten robots drive circles, without a journal and
with one; then the server is killed and restarted on a journal of a hundred robots. Floor of a reply
that waits for the disk: writing and syncing as many bytes as a spawn has, in this process.
"""

import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.bench_spawn import LONGEST_PAUSE_S, Spawner, an_order
from benchmarks.figures import Figure, Limit, table
from benchmarks.ten_robots import (
    MILLISECONDS,
    ROBOTS,
    ROBOTS_WHEN_SHORT,
    fleet,
    latest_steps,
    observe,
    stats_of,
)
from tests.integration.journals import kill_hard, serving_with_journal
from tests.integration.processes import START_S, connected, free_endpoint, running
from zensim.spawner.client.sim_client import SimClient

__all__ = ["rows", "table"]

SPAWNS, SPAWNS_WHEN_SHORT = 100, 5
KEPT, KEPT_WHEN_SHORT = 100, 3
STARTS, STARTS_WHEN_SHORT = 10, 1
SYNCED_BYTES = 64 * 1024


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure replies and steps with and without a journal, and restarts."""
    with tempfile.TemporaryDirectory() as folder:
        kept = ("--journal", f"{folder}/driven")
        for what, arguments in (("without journal", ()), ("with journal", kept)):
            yield from _driven(what, arguments, is_short=is_short)
        yield Figure(
            what="floor: write and sync 64 KiB",
            unit="ms",
            samples=tuple(_sync_ms(Path(folder) / "floor") for _ in range(SPAWNS)),
        )
        yield from _starts(Path(folder) / "kept", is_short=is_short)


def _driven(what: str, arguments: Sequence[str], *, is_short: bool) -> Iterator[Figure]:
    count = SPAWNS_WHEN_SHORT if is_short else SPAWNS
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS, *arguments) as found:
        found.circle()
        spawner, stats = Spawner(found.server.client), stats_of(found)
        quiet = observe(stats, lambda: time.sleep(count * LONGEST_PAUSE_S))
        busy = observe(stats, lambda: spawner.work(count))
    yield Figure(
        what=f"spawn request to reply, {what}",
        unit="ms",
        samples=tuple(spawner.spawn_ms),
        limit=Limit("p99", "<=", 50.0),
    )
    yield Figure(
        what=f"delete request to reply, {what}", unit="ms", samples=tuple(spawner.delete_ms)
    )
    yield latest_steps(f"{what}, no spawns", quiet)
    yield latest_steps(f"{what}, with spawns", busy, Limit("max", "<=", 20.0))


def _sync_ms(path: Path) -> float:
    with path.open("ab", buffering=0) as file:
        start_s = time.perf_counter()
        file.write(bytes(SYNCED_BYTES))
        os.fdatasync(file.fileno())
        return (time.perf_counter() - start_s) * MILLISECONDS


def _starts(folder: Path, *, is_short: bool) -> Iterator[Figure]:
    endpoint, count = free_endpoint(), KEPT_WHEN_SHORT if is_short else KEPT
    with serving_with_journal(folder, endpoint) as server:
        for number in range(count):
            server.client.spawn(an_order(number))
        kill_hard(server)
    times = STARTS_WHEN_SHORT if is_short else STARTS
    yield Figure(
        what=f"exec to the first list of {count} robots, after a kill",
        unit="s",
        samples=tuple(_first_list_s(folder, endpoint) for _ in range(times)),
        limit=Limit("max", "<=", 3.0),
    )


def _first_list_s(folder: Path, endpoint: str) -> float:
    start_s = time.monotonic()
    with (
        running("serve", "--listen", endpoint, "--journal", str(folder)) as process,
        connected(endpoint, process) as bus,
    ):
        client = SimClient(bus)
        client.wait_for_server(START_S)
        client.entities()
        took_s = time.monotonic() - start_s
        process.kill()
        process.wait()
    return took_s
