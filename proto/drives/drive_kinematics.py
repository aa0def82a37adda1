"""Inverse kinematics of any drive: commanded twist in, actuator targets out."""

from typing import Protocol

from zensim.proto.drives.ackermann_steering import AckermannSteering
from zensim.proto.drives.column_math import Column, ColumnMath
from zensim.proto.drives.differential_drive import DifferentialDrive
from zensim.proto.drives.measured_joints import Columns, MeasuredJoints, PlanarTwist
from zensim.proto.drives.planar_motion import PlanarMotion
from zensim.proto.drives.rate_steering import RateSteering
from zensim.proto.drives.roller_wheels import RollerWheels
from zensim.proto.drives.tricycle_steering import TricycleSteering
from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    OmniDrive,
    PlanarMove,
    SteeringDrive,
    TricycleDrive,
)


class DriveKinematics(Protocol[Column]):
    """Inverse kinematics and limits of one drive; the caller keeps the state."""

    @property
    def state_size(self) -> int:
        """Number of state columns; each starts at 0."""

    def find_targets(
        self,
        twist: PlanarTwist[Column],
        *,
        measured: MeasuredJoints[Column],
        state: Columns[Column],
        dt_s: Column,
    ) -> tuple[Columns[Column], Columns[Column]]:
        """Find the targets of the drive's actuators, in order, and the next state.

        Args:
            twist: As commanded to the base.
            measured: Joints of the actuators.
            state: As returned by the update before.
            dt_s: Simulation time since the last update.
        """


def make_drive_kinematics(drive: Drive, xp: ColumnMath[Column]) -> DriveKinematics[Column]:
    """Make the kinematics of a drive."""
    match drive:
        case DiffDrive():
            return DifferentialDrive(drive, xp)
        case AckermannDrive():
            return AckermannSteering(drive, xp)
        case TricycleDrive():
            return TricycleSteering(drive, xp)
        case PlanarMove():
            return PlanarMotion(xp)
        case SteeringDrive():
            return RateSteering(drive, xp)
        case OmniDrive():
            return RollerWheels(drive, xp)
