"""Steering by turn rate: speed and turn rate to wheel speeds and steering angles."""

from typing import Generic

from zensim.proto.drives.column_math import Column, ColumnMath
from zensim.proto.drives.measured_joints import Columns, MeasuredJoints, PlanarTwist
from zensim.proto.messages.drive_messages import PAIR_SIZE, SteeringDrive


def find_roll_signs(parameters: SteeringDrive) -> tuple[float, ...]:
    """Find the direction in which each driven wheel rolls at positive speed."""
    return tuple(-1.0 if one in parameters.reversed_wheels else 1.0 for one in parameters.traction)


class RateSteering(Generic[Column]):
    """Steering about one point on the line of the unsteered axle.

    Source: steering_controllers_library and tricycle_controller of ros2_controllers.
    """

    state_size = 0

    def __init__(self, parameters: SteeringDrive, xp: ColumnMath[Column]) -> None:
        self._parameters = parameters
        self._signs = find_roll_signs(parameters)
        self._xp: ColumnMath[Column] = xp

    def find_targets(
        self,
        twist: PlanarTwist[Column],
        *,
        measured: MeasuredJoints[Column],  # noqa: ARG002 - of the protocol
        state: Columns[Column],
        dt_s: Column,  # noqa: ARG002 - of the protocol
    ) -> tuple[Columns[Column], Columns[Column]]:
        """Find wheel speeds [rad/s] and steering angles [rad]; see `DriveKinematics`.

        Args:
            twist: vx is the speed of the unsteered axle, or of the middle between two steered
                ones [m/s], wz the turn rate [rad/s].
            measured: Not used, as state and dt_s.
            state: Not used.
            dt_s: Not used.
        """
        parameters, xp = self._parameters, self._xp
        speed = xp.clamp(twist[0], parameters.max_speed)
        forward = xp.copysign(1.0, speed)
        # Speed of the steered axle to its left, with the vehicle turned to drive forward.
        aside = xp.clamp(twist[2] * parameters.wheelbase_m, parameters.max_speed) * forward
        angle = xp.clamp(xp.arctan2(aside, abs(speed)), parameters.max_steer)
        if parameters.is_traction_steered:
            rim = forward * (abs(speed) * xp.cos(angle) + aside * xp.sin(angle))
            return (rim / parameters.wheel_radius_m * self._signs[0], angle), state
        slope = xp.tan(angle)
        angles = self._find_angles(angle, slope)
        if parameters.counter_steering:
            rims = self._find_steered_wheel_speeds(speed, slope, angles) * 2
            angles += tuple(-one for one in angles)
        else:
            rims = self._find_wheel_speeds(speed, slope)
        wheels = tuple(rim * sign for rim, sign in zip(rims, self._signs, strict=True))
        return wheels + angles, state

    def _find_steered_wheel_speeds(
        self, speed: Column, slope: Column, angles: Columns[Column]
    ) -> Columns[Column]:
        """Find the speeds of left and right wheels, alike on two axles that steer oppositely."""
        parameters, xp = self._parameters, self._xp
        bend = slope / parameters.wheelbase_m
        pivot = bend * (parameters.steering_track_m / 2.0)
        # A wheel beside its pivot turns about it.
        beside = bend * ((parameters.traction_track_m - parameters.steering_track_m) / 2.0)
        rim = speed / parameters.wheel_radius_m
        left, right = angles
        return (
            rim * ((1.0 - pivot) * xp.cos(left) + slope * xp.sin(left) - beside),
            rim * ((1.0 + pivot) * xp.cos(right) + slope * xp.sin(right) + beside),
        )

    def _find_wheel_speeds(self, speed: Column, slope: Column) -> Columns[Column]:
        rim = speed / self._parameters.wheel_radius_m
        if len(self._parameters.traction) < PAIR_SIZE:
            return (rim,)
        lead = slope / self._parameters.wheelbase_m * (self._parameters.traction_track_m / 2.0)
        return rim * (1.0 - lead), rim * (1.0 + lead)

    def _find_angles(self, angle: Column, slope: Column) -> Columns[Column]:
        if len(self._parameters.steering) < PAIR_SIZE:
            return (angle,)
        lead = slope / self._parameters.wheelbase_m * (self._parameters.steering_track_m / 2.0)
        return self._xp.arctan2(slope, 1.0 - lead), self._xp.arctan2(slope, 1.0 + lead)
