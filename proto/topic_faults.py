"""Faults of topics: which messages are published instead of those that were measured."""

import math
import random
import struct
import zlib
from collections import deque
from collections.abc import Callable, Sequence

import msgspec

from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.fault_messages import TopicFault
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Imu,
    LaserScan,
    PointCloud,
    PointCloud2,
    Range,
    Vector3,
)
from zensim.proto.rate_limiter import SLACK_NS

_STAMP = struct.Struct("<iI")
STAMP_AT = 4
"""Offset of the stamp in a CDR message that begins with a header."""
CHANGED_TYPES = (LaserScan, PointCloud, PointCloud2, Range, Imu)
"""Types whose numbers a noise or a bias changes."""


class FaultedTopic:
    """One fault on one topic, with the messages that it keeps."""

    def __init__(self, fault: TopicFault, key: str, number: int = 0) -> None:
        """Begin the fault with this number of equal ones; each draws other random numbers."""
        self.fault = fault
        what = f"{fault.kind} {fault.value} {fault.start_ns} {number}"
        self._stream = f"{fault.seed} {zlib.crc32(key.encode())} {what}"
        self._kept: bytes | None = None
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._count = 0

    def change(self, kind: type[msgspec.Struct], payload: bytes, time_ns: int) -> list[bytes]:
        """Find what is published in place of a message."""
        fault, self._count = self.fault, self._count + 1
        if fault.kind == "sensor_off":
            return []
        if fault.kind == "sensor_slow":
            return [payload] if (self._count - 1) % max(1, round(fault.value)) == 0 else []
        if fault.kind == "sensor_intermittent":
            return [] if self._make_random(time_ns).random() < fault.value else [payload]
        if fault.kind == "sensor_delay":
            return self._delay(payload, time_ns)
        if fault.kind == "sensor_stuck":
            return [self._repeat(payload)]
        return [self._change_numbers(kind, payload, time_ns)]

    def _delay(self, payload: bytes, time_ns: int) -> list[bytes]:
        self._waiting.append((time_ns + round(self.fault.value * NANOSECONDS), payload))
        due = []
        while self._waiting and self._waiting[0][0] <= time_ns + SLACK_NS:
            due.append(self._waiting.popleft()[1])
        return due

    def _repeat(self, payload: bytes) -> bytes:
        """Repeat the first message of the fault, with the stamp of this one."""
        if self._kept is None:
            self._kept = payload
        end = STAMP_AT + _STAMP.size
        return self._kept[:STAMP_AT] + payload[STAMP_AT:end] + self._kept[end:]

    def _change_numbers(self, kind: type[msgspec.Struct], payload: bytes, time_ns: int) -> bytes:
        if kind not in CHANGED_TYPES:
            return payload
        message = decode(kind, payload, make_encoding(kind, Format.CDR))
        random_numbers = self._make_random(time_ns)
        changed = _change_message(message, self.fault, random_numbers)
        return encode(changed, Format.CDR)

    def _make_random(self, time_ns: int) -> random.Random:
        return random.Random(f"{self._stream} {time_ns}")


def _change_message(
    message: msgspec.Struct, fault: TopicFault, numbers: random.Random
) -> msgspec.Struct:
    def change(value: float) -> float:
        if fault.kind == "sensor_bias":
            return value + fault.value
        return value + numbers.gauss(0.0, fault.value) if fault.kind == "sensor_noise" else value

    def change_vector(vector: Vector3) -> Vector3:
        return Vector3(change(vector.x), change(vector.y), change(vector.z))

    if isinstance(message, LaserScan):
        return _change_scan(message, fault, change)
    if isinstance(message, PointCloud | PointCloud2):
        # Its import takes a while, and few processes have faults.
        from zensim.proto.cloud_faults import change_points  # noqa: PLC0415

        return change_points(message, fault, change)
    if isinstance(message, Range):
        return msgspec.structs.replace(message, range=change(message.range))
    if isinstance(message, Imu):
        return msgspec.structs.replace(
            message,
            angular_velocity=change_vector(message.angular_velocity),
            linear_acceleration=change_vector(message.linear_acceleration),
        )
    return message


def _change_scan(scan: LaserScan, fault: TopicFault, change: Callable[[float], float]) -> LaserScan:
    if fault.kind != "sensor_sector":
        return msgspec.structs.replace(scan, ranges=tuple(map(change, scan.ranges)))
    angles = (scan.angle_min + ray * scan.angle_increment for ray in range(len(scan.ranges)))
    ranges = (
        math.inf if fault.has_angle(angle) else value
        for angle, value in zip(angles, scan.ranges, strict=True)
    )
    return msgspec.structs.replace(scan, ranges=tuple(ranges))


class TopicFaults:
    """The faults of all topics of a process; without any it costs one look-up a message."""

    def __init__(self) -> None:
        self._faults: tuple[TopicFault, ...] = ()
        self._topics: dict[str, list[FaultedTopic]] = {}
        self._time_ns = 0

    def __bool__(self) -> bool:
        """Whether any fault acts."""
        return bool(self._topics)

    def update(self, faults: tuple[TopicFault, ...], time_ns: int) -> None:
        """Set the faults that act at a simulation time; those that go on keep their messages."""
        self._time_ns = time_ns
        if faults == self._faults:
            return
        self._faults = faults
        former, self._topics = self._topics, {}
        for fault in faults:
            for key in fault.keys:
                listed = self._topics.setdefault(key, [])
                number = sum(one.fault == fault for one in listed)
                same = [one for one in former.get(key, ()) if one.fault == fault]
                kept = same[number] if number < len(same) else FaultedTopic(fault, key, number)
                listed.append(kept)

    def affects(self, key: str) -> bool:
        """Whether messages of a topic may change."""
        return key in self._topics

    def change(self, key: str, kind: type[msgspec.Struct], payload: bytes) -> Sequence[bytes]:
        """Find what is published on a topic in place of a message; in the order of the faults."""
        payloads: Sequence[bytes] = [payload]
        for one in self._topics.get(key, ()):
            payloads = [
                changed for given in payloads for changed in one.change(kind, given, self._time_ns)
            ]
        return payloads
