"""Ackermann steering: speed and steering angle to rear wheel speeds and front steering angles."""

from typing import Generic

from zensim.proto.drives.column_math import Column, ColumnMath
from zensim.proto.drives.measured_joints import Columns, MeasuredJoints, PlanarTwist
from zensim.proto.messages.drive_messages import AckermannDrive

MAX_STEER_RAD = 1.5
"""Largest steering angle; a car has no turning circle at a right angle."""


class AckermannSteering(Generic[Column]):
    """Steering of both front wheels about one point on the line of the rear axle."""

    state_size = 0

    def __init__(self, parameters: AckermannDrive, xp: ColumnMath[Column]) -> None:
        self._parameters = parameters
        self._xp: ColumnMath[Column] = xp
        self._half_track = parameters.track_m / 2.0
        self._ratio = parameters.max_steering_angle / max(parameters.max_steer, 1e-9)

    def find_targets(
        self,
        twist: PlanarTwist[Column],
        *,
        measured: MeasuredJoints[Column],
        state: Columns[Column],
        dt_s: Column,  # noqa: ARG002 - of the protocol
    ) -> tuple[Columns[Column], Columns[Column]]:
        """Find rear wheel speeds [rad/s] and steering angles [rad]; see `DriveKinematics`.

        Args:
            twist: vx is the speed of the rear axle [m/s], wz the steering angle [rad]; in reverse
                it steers to the other side.
            measured: The steering wheel, if any, follows the measured front wheels.
            state: Not used, as dt_s.
            dt_s: Not used.
        """
        parameters, xp = self._parameters, self._xp
        vx, _, angle = twist
        speed = xp.clamp(vx, parameters.max_speed)
        most = min(parameters.max_steer, MAX_STEER_RAD)
        slope = xp.tan(xp.clamp(angle * xp.copysign(1.0, vx), most))
        # Radians turned per metre driven by the middle of the rear axle.
        curvature = slope / parameters.wheelbase_m
        left, right = 1.0 - curvature * self._half_track, 1.0 + curvature * self._half_track
        rim = speed / parameters.wheel_radius_m
        targets = [rim * left, rim * right, xp.arctan2(slope, left), xp.arctan2(slope, right)]
        if parameters.steering_wheel_joint:
            front_left, front_right = measured.positions[2:4]
            targets.append((front_left + front_right) / 2.0 * self._ratio)
        return tuple(targets), state
