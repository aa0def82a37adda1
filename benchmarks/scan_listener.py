"""Process that subscribes to all topics of sensors, odometry and tf, and counts the messages.

`python -m benchmarks.scan_listener ENDPOINT` publishes the counts on `bench/scans` each second.
"""

import os
import struct
import sys
import time
from collections import defaultdict, deque

import msgspec

from zensim.proto.bus import Bus, BusConfig, open_bus
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.process_limits import die_with_supervisor
from zensim.proto.topic_catalog import IMU, ODOM, SCAN, TF

SCAN_TALLY = "bench/scans"
DEPTH = 65536
PUBLISH_EVERY_S = 1.0
POLL_S = 0.005
MILLISECONDS = 1e3
STAMP = struct.Struct("<II")
SCAN_STAMP_AT, TF_STAMP_AT = 4, 8
"""Bytes before the first stamp: the CDR header, and the number of transforms."""


class ScanTally(msgspec.Struct):
    """Message counts since the start."""

    scans: int = 0
    scan_bytes: int = 0
    others: int = 0
    transform_waits_ms: list[float] = []
    """Waits of the scans since the last publication; see `TransformWaits`."""
    wall_s: float = 0.0
    """Monotonic time of publication."""


class TransformWaits:
    """How long each scan waits for a transform of its robot at or after its stamp, as in tf2."""

    def __init__(self) -> None:
        self._newest_ns: dict[str, int] = {}
        self._waiting: dict[str, deque[tuple[int, float]]] = defaultdict(deque)
        """Stamp [ns] and arrival [s] of the scans of each robot."""

    def add_transform(self, robot: str, stamp_ns: int) -> None:
        """Note a transform."""
        self._newest_ns[robot] = max(stamp_ns, self._newest_ns.get(robot, stamp_ns))

    def add_scan(self, robot: str, stamp_ns: int, now_s: float) -> None:
        """Note a scan that came at a wall time."""
        self._waiting[robot].append((stamp_ns, now_s))

    def take_ended(self, now_s: float) -> list[float]:
        """Take the waits [ms] that have ended by a wall time."""
        ended = []
        for robot, scans in self._waiting.items():
            while scans and scans[0][0] <= self._newest_ns.get(robot, -1):
                ended.append((now_s - scans.popleft()[1]) * MILLISECONDS)
        return ended


def read_stamp_ns(payload: bytes, start: int) -> int:
    """Read the `Time` at an offset of a CDR message."""
    sec, nanosec = STAMP.unpack_from(payload, start)
    return int(sec) * NANOSECONDS + int(nanosec)


class EverythingListener:
    """Counts messages, and measures how long scans wait for transforms."""

    def __init__(self, bus: Bus) -> None:
        self.tally = ScanTally()
        self._waits = TransformWaits()
        self._scans = bus.subscribe(SCAN.key("*"), DEPTH)
        self._transforms = bus.subscribe(TF.key("*"), DEPTH)
        self._others = [bus.subscribe(topic.key("*"), DEPTH) for topic in (ODOM, IMU)]

    def poll(self) -> None:
        """Take what has come."""
        tally = self.tally
        now_s = time.monotonic()
        scans, transforms = self._scans.take(), self._transforms.take()
        for sample in scans:
            tally.scans += 1
            tally.scan_bytes += len(sample.payload)
            stamp_ns = read_stamp_ns(sample.payload, SCAN_STAMP_AT)
            self._waits.add_scan(robot_of(sample.key), stamp_ns, now_s)
        for sample in transforms:
            stamp_ns = read_stamp_ns(sample.payload, TF_STAMP_AT)
            self._waits.add_transform(robot_of(sample.key), stamp_ns)
        tally.transform_waits_ms += self._waits.take_ended(now_s)
        tally.others += len(transforms) + sum(len(one.take()) for one in self._others)


def robot_of(key: str) -> str:
    """Find the namespace of a key."""
    return key.rpartition("/")[0]


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
            listener.tally.transform_waits_ms = []
        time.sleep(POLL_S)


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    with open_bus(BusConfig(connect=(sys.argv[1],))) as connected:
        listen(connected)
