"""Planar motion: the base follows the planar part of the commanded twist."""

from zensim.proto.messages.standard_messages import Twist
from zensim.robot_agent.drives.drive_controller import MeasuredJoints, clamp

MAX_PLANAR_SPEED = 1e6
"""Far beyond any robot; keeps the body finite, whatever twist comes."""


class PlanarMotion:
    """Passes on what is planar of a twist: x, y and yaw."""

    def __init__(self) -> None:
        self.memory: tuple[float, ...] = ()

    def reset(self) -> None:
        """Do nothing: it remembers nothing."""

    def update(
        self,
        twist: Twist,
        *,
        measured: MeasuredJoints,  # noqa: ARG002 - of the protocol
        elapsed_s: float,  # noqa: ARG002
    ) -> tuple[float, ...]:
        """Find vx, vy [m/s] and wz [rad/s] in the base; see `Controller.update`."""
        wanted = (twist.linear.x, twist.linear.y, twist.angular.z)
        return tuple(clamp(speed, MAX_PLANAR_SPEED) for speed in wanted)
