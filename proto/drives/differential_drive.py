"""Differential drive: twist to wheel speeds with limits, and wheel rotation to motion."""

from typing import Generic

from zensim.proto.drives.column_math import Column, ColumnMath
from zensim.proto.drives.measured_joints import Columns, MeasuredJoints, PlanarTwist
from zensim.proto.messages.drive_messages import DiffDrive, Limits, WheelPair

REACHED_M_S = 0.01
"""A wheel has reached its speed if the rim speed differs by less."""
MAX_LEAD_M_S = 0.1
"""Maximum excess of the commanded rim speed over the desired one while a wheel lags.

Gazebo has no such limit: there, a robot that pushed against a wall accelerates suddenly once free.
"""
MAX_RIM_SPEED_M_S = 1e6
"""Speed beyond that of any wheel; keeps targets finite for every twist."""


class DifferentialDrive(Generic[Column]):
    """One or more wheel pairs, with limits of velocity and acceleration.

    State: limited linear and angular velocity, then the commanded rim speed of each wheel; none if
    nothing is limited.
    """

    def __init__(self, parameters: DiffDrive, xp: ColumnMath[Column]) -> None:
        self._xp: ColumnMath[Column] = xp
        self._parameters = parameters
        self._radii = tuple(radius for pair in parameters.pairs for radius in pair.radii_m)
        has_limits = parameters.linear_limits != Limits() or parameters.angular_limits != Limits()
        is_limited = has_limits or parameters.max_acceleration != 0.0
        self.state_size = 2 + len(self._radii) if is_limited else 0

    def find_targets(
        self,
        twist: PlanarTwist[Column],
        *,
        measured: MeasuredJoints[Column],
        state: Columns[Column],
        dt_s: Column,
    ) -> tuple[Columns[Column], Columns[Column]]:
        """Find the wheel speeds [rad/s], left before right, pair by pair; see `DriveKinematics`.

        Args:
            twist: Only vx and wz are reachable, vy is ignored.
            measured: The wheels, in the same order.
            state: See the class.
            dt_s: See `DriveKinematics`.
        """
        speed, _, turn = twist
        if not state:
            return self._to_joint_speeds(self._find_rim_speeds(speed, turn)), state
        parameters = self._parameters
        linear, angular = state[:2]
        commanded: list[Column] = list(state[2:])
        linear = limit_velocity(parameters.linear_limits, speed, linear, dt_s, self._xp)
        angular = limit_velocity(parameters.angular_limits, turn, angular, dt_s, self._xp)
        rims = self._find_rim_speeds(linear, angular)
        if parameters.max_acceleration != 0.0:
            rims, commanded = self._limit_rims(rims, commanded, measured, dt_s)
        kept = [linear, angular]
        kept += commanded
        return self._to_joint_speeds(rims), tuple(kept)

    def _find_rim_speeds(self, speed: Column, turn: Column) -> list[Column]:
        rims = []
        for pair in self._parameters.pairs:
            side = turn * pair.separation_m / 2.0
            rims += [speed - side, speed + side]
        return [self._xp.clamp(rim, MAX_RIM_SPEED_M_S) for rim in rims]

    def _limit_rims(
        self,
        desired: list[Column],
        commanded: list[Column],
        measured: MeasuredJoints[Column],
        dt_s: Column,
    ) -> tuple[list[Column], list[Column]]:
        """Limit the acceleration of rims; return their speeds and the commanded ones to keep."""
        xp, most = self._xp, self._parameters.max_acceleration * dt_s
        rims: list[Column] = []
        kept: list[Column] = []
        for left in range(0, len(desired), 2):
            wheels = range(left, left + 2)
            errors = [desired[i] - measured.velocities[i] * self._radii[i] for i in wheels]
            has_reached = (abs(errors[0]) < REACHED_M_S) & (abs(errors[1]) < REACHED_M_S)
            if xp.all_true(has_reached):  # as most of the time
                rims += desired[left : left + 2]
                kept += commanded[left : left + 2]
                continue
            for i, error in zip(wheels, errors, strict=True):
                step = xp.minimum(xp.maximum(error, -most), most)
                stepped = _limit_step(commanded[i], desired[i], step, xp)
                rims.append(xp.where(has_reached, desired[i], stepped))
                # A wheel that has reached its speed keeps the last command, as in Gazebo.
                kept.append(xp.where(has_reached, commanded[i], stepped))
        return rims, kept

    def _to_joint_speeds(self, rims: list[Column]) -> Columns[Column]:
        return tuple(rim / radius for rim, radius in zip(rims, self._radii, strict=True))


def limit_velocity(
    limits: Limits, desired: Column, now: Column, dt_s: Column, xp: ColumnMath[Column]
) -> Column:
    """Limit a velocity, and its change from the velocity now."""
    if limits.max_velocity is not None:
        desired = xp.minimum(desired, limits.max_velocity)
    if limits.min_velocity is not None:
        desired = xp.maximum(desired, limits.min_velocity)
    if limits.max_acceleration is not None:
        desired = xp.minimum(desired, now + limits.max_acceleration * dt_s)
    if limits.min_acceleration is not None:
        desired = xp.maximum(desired, now + limits.min_acceleration * dt_s)
    return desired


def _limit_step(commanded: Column, desired: Column, step: Column, xp: ColumnMath[Column]) -> Column:
    """Add a step, up to the lead beyond the desired speed or beyond rest."""
    highest = xp.maximum(commanded, xp.maximum(desired, 0.0) + MAX_LEAD_M_S)
    lowest = xp.minimum(commanded, xp.minimum(desired, 0.0) - MAX_LEAD_M_S)
    stepped = commanded + step
    return xp.where(step >= 0.0, xp.minimum(stepped, highest), xp.maximum(stepped, lowest))


def find_base_step(pair: WheelPair, left_rad: Column, right_rad: Column) -> tuple[Column, Column]:
    """Find the distance [m] and rotation [rad] of the base for wheel rotations [rad]."""
    left_radius, right_radius = pair.radii_m
    left_m, right_m = left_rad * left_radius, right_rad * right_radius
    return (left_m + right_m) / 2.0, (right_m - left_m) / pair.separation_m


def integrate_base_step(
    pose: PlanarTwist[Column], distance_m: Column, turned_rad: Column, xp: ColumnMath[Column]
) -> tuple[Column, Column, Column]:
    """Advance a pose x, y [m], yaw [rad] by a step, along its middle heading as Gazebo does."""
    x, y, yaw = pose
    middle = yaw + turned_rad / 2.0
    return x + distance_m * xp.cos(middle), y + distance_m * xp.sin(middle), yaw + turned_rad
