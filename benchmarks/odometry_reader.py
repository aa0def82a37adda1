"""Process that reads the odometry of all robots of a world from the messages of their agents.

`python -m benchmarks.odometry_reader ENDPOINT COUNT SECONDS` waits until box_bot0 and so on have
odometry, and prints a line; then it reads for a time, and prints a JSON line.
"""

import math
import os
import sys
import time

import msgspec
import numpy as np
import numpy.typing as npt

from benchmarks.machine import used_s
from benchmarks.ten_robots import poll_until
from zensim.api.odometry_table import TABLE_DEPTH, OdometryTable
from zensim.api.world_access import TopicFeed
from zensim.proto.bus import Bus, BusConfig, BusSubscription, open_bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import FleetOdometry
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.process_limits import die_with_supervisor
from zensim.proto.topic_catalog import FLEET_ODOMETRY

WORLD = "default"
WAIT_S = 60.0
READ_PERIOD_S = 0.02
LATE_S = 0.2
"""Longest time in which the messages of the last step arrive."""


class OdometryTally(msgspec.Struct, frozen=True):
    """What was read of each robot."""

    rates_hz: tuple[float, ...]
    """Rows of each robot per second of simulation time, from one step to another."""
    longest_gaps_s: tuple[float, ...]
    """Longest gap of each robot, by arrival."""
    cpu_cores: float
    mib_per_s: float


class CountingFeed(TopicFeed[FleetOdometry]):
    """The messages of a subscription, whose rows are counted when they are taken."""

    def __init__(self, subscription: BusSubscription, names: list[str]) -> None:
        self.byte_count = 0
        self.newest_ns = 0
        self._subscription = subscription
        self._rows = {name: row for row, name in enumerate(names)}
        self._rows_of: dict[tuple[str, ...], npt.NDArray[np.intp]] = {}
        self.begin()

    def begin(self) -> None:
        """Begin to count, after the newest step."""
        self.byte_count = 0
        self.first_ns, self.last_ns = self.newest_ns, math.inf
        self.counts = np.zeros(len(self._rows), dtype=np.int64)
        self.gaps_s = np.zeros(len(self._rows))
        self._last_s = np.full(len(self._rows), time.monotonic())

    def take(self, *, newest_only: bool = False) -> list[FleetOdometry]:
        """See `TopicFeed`."""
        del newest_only
        samples, now_s = self._subscription.take(), time.monotonic()
        messages = [decode(FleetOdometry, one.payload, one.encoding) for one in samples]
        self.byte_count += sum(len(one.payload) for one in samples)
        for message in messages:
            self.newest_ns = max(self.newest_ns, message.time_ns)
            if not self.first_ns < message.time_ns <= self.last_ns:
                continue
            if (rows := self._rows_of.get(message.entities)) is None:
                found = [self._rows[name] for name in message.entities]
                rows = self._rows_of[message.entities] = np.array(found, dtype=np.intp)
            self.counts[rows] += 1
            self.gaps_s[rows] = np.maximum(self.gaps_s[rows], now_s - self._last_s[rows])
            self._last_s[rows] = now_s
        return messages

    def close(self) -> None:
        """See `TopicFeed`."""
        self._subscription.close()


def read(bus: Bus, count: int, seconds: float) -> OdometryTally:
    """Read as a program does that shows all robots 50 times a second."""
    names = [f"box_bot{number}" for number in range(count)]
    feed = CountingFeed(bus.subscribe(FLEET_ODOMETRY.key(WORLD, "*"), TABLE_DEPTH), names)
    table = OdometryTable(feed)
    poll_until(lambda: None if np.isnan(table.read(names).times).any() else True, WAIT_S)
    sys.stdout.write("all robots have odometry\n")
    sys.stdout.flush()
    feed.begin()
    began_s, began_cpu_s = time.monotonic(), used_s(os.getpid())
    read_for(table, names, seconds)
    spent_s, used_cpu_s = time.monotonic() - began_s, used_s(os.getpid()) - began_cpu_s
    mib = feed.byte_count / (1 << 20)
    feed.last_ns = feed.newest_ns
    read_for(table, names, LATE_S)
    return OdometryTally(
        rates_hz=tuple((feed.counts * NANOSECONDS / (feed.last_ns - feed.first_ns)).tolist()),
        longest_gaps_s=tuple(feed.gaps_s.tolist()),
        cpu_cores=used_cpu_s / spent_s,
        mib_per_s=mib / spent_s,
    )


def read_for(table: OdometryTable, names: list[str], seconds: float) -> None:
    """Read all rows 50 times a second for some time."""
    began_s = time.monotonic()
    for number in range(1, round(seconds / READ_PERIOD_S) + 1):
        table.read(names)
        time.sleep(max(0.0, began_s + number * READ_PERIOD_S - time.monotonic()))


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    with open_bus(BusConfig(connect=(sys.argv[1],))) as connected:
        tally = read(connected, int(sys.argv[2]), float(sys.argv[3]))
        sys.stdout.write(msgspec.json.encode(tally).decode() + "\n")
        sys.stdout.flush()
