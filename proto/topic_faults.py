"""Faults of topics: which messages are published instead of those that were measured."""

import random
import struct
import zlib
from collections import deque
from collections.abc import Callable, Sequence

import msgspec

from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.fault_messages import TopicFault
from zensim.proto.messages.standard_messages import NANOSECONDS, Imu, LaserScan, Range, Vector3

_STAMP = struct.Struct("<iI")
STAMP_AT = 4
"""Offset of the stamp in a CDR message that begins with a header."""
CHANGED_TYPES = (LaserScan, Range, Imu)
"""Types whose numbers a noise or a bias changes."""


class FaultedTopic:
    """One fault on one topic, with the messages that it keeps."""

    def __init__(self, fault: TopicFault, key: str) -> None:
        self.fault = fault
        self._key = key
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
        while self._waiting and self._waiting[0][0] <= time_ns:
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
        key = zlib.crc32(self._key.encode())
        return random.Random(f"{self.fault.seed} {key} {time_ns}")


def _change_message(
    message: msgspec.Struct, fault: TopicFault, numbers: random.Random
) -> msgspec.Struct:
    def change(value: float) -> float:
        if fault.kind == "sensor_bias":
            return value + fault.value
        return value + numbers.gauss(0.0, fault.value)

    def change_vector(vector: Vector3) -> Vector3:
        return Vector3(change(vector.x), change(vector.y), change(vector.z))

    if isinstance(message, LaserScan):
        ranges = tuple(
            float("inf") if _is_blind(message, ray, fault) else _change_range(change, value, fault)
            for ray, value in enumerate(message.ranges)
        )
        return msgspec.structs.replace(message, ranges=ranges)
    if fault.kind == "sensor_sector":
        return message
    if isinstance(message, Range):
        return msgspec.structs.replace(message, range=change(message.range))
    if isinstance(message, Imu):
        return msgspec.structs.replace(
            message,
            angular_velocity=change_vector(message.angular_velocity),
            linear_acceleration=change_vector(message.linear_acceleration),
        )
    return message


def _change_range(change: Callable[[float], float], value: float, fault: TopicFault) -> float:
    return value if fault.kind == "sensor_sector" else change(value)


def _is_blind(scan: LaserScan, ray: int, fault: TopicFault) -> bool:
    angle = scan.angle_min + ray * scan.angle_increment
    return fault.kind == "sensor_sector" and fault.low <= angle <= fault.high


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
        former = {(one.fault, key): one for key, listed in self._topics.items() for one in listed}
        self._topics = {}
        for fault in faults:
            for key in fault.keys:
                one = former.get((fault, key)) or FaultedTopic(fault, key)
                self._topics.setdefault(key, []).append(one)

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
