"""Process that reads the odometry of all robots of a world from the messages of their agents.

`python -m benchmarks.odometry_reader ENDPOINT COUNT SECONDS` waits until box_bot0 and so on have
odometry, and prints a line; then it reads for a time, and prints a JSON line.
"""

import os
import sys
import time

import msgspec
import numpy as np

from benchmarks.machine import used_s
from benchmarks.ten_robots import POLL_S, poll_until
from zensim.api.odometry_table import TABLE_DEPTH, OdometryTable
from zensim.api.world_access import TopicFeed
from zensim.proto.bus import Bus, BusConfig, BusSubscription, open_bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import FleetOdometry
from zensim.proto.process_limits import die_with_supervisor
from zensim.proto.topic_catalog import FLEET_ODOMETRY

WORLD = "default"
WAIT_S = 60.0


class OdometryTally(msgspec.Struct, frozen=True):
    """What was read of each robot."""

    rates_hz: tuple[float, ...]
    """Rows of each robot per second of wall time."""
    longest_gaps_s: tuple[float, ...]
    """Of each robot, by arrival."""
    cpu_cores: float
    mib_per_s: float


class CountingFeed(TopicFeed[FleetOdometry]):
    """The messages of a subscription, whose rows are counted when they are taken."""

    def __init__(self, subscription: BusSubscription, names: list[str]) -> None:
        self.byte_count = 0
        self._subscription = subscription
        self._rows = {name: row for row, name in enumerate(names)}
        self.begin()

    def begin(self) -> None:
        """Begin to count."""
        self.byte_count = 0
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
            rows = [self._rows[name] for name in message.entities]
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
    poll_until(lambda: not np.isnan(table.read(names).times).any(), WAIT_S)
    sys.stdout.write("all robots have odometry\n")
    sys.stdout.flush()
    feed.begin()
    began_s, began_cpu_s = time.monotonic(), used_s(os.getpid())
    while time.monotonic() - began_s < seconds:
        table.read(names)
        time.sleep(10 * POLL_S)
    spent_s = time.monotonic() - began_s
    return OdometryTally(
        rates_hz=tuple((feed.counts / spent_s).tolist()),
        longest_gaps_s=tuple(feed.gaps_s.tolist()),
        cpu_cores=(used_s(os.getpid()) - began_cpu_s) / spent_s,
        mib_per_s=feed.byte_count / spent_s / (1 << 20),
    )


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    with open_bus(BusConfig(connect=(sys.argv[1],))) as connected:
        tally = read(connected, int(sys.argv[2]), float(sys.argv[3]))
        sys.stdout.write(msgspec.json.encode(tally).decode() + "\n")
        sys.stdout.flush()
