"""Injected faults: parts of bodies that fail, and topics of sensors that fail."""

import math
from typing import ClassVar, Literal

import msgspec

from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt64
from zensim.proto.messages.standard_messages import Duration

BodyFaultKind = Literal["wheel_slip", "wheel_jam", "motor_weak", "joint_lock", "link_broken"]
TopicFaultKind = Literal[
    "sensor_off",
    "sensor_stuck",
    "sensor_slow",
    "sensor_delay",
    "sensor_intermittent",
    "sensor_noise",
    "sensor_bias",
    "sensor_sector",
]
FOR_EVER = Duration(-1)


class InjectFaultRequest(msgspec.Struct, frozen=True):
    """Let a part of an entity fail from the present step on, for a duration.

    The fault ends by itself at the first control step after its duration; a reset ends all.
    """

    ros_type: ClassVar[str] = "zensim/srv/InjectFault_Request"

    entity: str = ""
    kind: str = ""
    """A `BodyFaultKind` or a `TopicFaultKind`."""
    part: str = ""
    """Joint of `wheel_slip` (its child link), `wheel_jam`, `motor_weak` and `joint_lock`; link of
    `link_broken`; sensor of the others."""
    value: float = 0.0
    """Factor of friction or torque; every n-th message; delay [s]; share of lost messages; standard
    deviation or bias in the unit of the sensor."""
    low: float = 0.0
    """First angle of `sensor_sector` [rad]."""
    high: float = 0.0
    """Last angle of `sensor_sector` [rad], counter-clockwise from the first."""
    duration: Duration = FOR_EVER
    """Simulation time; negative = until a reset."""
    seed: UInt64 = 0
    """Seed of lost messages and noise."""


class InjectFaultResponse(msgspec.Struct, frozen=True):
    """Result of the request."""

    ros_type: ClassVar[str] = "zensim/srv/InjectFault_Response"

    result: Result = Result()


class TopicFault(msgspec.Struct, frozen=True):
    """A fault that acts on messages of topics before they are published."""

    ros_type: ClassVar[str] = "zensim/msg/TopicFault"

    keys: tuple[str, ...] = ()
    """Keys of the topics, without a leading slash."""
    kind: str = "sensor_off"
    """A `TopicFaultKind`."""
    value: float = 0.0
    """Value as in `InjectFaultRequest`; so are `low` and `high`."""
    low: float = 0.0
    high: float = 0.0
    start_ns: UInt64 = 0
    """Simulation time; of two faults that follow each other, the times differ."""
    seed: UInt64 = 0

    def has_angle(self, angle: float) -> bool:
        """Whether an angle [rad] is in its sector, counter-clockwise from `low` to `high`."""
        is_whole = self.high - self.low >= math.tau
        return is_whole or (angle - self.low) % math.tau <= (self.high - self.low) % math.tau
