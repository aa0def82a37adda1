"""Protocol of drive controllers: twist in, actuator targets out."""

from collections.abc import Sequence
from typing import Protocol

import msgspec

from zensim.proto.messages.standard_messages import Twist


class MeasuredJoints(msgspec.Struct, frozen=True, gc=False):
    """Joints of a drive's actuators as they are, in order; a twist has none."""

    positions: Sequence[float] = ()
    """[rad]."""
    velocities: Sequence[float] = ()
    """[rad/s]."""


class DriveController(Protocol):
    """Finds what actuators are to do."""

    memory: tuple[float, ...]
    """What updates leave behind; who sets it back can have the last one made anew."""

    def reset(self) -> None:
        """Forget what was told before."""

    def update(
        self, twist: Twist, *, measured: MeasuredJoints, elapsed_s: float
    ) -> tuple[float, ...]:
        """Find the numbers for the actuators of the drive, in order.

        Args:
            twist: As commanded to the base.
            measured: The joints as they are.
            elapsed_s: Simulation time since the last update.
        """


def clamp(value: float, limit: float) -> float:
    """Keep a value within its limit, on both sides of 0."""
    return min(max(value, -limit), limit)
