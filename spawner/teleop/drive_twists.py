"""Twists of robots from a direction and speeds, by what their drives can do."""

from typing import Final

import msgspec

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    Drive,
    OmniDrive,
    PlanarMove,
    SteeringDrive,
    TricycleDrive,
)
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.spawner.teleop.key_bindings import Direction

MAX_TRICYCLE_STEER_RAD: Final = 0.8
"""Its description has no limit; at a right angle it would turn on the spot."""


class Speeds(msgspec.Struct, frozen=True):
    """Speeds at full deflection; both > 0."""

    linear: float = 0.5
    """[m/s]."""
    angular: float = 1.0
    """[rad/s]; of robots that are commanded by steering angle, that angle [rad]."""

    def scale(self, linear: float, angular: float) -> "Speeds":
        """Multiply both by factors."""
        return Speeds(self.linear * linear, self.angular * angular)


class DriveStyle(msgspec.Struct, frozen=True):
    """How a drive follows a twist."""

    is_holonomic: bool = False
    is_steered: bool = False
    """Whether it turns only while it moves."""
    max_angle_rad: float | None = None
    """Greatest steering angle, where `angular.z` is one; None where it is a turn rate."""


def find_drive_style(drive: Drive | None) -> DriveStyle:
    """Find out how a drive follows a twist."""
    match drive:
        case PlanarMove() | OmniDrive():
            return DriveStyle(is_holonomic=True)
        case AckermannDrive():
            return DriveStyle(is_steered=True, max_angle_rad=drive.max_steer)
        case TricycleDrive():
            return DriveStyle(is_steered=True, max_angle_rad=MAX_TRICYCLE_STEER_RAD)
        case SteeringDrive():
            return DriveStyle(is_steered=True)
    return DriveStyle()


def make_twist(direction: Direction, speeds: Speeds, style: DriveStyle) -> Twist:
    """Make the twist that moves a robot in a direction; what its drive cannot do is left out."""
    sideways = speeds.linear * direction.left if style.is_holonomic else 0.0
    angular = speeds.angular
    if style.max_angle_rad is not None:
        angular = min(angular, style.max_angle_rad)
    return Twist(
        # Plus 0.0, which makes 0.0 of -0.0.
        Vector3(x=speeds.linear * direction.ahead + 0.0, y=sideways + 0.0),
        Vector3(z=angular * direction.turn + 0.0),
    )
