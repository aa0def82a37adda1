"""Differential drive: twist to wheel speeds, with velocity and acceleration limits."""

from collections.abc import Sequence

from zensim.proto.messages.drive_messages import DiffDrive, Limits
from zensim.proto.messages.standard_messages import Twist
from zensim.robot_agent.drives.drive_controller import MeasuredJoints, clamp

NO_LIMITS = Limits()


class VelocityLimiter:
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
        if limits == NO_LIMITS:
            return wanted
        bounded = _clamp_between(wanted, limits.min_velocity, limits.max_velocity)
        slowest, fastest = (
            None if rate is None else self.now + rate * elapsed_s
            for rate in (limits.min_acceleration, limits.max_acceleration)
        )
        self.now = _clamp_between(bounded, slowest, fastest)
        return self.now


def _clamp_between(value: float, low: float | None, high: float | None) -> float:
    if high is not None:
        value = min(value, high)
    return value if low is None else max(value, low)


REACHED_M_S = 0.01
"""A wheel whose rim is this close to its speed has reached it."""
MAX_LEAD_M_S = 0.1
"""How far beyond its speed a wheel that lags may be told to go.

Gazebo has no such bound: there, a robot that pushed at a wall bolts once it is free.
"""
MAX_RIM_SPEED_M_S = 1e6
"""Far beyond any wheel; keeps every target finite, whatever twist comes."""


class DifferentialDrive:
    """Turns twists into wheel speeds, with the acceleration limit that a robot has."""

    def __init__(self, parameters: DiffDrive) -> None:
        self._pairs = parameters.pairs
        self._radii = tuple(pair.diameter_m / 2.0 for pair in self._pairs for _ in range(2))
        self._max_acceleration = parameters.max_acceleration
        self._instructed = [0.0] * len(self._radii)
        self._linear = VelocityLimiter(parameters.linear_limits)
        self._angular = VelocityLimiter(parameters.angular_limits)

    @property
    def memory(self) -> tuple[float, ...]:
        """See `Controller.memory`."""
        return (*self._instructed, self._linear.now, self._angular.now)

    @memory.setter
    def memory(self, memory: tuple[float, ...]) -> None:
        *self._instructed, self._linear.now, self._angular.now = memory

    def reset(self) -> None:
        """Forget what the wheels were told."""
        self._instructed = [0.0] * len(self._radii)
        self._linear.reset()
        self._angular.reset()

    def update(
        self, twist: Twist, *, measured: MeasuredJoints, elapsed_s: float
    ) -> tuple[float, ...]:
        """Find the wheel speeds [rad/s], left before right, pair by pair.

        Args:
            twist: Of the base; only linear.x and angular.z are reachable, the rest is ignored.
            measured: The wheels, in the same order.
            elapsed_s: Simulation time since the last update.
        """
        velocities = measured.velocities
        desired = self._desired_rims(
            self._linear.update(twist.linear.x, elapsed_s),
            self._angular.update(twist.angular.z, elapsed_s),
        )
        if self._max_acceleration == 0.0:
            return _to_joint_speeds(desired, self._radii)
        targets: list[float] = []
        for left in range(0, len(desired), 2):
            wheels = slice(left, left + 2)
            rims = self._limited(left, desired[wheels], velocities[wheels], elapsed_s)
            targets += _to_joint_speeds(rims, self._radii[wheels])
        return tuple(targets)

    def _desired_rims(self, speed: float, turn: float) -> list[float]:
        return [
            clamp(rim, MAX_RIM_SPEED_M_S)
            for pair in self._pairs
            for rim in (
                speed - turn * pair.separation_m / 2.0,
                speed + turn * pair.separation_m / 2.0,
            )
        ]

    def _limited(
        self, left: int, desired: Sequence[float], velocities: Sequence[float], elapsed_s: float
    ) -> Sequence[float]:
        measured = [v * r for v, r in zip(velocities, self._radii[left : left + 2], strict=True)]
        errors = [want - have for want, have in zip(desired, measured, strict=True)]
        if all(abs(error) < REACHED_M_S for error in errors):
            # What was instructed before stays remembered, as in Gazebo.
            return desired
        reach = self._max_acceleration * elapsed_s
        for side, (want, error) in enumerate(zip(desired, errors, strict=True)):
            now = self._instructed[left + side]
            self._instructed[left + side] = _limit_step(now, want, min(max(error, -reach), reach))
        return self._instructed[left : left + 2]


def _limit_step(instructed: float, desired: float, step: float) -> float:
    """Add a step, but go no further than the lead beyond what is desired, or beyond standing."""
    if step >= 0.0:
        return min(instructed + step, max(instructed, max(desired, 0.0) + MAX_LEAD_M_S))
    return max(instructed + step, min(instructed, min(desired, 0.0) - MAX_LEAD_M_S))


def _to_joint_speeds(rims: Sequence[float], radii: Sequence[float]) -> tuple[float, ...]:
    return tuple(rim / radius for rim, radius in zip(rims, radii, strict=True))
