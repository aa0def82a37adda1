"""Tricycle: speed and steering angle to the driven and steered wheel."""

import math

from zensim.proto.messages.drive_messages import TricycleDrive
from zensim.proto.messages.standard_messages import Twist
from zensim.robot_agent.drives.drive_controller import MeasuredJoints, clamp

MAX_WHEEL_SPEED = 1e6
"""Far beyond any wheel [rad/s]; keeps every target finite, whatever twist comes."""


class TricycleSteering:
    """Turns twists into the speed of the actuated wheel and into its steering."""

    def __init__(self, parameters: TricycleDrive) -> None:
        self._parameters = parameters
        self._radius = parameters.actuated_wheel_diameter_m / 2.0
        self.memory: tuple[float, ...] = ()

    def reset(self) -> None:
        """Do nothing: it remembers nothing."""

    def update(
        self, twist: Twist, *, measured: MeasuredJoints, elapsed_s: float
    ) -> tuple[float, ...]:
        """Find the wheel's speed [rad/s] and its angle [rad], or the speed of steering [rad/s].

        Args:
            twist: linear.x is the speed of the actuated wheel's rim [m/s], angular.z the steering
                angle [rad], a right angle at most.
            measured: Wheel, then steering joint.
            elapsed_s: As in the protocol.
        """
        wanted = clamp(twist.linear.x / self._radius, MAX_WHEEL_SPEED)
        angle = clamp(twist.angular.z, math.pi / 2.0)
        speed = self._limited(wanted, measured, elapsed_s)
        if self._parameters.max_steering_speed > 0.0:
            return (speed, self._steering_speed(angle - measured.positions[1], elapsed_s))
        return (speed, angle)

    def _limited(self, wanted: float, measured: MeasuredJoints, elapsed_s: float) -> float:
        faster, slower = self._parameters.max_acceleration, self._parameters.max_deceleration
        if faster == slower == 0.0:
            return wanted
        current = measured.velocities[0]
        if abs(wanted - current) < self._parameters.speed_tolerance:
            return wanted
        # 0 is no limit on its side only.
        up = current + faster * elapsed_s if faster > 0.0 else math.inf
        down = current - slower * elapsed_s if slower > 0.0 else -math.inf
        return min(max(wanted, down), up)

    def _steering_speed(self, missing_rad: float, elapsed_s: float) -> float:
        if abs(missing_rad) < self._parameters.angle_tolerance:
            return 0.0
        # No faster than it takes to be there: Gazebo swings about the angle.
        fastest = self._parameters.max_steering_speed
        return clamp(missing_rad / elapsed_s, fastest) if elapsed_s > 0.0 else 0.0
