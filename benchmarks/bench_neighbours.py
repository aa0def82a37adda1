"""Noisy neighbours

Ten robots drive circles at 240 Hz while one other client loads the server, with plain Zenoh calls
and without a name; three of them where the table says so. Real-time factor and latest step are
those of each second. `info` is called by a client of its own at random moments. The gap is the
longest time without odometry of one robot at 80 Hz. Memory is that of the server's process, above
that before the load, at its most and 5 s after the load.
"""

import random
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from itertools import pairwise

import psutil

from benchmarks.figures import Figure, Statistic, quantile, written
from benchmarks.figures import table as format_figures
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
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus, BusSubscription
from zensim.proto.topic_catalog import ODOM
from zensim.spawner.client.sim_client import SimClient

__all__ = ["rows", "table"]

LOAD_S, LOAD_WHEN_SHORT_S = 10.0, 0.3
RECOVERY_S, RECOVERY_WHEN_SHORT_S = 5.0, 0.1
SHORT_LOADS = ("stopped with 2000 unread get_models",)
THREE = "three clients "
STOPPED = "stopped with 2000 unread get_models"
UNDISTURBED = "undisturbed"
LONGEST_PAUSE_S = 0.02
SEED = 17
MEBIBYTE = 1 << 20
WORST = "all loads"
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
    """Measure each load after an undisturbed time."""
    loads = SHORT_LOADS if is_short else (*LOADS, THREE + STOPPED)
    with fleet(ROBOTS_WHEN_SHORT if is_short else ROBOTS) as found:
        found.circle()
        yield from measure(found, UNDISTURBED, is_short=is_short)
        disturbed = [one for load in loads for one in measure(found, load, is_short=is_short)]
    yield from disturbed
    yield from find_worst(disturbed)


def find_worst(disturbed: Iterable[Figure]) -> Iterator[Figure]:
    """Find the least real-time factor and the longest gap of all loads."""
    listed = list(disturbed)
    factors = [one.value("mean") for one in listed if one.what.endswith(": factor")]
    gaps = [one.value("max") for one in listed if one.what.endswith(": gap")]
    yield Figure(what=f"{WORST}: real-time factor", unit="", samples=tuple(factors))
    yield Figure(what=f"{WORST}: longest gap of odometry", unit="ms", samples=tuple(gaps))


def measure(found: Fleet, load: str, *, is_short: bool, address: str = "") -> Iterator[Figure]:
    """Measure one load.

    Args:
        found: Robots that drive.
        load: One of `LOADS`, behind 'three clients ' for three of them, or `UNDISTURBED`.
        is_short: Whether it lasts some tenths of a second only.
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
        yield Figure(what=f"{load}: {quantity}", unit="", samples=(*found_samples,))


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


def table(figures: Iterable[Figure]) -> str:
    """Format the worst of all loads, then one row for each load."""
    listed = list(figures)
    worst = [one for one in listed if one.what.startswith(WORST)]
    loads: dict[str, dict[str, Figure]] = {}
    for figure in listed:
        load, _, quantity = figure.what.rpartition(": ")
        if load != WORST:
            loads.setdefault(load, {})[quantity] = figure
    quiet_p99 = loads[UNDISTURBED]["info"].value("p99")
    lines = [f"| {' | '.join(HEAD)} |", f"|{'---|' * len(HEAD)}"]
    lines += [f"| {' | '.join(_cells(load, one, quiet_p99))} |" for load, one in loads.items()]
    return "\n".join([format_figures(worst), *lines]) + "\n"


def _cells(load: str, found: dict[str, Figure], quiet_p99: float) -> tuple[str, ...]:
    factor, info = found["factor"], found["info"]
    return (
        load,
        f"{factor.value('mean'):.2f} / {factor.value('min'):.2f}",
        _written(found["late"], "max"),
        " / ".join(written(info.value(one)) for one in ("median", "p99", "max")),
        f"{quantile(sorted(info.samples), 0.99) / quiet_p99:.1f}",
        _written(found["gap"], "max"),
        f"{_written(found['memory'], 'max')} / {_written(found['kept'], 'max')}",
    )


def _written(figure: Figure, statistic: Statistic) -> str:
    return written(figure.value(statistic))
