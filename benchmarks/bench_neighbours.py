"""Noisy neighbours

Ten robots drive circles at 240 Hz while one other client loads the server, with plain Zenoh calls
and without a name; three of them where the table says so. Real-time factor and latest step are
those of each second. `info` is called by a client of its own at random moments. The gap is the
longest time without odometry of one robot at 80 Hz. Memory is that of the server's process, above
that before the load, at its most and 5 s after the load. Floors are the same loads on a router that
the simulation does not use: what their client and its router take of this machine alone.
"""

import random
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import pairwise

import msgspec
import psutil

from benchmarks.figures import Figure, Limit, Statistic, written
from benchmarks.fleet_server import line_with, program
from benchmarks.hostile_client import LOADS
from benchmarks.ten_robots import (
    MILLISECONDS,
    POLL_S,
    ROBOTS,
    ROBOTS_WHEN_SHORT,
    Fleet,
    fleet,
    milliseconds,
    observe_in_turns,
    stats_of,
)
from benchmarks.timing import quantile
from tests.integration.processes import free_endpoint
from zensim.proto.bus import Bus, BusSubscription, NoServer
from zensim.proto.topic_catalog import ODOM
from zensim.spawner.client.sim_client import SimClient

__all__ = ["rows", "table"]

LOAD_S, LOAD_WHEN_SHORT_S = 10.0, 0.3
RECOVERY_S, RECOVERY_WHEN_SHORT_S = 5.0, 0.1
SHORT_LOADS = ("stopped with 2000 unread get_models",)
THREE = "three clients "
STOPPED = "stopped with 2000 unread get_models"
FLOOR = "floor: "
FLOORS = (
    "10,000 get_entities a second, unread",
    "10,000 malformed twists a second to all",
    "2000 sessions",
)
"""Loads that are measured on another router, too."""
UNDISTURBED = "undisturbed"
LONGEST_PAUSE_S = 0.02
SEED = 17
MEBIBYTE = 1 << 20
LEAST_FACTOR = 0.95
MOST_LATE_MS = 50.0
MOST_GAP_MS = 200.0
MOST_TIMES = 2.0
MOST_MIB = 50.0
HEAD = (
    "load",
    "factor mean / min",
    "latest step [ms]",
    "info p50 / p99 / max [ms]",
    "times p99 undisturbed",
    "longest gap of odometry [ms]",
    "memory most / kept [MiB]",
)


class Witness:
    """A client that calls `info` and receives odometry while others load the server."""

    def __init__(self, found: Fleet) -> None:
        self.info_ms: list[float] = []
        self.most_bytes = 0
        self.odometry_s: list[float] = []
        self._found = found
        self._process = psutil.Process(found.server.process.pid)
        self._is_over = threading.Event()

    def memory(self) -> int:
        """Read the server's resident memory [B]."""
        return int(self._process.memory_info().rss)

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Call, receive and measure while the block runs."""
        threads = [threading.Thread(target=one) for one in (self._call, self._receive)]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self._is_over.set()
            for thread in threads:
                thread.join()

    def _call(self) -> None:
        pause = random.Random(SEED)
        with self._found.server.bus.open_session() as bus:
            client = SimClient(bus, timeout_s=60.0)
            while not self._is_over.wait(pause.uniform(0.0, LONGEST_PAUSE_S)):
                self.info_ms.append(milliseconds(partial(_call_info, client)))
                self.most_bytes = max(self.most_bytes, self.memory())

    def _receive(self) -> None:
        with self._found.server.bus.open_session() as bus:
            odometry = receive_odometry(bus)
            while not self._is_over.wait(POLL_S):
                if odometry.take():
                    self.odometry_s.append(time.perf_counter())


def _call_info(client: SimClient) -> None:
    """Call `info`; a call without a reply counts by its timeout."""
    with suppress(TimeoutError, NoServer):
        client.info()


def receive_odometry(bus: Bus) -> BusSubscription:
    """Subscribe to the odometry of a robot that no load commands."""
    return bus.subscribe(ODOM.key("box_bot1"), 1024)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure each load between two undisturbed times."""
    loads = SHORT_LOADS if is_short else (*LOADS, THREE + STOPPED)
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found:
        found.circle()
        quiet = list(measure(found, UNDISTURBED, is_short=is_short))
        yield from quiet
        p99_ms = find_info_p99(quiet)
        for load in loads:
            yield from measure(found, load, is_short=is_short, p99_ms=p99_ms)
        yield from measure_floors(found, is_short=is_short)


def measure_floors(found: Fleet, *, is_short: bool) -> Iterator[Figure]:
    """Measure loads on a router that the simulation does not use."""
    endpoint = free_endpoint()
    with program("idle_router", endpoint) as process:
        line_with("listening", process)
        for load in FLOORS[:1] if is_short else FLOORS:
            for figure in measure(found, load, is_short=is_short, address=endpoint):
                yield msgspec.structs.replace(figure, what=FLOOR + figure.what)


def find_info_p99(quiet: Iterable[Figure]) -> float:
    """Find the 99th percentile of `info` [ms] among the figures of an undisturbed time."""
    return next(one for one in quiet if one.what.endswith("info")).value("p99")


def measure(
    found: Fleet, load: str, *, is_short: bool, p99_ms: float | None = None, address: str = ""
) -> Iterator[Figure]:
    """Measure one load; with `p99_ms` of an undisturbed time, against the limits.

    Args:
        found: Robots that drive.
        load: One of `LOADS`, behind 'three clients ' for three of them, or `UNDISTURBED`.
        is_short: Whether it lasts some tenths of a second only.
        p99_ms: Of `info`, undisturbed.
        address: Of the clients that load; empty = the endpoint of the server.
    """
    address = address or found.server.endpoint
    load_s = LOAD_WHEN_SHORT_S if is_short else LOAD_S
    recovery_s = RECOVERY_WHEN_SHORT_S if is_short else RECOVERY_S
    witness = Witness(found)
    before = witness.memory()

    with witness.watching():
        (seen,) = observe_in_turns(stats_of(found), [partial(_disturb, load, address, load_s)])
    time.sleep(recovery_s)
    samples = {
        "factor": [one.real_time_factor for one in seen],
        "late": [one.late_max_s * MILLISECONDS for one in seen],
        "info": witness.info_ms,
        "gap": [(b - a) * MILLISECONDS for a, b in pairwise(witness.odometry_s)],
        "memory": [(max(witness.most_bytes, before) - before) / MEBIBYTE],
        "kept": [(witness.memory() - before) / MEBIBYTE],
    }
    for quantity, found_samples in samples.items():
        limit = None if p99_ms is None else _limit(quantity, p99_ms)
        yield Figure(what=f"{load}: {quantity}", unit="", samples=(*found_samples,), limit=limit)


def _disturb(load: str, address: str, load_s: float) -> None:
    """Run the clients of a load for some time."""
    clients = 0 if load == UNDISTURBED else 3 if load.startswith(THREE) else 1
    with ExitStack() as stack:
        for _ in range(clients):
            process = stack.enter_context(
                program("hostile_client", load.removeprefix(THREE), address)
            )
            stack.callback(process.kill)  # a process that is stopped takes no other signal
            line_with("connected", process)
        time.sleep(load_s)


def _limit(quantity: str, p99_ms: float) -> Limit:
    limits = {
        "factor": Limit("mean", ">=", LEAST_FACTOR, is_timed=True),
        "late": Limit("max", "<=", MOST_LATE_MS, is_timed=True),
        "info": Limit("p99", "<=", MOST_TIMES * p99_ms, is_timed=True),
        "gap": Limit("max", "<=", MOST_GAP_MS, is_timed=True),
    }
    return limits.get(quantity, Limit("max", "<=", MOST_MIB, is_timed=True))


def table(figures: Iterable[Figure]) -> str:
    """Format one row for each load."""
    loads: dict[str, dict[str, Figure]] = {}
    for figure in figures:
        load, _, quantity = figure.what.rpartition(": ")
        loads.setdefault(load, {})[quantity] = figure
    quiet_p99 = loads[UNDISTURBED]["info"].value("p99")
    lines = [f"| {' | '.join(HEAD)} |", f"|{'---|' * len(HEAD)}"]
    lines += [f"| {' | '.join(_cells(load, one, quiet_p99))} |" for load, one in loads.items()]
    return "\n".join(lines) + "\n"


def _cells(load: str, found: dict[str, Figure], quiet_p99: float) -> tuple[str, ...]:
    factor, info = found["factor"], found["info"]
    times = quantile(sorted(info.samples), 0.99) / quiet_p99
    return (
        load,
        f"{factor.value('mean'):.2f} / {factor.value('min'):.2f}",
        _written(found["late"], "max"),
        " / ".join(written(info.value(one)) for one in ("median", "p99", "max")),
        f"{times:.1f}{' **missed**' if info.is_missed else ''}",
        _written(found["gap"], "max"),
        f"{_written(found['memory'], 'max')} / {_written(found['kept'], 'max')}",
    )


def _written(figure: Figure, statistic: Statistic) -> str:
    value = written(figure.value(statistic))
    return f"{value} **missed**" if figure.is_missed else value
