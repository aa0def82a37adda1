"""Ackermann steering: speed and steering angle to rear wheel speeds and front steering angles."""

import math

from zensim.proto.messages.drive_messages import AckermannDrive
from zensim.proto.messages.standard_messages import Twist
from zensim.robot_agent.drives.drive_controller import MeasuredJoints, clamp

MAX_STEER_RAD = 1.5
"""Short of a right angle, where a car has no turning circle."""


class AckermannSteering:
    """Steers both front wheels at the one point that the rear axle's line goes through."""

    def __init__(self, parameters: AckermannDrive) -> None:
        self._parameters = parameters
        self._half_track = parameters.track_m / 2.0
        self._ratio = parameters.max_steering_angle / max(parameters.max_steer, 1e-9)
        self._has_steering_wheel = bool(parameters.steering_wheel_joint)
        self.memory: tuple[float, ...] = ()

    def reset(self) -> None:
        """Do nothing: it remembers nothing."""

    def update(
        self,
        twist: Twist,
        *,
        measured: MeasuredJoints,
        elapsed_s: float,  # noqa: ARG002 - of the protocol
    ) -> tuple[float, ...]:
        """Find rear wheel speeds [rad/s] and steering angles [rad]; see `Controller.update`.

        Args:
            twist: linear.x is the speed of the rear axle [m/s], angular.z the steering angle [rad];
                in reverse it steers to the other side.
            measured: As in the protocol; the steering wheel follows the front wheels.
            elapsed_s: Not used.
        """
        parameters = self._parameters
        speed = clamp(twist.linear.x, parameters.max_speed)
        steer = clamp(
            twist.angular.z * math.copysign(1.0, twist.linear.x),
            min(parameters.max_steer, MAX_STEER_RAD),
        )
        # Radians turned a metre driven, by the middle of the rear axle.
        curvature = math.tan(steer) / parameters.wheelbase_m
        inner, outer = 1.0 - curvature * self._half_track, 1.0 + curvature * self._half_track
        rim = speed / parameters.wheel_radius_m
        angles = (math.atan2(math.tan(steer), inner), math.atan2(math.tan(steer), outer))
        return (rim * inner, rim * outer, *angles, *self._steering_wheel(measured))

    def _steering_wheel(self, measured: MeasuredJoints) -> tuple[float, ...]:
        if not self._has_steering_wheel:
            return ()
        left, right = measured.positions[2:4]
        return ((left + right) / 2.0 * self._ratio,)
