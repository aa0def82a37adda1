"""Bounds of a commanded velocity and of its change, as gz-sim's drives have them.

Source: the DiffDrive system of gz-sim, jerk aside.
"""

from zensim.proto.messages.drive_messages import Limits

UNLIMITED = Limits()


class LimitedVelocity:
    """One velocity that follows what is wanted, no faster and no further than it may."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.now = 0.0
        """As of the last update."""

    def reset(self) -> None:
        """Stand."""
        self.now = 0.0

    def update(self, wanted: float, elapsed_s: float) -> float:
        """Find the velocity after so much simulation time."""
        limits = self._limits
        if limits == UNLIMITED:
            return wanted
        bounded = _between(wanted, limits.min_velocity, limits.max_velocity)
        slowest, fastest = (
            None if rate is None else self.now + rate * elapsed_s
            for rate in (limits.min_acceleration, limits.max_acceleration)
        )
        self.now = _between(bounded, slowest, fastest)
        return self.now


def _between(value: float, low: float | None, high: float | None) -> float:
    if high is not None:
        value = min(value, high)
    return value if low is None else max(value, low)
