"""What Nav2 asks of a robot

A node of Nav2 looks up the transform at the stamp of each scan: a message filter holds the scan
back until the transform has come. Ten robots with lidars publish scans at 10 Hz. A late process
with the session settings, subscribers and keys of rmw_zenoh notes when each scan came, and when the
first transform that is not older came; it reads the bytes itself. Then it commands a robot as
Nav2's velocity smoother does, at 20 Hz in steps of 0.0125 m/s; the speed of a robot that stopped
between two commands would jump by up to 0.5 m/s.
"""

import struct
import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import count, pairwise

import msgspec
import numpy as np
import zenoh

from benchmarks.figures import Figure, Limit
from tests.integration.processes import START_S, eventually, running, serving
from tests.integration.rmw_sessions import open_rmw_session, subscribe_as_rmw
from tests.integration.sensor_runs import running_sensors
from tests.interop.acceptance import all_of, at_most, none_of
from tests.interop.ros_processes import spawn_lidar_robots
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.standard_messages import (
    LaserScan,
    OccupancyGrid,
    Odometry,
    TFMessage,
    Twist,
    Vector3,
)
from zensim.proto.messages.standard_messages import String as StringMessage
from zensim.proto.ros2.rmw_attachment import Attachment, write_attachment
from zensim.proto.ros2.rmw_keys import make_data_key
from zensim.proto.ros2.type_hash import hash_type

ROBOTS = 10
LISTEN_S, LISTEN_SHORT_S = 60.0, 3.0
LATE_MS, SHARE = 50.0, 0.999
SMOOTHER_HZ, STEP_M_S, TOP_M_S = 20.0, 0.0125, 0.5
JUMP_M_S = 0.1
"""Eight steps of the smoother, as commands come late on a busy machine."""
SCAN_STAMP, TF_STAMP = 4, 8
"""Offsets of the first stamp: after the header of CDR, and after the length of the sequence."""


def make_key(topic: str, kind: type[msgspec.Struct]) -> str:
    """Write the data key of a topic."""
    return make_data_key(0, topic, str(vars(kind)["ros_type"]), hash_type(kind))


@dataclass
class Arrivals:
    """Stamps [ns] of the messages of a topic, and when they came [s]."""

    offset: int
    stamps_ns: list[int] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)

    def note(self, sample: zenoh.Sample) -> None:
        """Note a message."""
        now_s = time.monotonic()
        seconds, nanoseconds = struct.unpack_from("<iI", sample.payload.to_bytes(), self.offset)
        self.stamps_ns.append(seconds * 10**9 + nanoseconds)
        self.times_s.append(now_s)


def find_waits_ms(scans: Arrivals, transforms: Arrivals) -> list[float]:
    """Find how long each scan is held back; infinite if its transform never came.

    Scans before the first transform, or of the last second, are left out.
    """
    waits = []
    for stamp_ns, came_s in zip(scans.stamps_ns, scans.times_s, strict=True):
        place = bisect_left(transforms.stamps_ns, stamp_ns)
        if place == 0 or came_s > transforms.times_s[-1] - 1.0:
            continue
        waits.append(max(0.0, transforms.times_s[place] - came_s) * 1e3)
    return waits


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Run robots with lidars, and a process that waits for transforms."""
    with ExitStack() as stack:
        server = stack.enter_context(serving("--world", "warehouse"))
        stack.enter_context(
            running("agent", "--pool", "0", "--quiet", "--connect", server.endpoint)
        )
        stack.enter_context(running_sensors(server, "s1"))
        names = spawn_lidar_robots(server, ROBOTS)
        session = stack.enter_context(open_rmw_session(server.endpoint))
        yield from judge_latched(session, names)
        yield from judge_waits(session, names, LISTEN_SHORT_S if is_short else LISTEN_S)
        yield from smooth(session, names[0])


def judge_latched(session: zenoh.Session, names: Sequence[str]) -> Iterator[Figure]:
    """Count latched messages that a late node misses."""
    topics: list[tuple[str, type[msgspec.Struct]]] = [("map", OccupancyGrid)]
    topics += [(f"{name}/robot_description", StringMessage) for name in names]
    readers = [
        subscribe_as_rmw(session, make_key(topic, kind), is_transient_local=True)
        for topic, kind in topics
    ]
    eventually(lambda: all(reader.samples for reader, _ in readers), START_S, "latched messages")
    silent = sum(not reader.samples for reader, _ in readers)
    for _, subscriber in readers:
        subscriber.undeclare()
    yield none_of("latched topics that a late node misses", silent)


def judge_waits(session: zenoh.Session, names: Sequence[str], seconds: float) -> Iterator[Figure]:
    """Listen for a time; judge how long scans wait for their transforms."""
    scans, transforms = ([Arrivals(offset) for _ in names] for offset in (SCAN_STAMP, TF_STAMP))
    subscribers = [
        session.declare_subscriber(make_key(f"{name}/{topic}", kind), one.note)
        for topic, kind, all_arrivals in (("scan", LaserScan, scans), ("tf", TFMessage, transforms))
        for name, one in zip(names, all_arrivals, strict=True)
    ]
    threading.Event().wait(seconds)
    for subscriber in subscribers:
        subscriber.undeclare()
    waits_ms = [
        wait_ms for pair in zip(scans, transforms, strict=True) for wait_ms in find_waits_ms(*pair)
    ]
    in_time = sum(wait_ms <= LATE_MS for wait_ms in waits_ms) / max(len(waits_ms), 1)
    yield all_of(
        "robots with scans and transforms", sum(bool(one.times_s) for one in scans), ROBOTS
    )
    limit = Limit("min", ">=", SHARE, is_timed=True)
    what = f"share of {len(waits_ms)} scans with their transform within {LATE_MS:g} ms"
    yield Figure(what=what, unit="", samples=(in_time,), limit=limit)
    yield Figure(what="wait for the transform", unit="ms", samples=tuple(waits_ms) or (0.0,))


def smooth(session: zenoh.Session, robot: str) -> Iterator[Figure]:
    """Command a ramp up and down at 20 Hz; judge the changes of the robot's speed."""
    speeds: list[tuple[int, float]] = []

    def note(sample: zenoh.Sample) -> None:
        odom = decode(Odometry, sample.payload.to_bytes())
        stamp = odom.header.stamp
        speeds.append((stamp.sec * 10**9 + stamp.nanosec, odom.twist.twist.linear.x))

    subscriber = session.declare_subscriber(make_key(f"{robot}/odom", Odometry), note)
    publish = make_command_publisher(session, robot)
    rising = np.arange(0.0, TOP_M_S, STEP_M_S)
    pause = threading.Event()
    for speed in (*rising, *rising[::-1]):
        publish(float(speed))
        pause.wait(1.0 / SMOOTHER_HZ)
    subscriber.undeclare()
    jumps = [
        abs(after - before) / max(1.0, (later_ns - earlier_ns) * 1e-9 * SMOOTHER_HZ)
        for (earlier_ns, before), (later_ns, after) in pairwise(speeds)
    ]
    yield all_of(
        "speed at the top of the ramp", max(one for _, one in speeds), 0.9 * TOP_M_S, "m/s"
    )
    yield at_most("change of speed in 50 ms", jumps, JUMP_M_S, "m/s", is_timed=True)


def make_command_publisher(session: zenoh.Session, robot: str) -> Callable[[float], None]:
    """Make a function that publishes a forward speed."""
    publisher, numbers = session.declare_publisher(make_key(f"{robot}/cmd_vel", Twist)), count(1)

    def publish(speed_m_s: float) -> None:
        attachment = write_attachment(Attachment(next(numbers), time.time_ns(), bytes(16)))
        payload = encode(Twist(linear=Vector3(x=speed_m_s)), Format.CDR)
        publisher.put(payload, attachment=attachment)

    return publish
