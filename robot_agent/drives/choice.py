"""Which controller a drive has."""

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    PlanarMove,
    TricycleDrive,
)
from zensim.robot_agent.drives.ackermann import AckermannSteering
from zensim.robot_agent.drives.controller import Controller
from zensim.robot_agent.drives.diff_drive import DifferentialDrive
from zensim.robot_agent.drives.planar_move import PlanarMotion
from zensim.robot_agent.drives.tricycle import TricycleSteering


def controller_of(drive: Drive) -> Controller:
    """Make the controller of a drive."""
    match drive:
        case DiffDrive():
            return DifferentialDrive(drive)
        case AckermannDrive():
            return AckermannSteering(drive)
        case TricycleDrive():
            return TricycleSteering(drive)
        case PlanarMove():
            return PlanarMotion()
