"""Controllers of many robots with the same drive; each row is what `robot_agent.drives` finds."""

import math
from typing import Protocol

import numpy as np

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    Limits,
    PlanarMove,
    TricycleDrive,
)
from zensim.robot_agent.drives.ackermann import LARGEST_STEER_RAD
from zensim.robot_agent.drives.diff_drive import MAX_LEAD_M_S, MAX_RIM_SPEED_M_S, REACHED_M_S
from zensim.robot_agent.drives.planar_move import MAX_SPEED
from zensim.robot_agent.drives.tricycle import MAX_WHEEL_SPEED
from zensim.robot_agent.drives.twist_limits import UNLIMITED
from zensim.robot_agent.pool.rows import FloatArray, IntArray, carried

VX, VY, WZ = 0, 1, 5
"""Columns of a twist (n, 6)."""


class Controllers(Protocol):
    """Finds what the actuators of many robots are to do."""

    def recut(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""

    def reset(self) -> None:
        """Forget what was told before."""

    def update(
        self,
        rows: IntArray,
        twists: FloatArray,
        *,
        positions: FloatArray,
        velocities: FloatArray,
        elapsed_s: FloatArray,
    ) -> FloatArray:
        """Find the numbers for the actuators of some rows, (m, target_count).

        Args:
            rows: Which robots; (m,).
            twists: As commanded to the bases; (m, 6).
            positions: Of the joints of the actuators [rad], as they are; (m, joints).
            velocities: [rad/s].
            elapsed_s: Simulation time since each row's last update; (m,).
        """


def controllers_of(drive: Drive) -> Controllers:
    """Make the controllers of robots with this drive."""
    match drive:
        case DiffDrive():
            return DifferentialDrives(drive)
        case AckermannDrive():
            return AckermannSteerings(drive)
        case TricycleDrive():
            return TricycleSteerings(drive)
        case PlanarMove():
            return PlanarMotions()


class LimitedVelocities:
    """See `drives.twist_limits.LimitedVelocity`."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._now = np.zeros(0)

    def recut(self, before: IntArray) -> None:
        """See `Controllers`."""
        self._now = carried(self._now, before)

    def reset(self) -> None:
        """See `Controllers`."""
        self._now[:] = 0.0

    def update(self, rows: IntArray, wanted: FloatArray, elapsed_s: FloatArray) -> FloatArray:
        """Find the velocities (m,) after so much simulation time."""
        limits = self._limits
        if limits == UNLIMITED:
            return wanted
        found = _between(wanted, limits.min_velocity, limits.max_velocity)
        now = self._now[rows]
        if limits.max_acceleration is not None:
            found = np.minimum(found, now + limits.max_acceleration * elapsed_s)
        if limits.min_acceleration is not None:
            found = np.maximum(found, now + limits.min_acceleration * elapsed_s)
        self._now[rows] = found
        return found


class DifferentialDrives:
    """See `drives.diff_drive.DifferentialDrive`."""

    def __init__(self, parameters: DiffDrive) -> None:
        pairs = parameters.pairs
        self._radii = np.array([pair.diameter_m / 2.0 for pair in pairs for _ in range(2)])
        self._separations = np.array([pair.separation_m for pair in pairs])
        self._max_acceleration = parameters.max_acceleration
        self._instructed = np.zeros((0, 2 * len(pairs)))
        self._linear = LimitedVelocities(parameters.linear_limits)
        self._angular = LimitedVelocities(parameters.angular_limits)

    def recut(self, before: IntArray) -> None:
        """See `Controllers`."""
        self._instructed = carried(self._instructed, before)
        self._linear.recut(before)
        self._angular.recut(before)

    def reset(self) -> None:
        """See `Controllers`."""
        self._instructed[:] = 0.0
        self._linear.reset()
        self._angular.reset()

    def update(
        self,
        rows: IntArray,
        twists: FloatArray,
        *,
        positions: FloatArray,  # noqa: ARG002 - of the protocol
        velocities: FloatArray,
        elapsed_s: FloatArray,
    ) -> FloatArray:
        """See `Controllers`."""
        desired = self._desired_rims(
            self._linear.update(rows, twists[:, VX], elapsed_s),
            self._angular.update(rows, twists[:, WZ], elapsed_s),
        )
        if self._max_acceleration > 0.0:
            desired = self._limited(rows, desired, velocities, elapsed_s)
        return np.asarray(desired / self._radii)

    def _desired_rims(self, speed: FloatArray, turn: FloatArray) -> FloatArray:
        sides = turn[:, None] * self._separations / 2.0
        rims = np.empty((len(speed), len(self._radii)))
        rims[:, 0::2] = speed[:, None] - sides
        rims[:, 1::2] = speed[:, None] + sides
        return _clamped(rims, MAX_RIM_SPEED_M_S)

    def _limited(
        self, rows: IntArray, desired: FloatArray, velocities: FloatArray, elapsed_s: FloatArray
    ) -> FloatArray:
        errors = desired - velocities * self._radii
        is_near = np.abs(errors) < REACHED_M_S
        has_reached = np.repeat(is_near[:, 0::2] & is_near[:, 1::2], 2, axis=1)
        reach = self._max_acceleration * elapsed_s[:, None]
        before = self._instructed[rows]
        stepped = _stepped(before, desired, np.minimum(np.maximum(errors, -reach), reach))
        # What was instructed before stays remembered, as in Gazebo.
        self._instructed[rows] = np.where(has_reached, before, stepped)
        return np.where(has_reached, desired, stepped)


def _stepped(instructed: FloatArray, desired: FloatArray, step: FloatArray) -> FloatArray:
    highest = np.maximum(instructed, np.maximum(desired, 0.0) + MAX_LEAD_M_S)
    lowest = np.minimum(instructed, np.minimum(desired, 0.0) - MAX_LEAD_M_S)
    moved = instructed + step
    return np.where(step >= 0.0, np.minimum(moved, highest), np.maximum(moved, lowest))


class Forgetful:
    """Controllers that remember nothing of the twists before."""

    def recut(self, before: IntArray) -> None:
        """Do nothing: it remembers nothing."""

    def reset(self) -> None:
        """Do nothing: it remembers nothing."""


class PlanarMotions(Forgetful):
    """See `drives.planar_move.PlanarMotion`."""

    def update(
        self,
        rows: IntArray,  # noqa: ARG002 - of the protocol
        twists: FloatArray,
        *,
        positions: FloatArray,  # noqa: ARG002
        velocities: FloatArray,  # noqa: ARG002
        elapsed_s: FloatArray,  # noqa: ARG002
    ) -> FloatArray:
        """See `Controllers`."""
        return _clamped(twists[:, (VX, VY, WZ)], MAX_SPEED)


class AckermannSteerings(Forgetful):
    """See `drives.ackermann.AckermannSteering`."""

    def __init__(self, parameters: AckermannDrive) -> None:
        self._parameters = parameters
        self._half_track = parameters.track_m / 2.0
        self._ratio = parameters.max_steering_angle / max(parameters.max_steer, 1e-9)

    def update(
        self,
        rows: IntArray,  # noqa: ARG002 - of the protocol
        twists: FloatArray,
        *,
        positions: FloatArray,
        velocities: FloatArray,  # noqa: ARG002
        elapsed_s: FloatArray,  # noqa: ARG002
    ) -> FloatArray:
        """See `Controllers`."""
        parameters = self._parameters
        speed = _clamped(twists[:, VX], parameters.max_speed)
        most = min(parameters.max_steer, LARGEST_STEER_RAD)
        steer = _clamped(twists[:, WZ] * np.copysign(1.0, twists[:, VX]), most)
        slope = np.tan(steer)
        bend = slope / parameters.wheelbase_m * self._half_track
        rim = speed / parameters.wheel_radius_m
        columns = [
            rim * (1.0 - bend),
            rim * (1.0 + bend),
            np.arctan2(slope, 1.0 - bend),
            np.arctan2(slope, 1.0 + bend),
        ]
        if parameters.steering_wheel_joint:
            columns.append((positions[:, 2] + positions[:, 3]) / 2.0 * self._ratio)
        return np.stack(columns, axis=1)


class TricycleSteerings(Forgetful):
    """See `drives.tricycle.TricycleSteering`."""

    def __init__(self, parameters: TricycleDrive) -> None:
        self._parameters = parameters
        self._radius = parameters.actuated_wheel_diameter_m / 2.0

    def update(
        self,
        rows: IntArray,  # noqa: ARG002 - of the protocol
        twists: FloatArray,
        *,
        positions: FloatArray,
        velocities: FloatArray,
        elapsed_s: FloatArray,
    ) -> FloatArray:
        """See `Controllers`."""
        wanted = _clamped(twists[:, VX] / self._radius, MAX_WHEEL_SPEED)
        steering = _clamped(twists[:, WZ], math.pi / 2.0)
        speed = self._limited(wanted, velocities[:, 0], elapsed_s)
        if self._parameters.max_steering_speed > 0.0:
            steering = self._steering_speed(steering - positions[:, 1], elapsed_s)
        return np.stack([speed, steering], axis=1)

    def _limited(
        self, wanted: FloatArray, current: FloatArray, elapsed_s: FloatArray
    ) -> FloatArray:
        faster, slower = self._parameters.max_acceleration, self._parameters.max_deceleration
        if faster == slower == 0.0:
            return wanted
        # 0 is no limit on its side only.
        up = current + faster * elapsed_s if faster > 0.0 else math.inf
        down = current - slower * elapsed_s if slower > 0.0 else -math.inf
        found = np.minimum(np.maximum(wanted, down), up)
        return np.where(np.abs(wanted - current) < self._parameters.speed_tolerance, wanted, found)

    def _steering_speed(self, missing_rad: FloatArray, elapsed_s: FloatArray) -> FloatArray:
        is_moving = elapsed_s > 0.0
        speed = missing_rad / np.where(is_moving, elapsed_s, 1.0)
        has_arrived = np.abs(missing_rad) < self._parameters.angle_tolerance
        found = _clamped(speed, self._parameters.max_steering_speed)
        return np.where(has_arrived | ~is_moving, 0.0, found)


def _clamped(values: FloatArray, limit: float) -> FloatArray:
    return np.minimum(np.maximum(values, -limit), limit)


def _between(values: FloatArray, low: float | None, high: float | None) -> FloatArray:
    if high is not None:
        values = np.minimum(values, high)
    return values if low is None else np.maximum(values, low)
