"""Twists of robots from a direction and speeds, by what their drives can do."""

from typing import Final

import msgspec

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    Limits,
    OmniDrive,
    PlanarMove,
    SteeringDrive,
    TricycleDrive,
)
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.spawner.teleop.key_bindings import Direction

MAX_TRICYCLE_STEER_RAD: Final = 0.8
"""Limit of a tricycle, whose description has none; at a right angle it would turn on the spot."""
USUAL_SPEED_M_S: Final = 0.5
USUAL_TURN_RAD_S: Final = 1.5
"""Turn rate of drives without a limit; `USUAL_SPEED_M_S` is their speed."""
TURN_RADIUS_M: Final = 1.0
"""Assumed of steered robots that are commanded by turn rate: turn by speed at full lock."""


class Speeds(msgspec.Struct, frozen=True):
    """Speeds at full deflection; all > 0."""

    linear: float = 0.5
    """[m/s]."""
    angular: float = 1.0
    """[rad/s]; of robots that are commanded by steering angle, that angle [rad]."""
    lateral: float | None = None
    """Sideways [m/s]; None = as ahead."""

    def scale(self, linear: float, angular: float) -> "Speeds":
        """Multiply by factors."""
        lateral = None if self.lateral is None else self.lateral * linear
        return Speeds(self.linear * linear, self.angular * angular, lateral)


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


def find_full_speeds(drive: Drive) -> Speeds:
    """Find the speeds that a drive permits, else usual ones."""
    angle = find_drive_style(drive).max_angle_rad
    match drive:
        case DiffDrive():
            return Speeds(_find_most(drive.linear_limits), _find_turn(drive.angular_limits))
        case OmniDrive():
            return Speeds(
                _find_most(drive.linear_limits),
                _find_turn(drive.angular_limits),
                _find_most(drive.lateral_limits),
            )
        case AckermannDrive() | SteeringDrive():
            speed = min(drive.max_speed, USUAL_SPEED_M_S * 2.0)
            return Speeds(speed, speed / TURN_RADIUS_M if angle is None else angle)
    return Speeds(USUAL_SPEED_M_S, USUAL_TURN_RAD_S if angle is None else angle)


def _find_most(limits: Limits) -> float:
    return limits.max_velocity or USUAL_SPEED_M_S


def _find_turn(limits: Limits) -> float:
    return limits.max_velocity or USUAL_TURN_RAD_S


def make_twist(direction: Direction, speeds: Speeds, style: DriveStyle) -> Twist:
    """Make the twist that moves a robot in a direction; what its drive cannot do is left out."""
    lateral = speeds.linear if speeds.lateral is None else speeds.lateral
    sideways = lateral * direction.left if style.is_holonomic else 0.0
    angular = speeds.angular
    if style.max_angle_rad is not None:
        angular = min(angular, style.max_angle_rad)
    return Twist(
        # Plus 0.0, which makes 0.0 of -0.0.
        Vector3(x=speeds.linear * direction.ahead + 0.0, y=sideways + 0.0),
        Vector3(z=angular * direction.turn + 0.0),
    )
