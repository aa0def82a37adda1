"""Process that subscribes to all topics of sensors, odometry and tf, and counts the messages.

`python -m benchmarks.scan_listener ENDPOINT` publishes the counts on `bench/scans` each second.
"""

import os
import sys
import time

import msgspec

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.parent_death import die_with_supervisor
from zensim.proto.topic_catalog import IMU, ODOM, SCAN, TF

SCAN_TALLY = "bench/scans"
DEPTH = 65536
PUBLISH_EVERY_S = 1.0
POLL_S = 0.005


class ScanTally(msgspec.Struct):
    """Message counts since the start."""

    scans: int = 0
    others: int = 0
    wall_s: float = 0.0
    """Monotonic time of publication."""


class EverythingListener:
    """Counts messages."""

    def __init__(self, bus: Bus) -> None:
        self.tally = ScanTally()
        self._scans = bus.subscribe(SCAN.key("*"), DEPTH)
        self._others = [bus.subscribe(topic.key("*"), DEPTH) for topic in (TF, ODOM, IMU)]

    def poll(self) -> None:
        """Take what has come."""
        self.tally.scans += len(self._scans.take())
        self.tally.others += sum(len(one.take()) for one in self._others)


def listen(bus: Bus) -> None:
    """Count messages for ever."""
    listener = EverythingListener(bus)
    publisher = bus.advertise(SCAN_TALLY, "application/msgpack")
    publish_s = time.monotonic()
    while True:
        listener.poll()
        if (now_s := time.monotonic()) >= publish_s:
            publish_s, listener.tally.wall_s = now_s + PUBLISH_EVERY_S, now_s
            publisher.send(msgspec.msgpack.encode(listener.tally))
        time.sleep(POLL_S)


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    with open_bus(BusConfig(connect=(sys.argv[1],))) as connected:
        listen(connected)
