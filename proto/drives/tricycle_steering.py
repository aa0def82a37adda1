"""Tricycle: speed and steering angle to the wheel that drives and steers."""

import math
from typing import Generic

from zensim.proto.drives.column_math import Column, ColumnMath
from zensim.proto.drives.measured_joints import Columns, MeasuredJoints, PlanarTwist
from zensim.proto.messages.drive_messages import TricycleDrive

MAX_WHEEL_SPEED = 1e6
"""Speed beyond that of any wheel [rad/s]; keeps targets finite for every twist."""


class TricycleSteering(Generic[Column]):
    """One actuated wheel that drives and steers."""

    state_size = 0

    def __init__(self, parameters: TricycleDrive, xp: ColumnMath[Column]) -> None:
        self._parameters = parameters
        self._xp: ColumnMath[Column] = xp
        self._radius = parameters.actuated_wheel_diameter_m / 2.0

    def find_targets(
        self,
        twist: PlanarTwist[Column],
        *,
        measured: MeasuredJoints[Column],
        state: Columns[Column],
        dt_s: Column,
    ) -> tuple[Columns[Column], Columns[Column]]:
        """Find the wheel's speed [rad/s] and its angle [rad], or the speed of steering [rad/s].

        Args:
            twist: vx is the rim speed of the actuated wheel [m/s], wz the steering angle [rad],
                limited to a right angle.
            measured: Wheel, then steering joint.
            state: Not used.
            dt_s: See `DriveKinematics`.
        """
        vx, _, steer = twist
        desired = self._xp.clamp(vx / self._radius, MAX_WHEEL_SPEED)
        angle = self._xp.clamp(steer, math.pi / 2.0)
        speed = self._limit_speed(desired, measured.velocities[0], dt_s)
        if self._parameters.max_steering_speed > 0.0:
            return (speed, self._find_steering_speed(angle - measured.positions[1], dt_s)), state
        return (speed, angle), state

    def _limit_speed(self, desired: Column, current: Column, dt_s: Column) -> Column:
        faster, slower = self._parameters.max_acceleration, self._parameters.max_deceleration
        if faster == slower == 0.0:
            return desired
        # 0 means unlimited on its side only.
        up = current + faster * dt_s if faster > 0.0 else math.inf
        down = current - slower * dt_s if slower > 0.0 else -math.inf
        limited = self._xp.minimum(self._xp.maximum(desired, down), up)
        has_reached = abs(desired - current) < self._parameters.speed_tolerance
        return self._xp.where(has_reached, desired, limited)

    def _find_steering_speed(self, missing_rad: Column, dt_s: Column) -> Column:
        where = self._xp.where
        # Not faster than needed to arrive in this step: Gazebo oscillates about the angle.
        needed = missing_rad / where(dt_s > 0.0, dt_s, 1.0)
        speed = self._xp.clamp(needed, self._parameters.max_steering_speed)
        moving = where(dt_s > 0.0, speed, 0.0)
        return where(abs(missing_rad) < self._parameters.angle_tolerance, 0.0, moving)
