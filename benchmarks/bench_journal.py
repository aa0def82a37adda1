"""Journal

The same spawns and deletes at random moments while ten robots drive circles, without a journal and
with one; then the server is killed and restarted on a journal of a hundred robots. Floor of a reply
that waits for the disk: writing and syncing as many bytes as a spawn has, in this process. Last:
the same restarts with 2000 and 10,000 robots, on an idle machine and with a process that does
nothing but count on each core; from exec until a call of `info` has a reply, which is "restoring"
with the number of robots so far, and until it is another. Floors: a server on an empty journal, and
half of the bodies made in cells of PyBullet, as each of two processes does in a restore.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from benchmarks.bench_spawn import LONGEST_PAUSE_S, Spawner, an_order
from benchmarks.figures import Figure, table
from benchmarks.ten_robots import (
    MILLISECONDS,
    ROBOTS,
    ROBOTS_WHEN_SHORT,
    fleet,
    latest_steps,
    observe,
    spawn,
    stats_of,
)
from tests.integration.journals import kill_hard, serving_with_journal
from tests.integration.processes import START_S, connected, free_endpoint, running
from zensim.proto.bus.bus_errors import NoServer
from zensim.spawner.client.sim_client import SimClient

__all__ = ["rows", "table"]

SPAWNS, SPAWNS_WHEN_SHORT = 100, 5
KEPT = 100
STARTS, STARTS_WHEN_SHORT = 10, 1
SYNCED_BYTES = 64 * 1024
LARGE, LARGE_WHEN_SHORT = (2000, 10_000), (20,)
"""Numbers of robots."""
LARGE_STARTS = 3
POLL_S = 0.005
COUNTING = "while True: pass"
STEP_NS = 4_166_667


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure replies and steps with and without a journal, and restarts."""
    with tempfile.TemporaryDirectory() as folder:
        kept = ("--journal", f"{folder}/driven")
        without: tuple[tuple[str, Sequence[str]], ...] = (("without journal", ()),)
        for what, arguments in (*(() if is_short else without), ("with journal", kept)):
            yield from _driven(what, arguments, is_short=is_short)
        yield Figure(
            what="floor: write and sync 64 KiB",
            unit="ms",
            samples=tuple(
                _sync_ms(Path(folder) / "floor")
                for _ in range(SPAWNS_WHEN_SHORT if is_short else SPAWNS)
            ),
        )
        if not is_short:  # the larger ones start in the same way
            yield from _starts(Path(folder) / "kept")
        yield from _large_starts(Path(folder), is_short=is_short)


def _driven(what: str, arguments: Sequence[str], *, is_short: bool) -> Iterator[Figure]:
    count = SPAWNS_WHEN_SHORT if is_short else SPAWNS
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS, *arguments) as found:
        found.circle()
        spawner, stats = Spawner(found.server.client), stats_of(found)
        quiet = observe(stats, lambda: time.sleep(count * LONGEST_PAUSE_S))
        busy = observe(stats, lambda: spawner.work(count))
    yield Figure(what=f"spawn request to reply, {what}", unit="ms", samples=tuple(spawner.spawn_ms))
    yield Figure(
        what=f"delete request to reply, {what}", unit="ms", samples=tuple(spawner.delete_ms)
    )
    yield latest_steps(f"{what}, no spawns", quiet)
    yield latest_steps(f"{what}, with spawns", busy)


def _sync_ms(path: Path) -> float:
    with path.open("ab", buffering=0) as file:
        start_s = time.perf_counter()
        file.write(bytes(SYNCED_BYTES))
        os.fdatasync(file.fileno())
        return (time.perf_counter() - start_s) * MILLISECONDS


def _starts(folder: Path) -> Iterator[Figure]:
    endpoint, count = free_endpoint(), KEPT
    with serving_with_journal(folder, endpoint) as server:
        for number in range(count):
            server.client.spawn(an_order(number))
        kill_hard(server)
    yield Figure(
        what=f"exec to the first list of {count} robots, after a kill",
        unit="s",
        samples=tuple(_first_list_s(folder, endpoint) for _ in range(STARTS)),
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


class Restart(NamedTuple):
    """Times from the exec of a server [s]."""

    replied_s: float
    """Time to the first reply."""
    restored_s: float


def _large_starts(folder: Path, *, is_short: bool) -> Iterator[Figure]:
    starts = STARTS_WHEN_SHORT if is_short else LARGE_STARTS
    for count in LARGE_WHEN_SHORT if is_short else LARGE:
        endpoint = free_endpoint()
        kept = folder / f"of{count}"
        with serving_with_journal(kept, endpoint) as server:
            spawn(server.client, count)
            kill_hard(server)
        quiet = [_restart(kept, endpoint) for _ in range(starts)]
        with _busy_cores(1 if is_short else os.cpu_count() or 1):
            busy = [_restart(kept, endpoint) for _ in range(starts)]
        for when, found in (("idle", quiet), ("busy", busy)):
            label = f"{count} robots, {when} cores: exec to"
            yield Figure(
                what=f"{label} the first reply",
                unit="s",
                samples=tuple(one.replied_s for one in found),
            )
            yield Figure(
                what=f"{label} all restored",
                unit="s",
                samples=tuple(one.restored_s for one in found),
            )
    empty = [_restart(folder / f"empty{number}", free_endpoint()) for number in range(starts)]
    what = "floor: exec to the first reply, empty journal"
    yield Figure(what=what, unit="s", samples=tuple(one.replied_s for one in empty))


@contextmanager
def _busy_cores(count: int) -> Iterator[None]:
    """Keep so many cores busy with a process each until the block ends."""
    command = (sys.executable, "-c", COUNTING)
    counting = [subprocess.Popen(command) for _ in range(count)]
    try:
        yield
    finally:
        for process in counting:
            process.kill()
            process.wait()


def _restart(folder: Path, endpoint: str) -> Restart:
    start_s = time.monotonic()
    with (
        running("serve", "--listen", endpoint, "--journal", str(folder)) as process,
        connected(endpoint, process) as bus,
    ):
        client = SimClient(bus)
        while True:
            try:
                info = client.info()
                break
            except (NoServer, TimeoutError):
                time.sleep(POLL_S)
        replied_s = time.monotonic() - start_s
        if info.state == "restoring":
            client.wait_for_server(START_S)
        restored_s = time.monotonic() - start_s
        process.kill()
        process.wait()
    return Restart(replied_s, restored_s)
