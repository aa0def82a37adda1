"""A base that takes the commanded twist itself, as Gazebo's planar_move moves it.

Source: gazebo_ros_planar_move of gazebo_ros_pkgs, ROS 2 branch.
"""

from zensim.proto.messages.standard_messages import Twist
from zensim.robot_agent.drives.controller import Measured, clamped

MAX_SPEED = 1e6
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
        measured: Measured,  # noqa: ARG002 - of the protocol
        elapsed_s: float,  # noqa: ARG002
    ) -> tuple[float, ...]:
        """Find vx, vy [m/s] and wz [rad/s] in the base; see `Controller.update`."""
        wanted = (twist.linear.x, twist.linear.y, twist.angular.z)
        return tuple(clamped(speed, MAX_SPEED) for speed in wanted)
