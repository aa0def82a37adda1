"""Drive kinematics of one robot, with their state kept."""

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.drives.drive_kinematics import make_drive_kinematics
from zensim.proto.drives.measured_joints import MeasuredJoints
from zensim.proto.messages.drive_messages import Drive


class SingleDrive:
    """A drive that is updated again and again."""

    def __init__(self, drive: Drive) -> None:
        self._kinematics = make_drive_kinematics(drive, FLOAT_MATH)
        self.reset()

    def reset(self) -> None:
        """Start at rest."""
        self._state = (0.0,) * self._kinematics.state_size

    def update(
        self,
        vx: float = 0.0,
        wz: float = 0.0,
        *,
        vy: float = 0.0,
        positions: tuple[float, ...] = (),
        velocities: tuple[float, ...] = (),
        dt_s: float = 0.01,
    ) -> tuple[float, ...]:
        """Find the targets after a period."""
        targets, self._state = self._kinematics.find_targets(
            (vx, vy, wz),
            measured=MeasuredJoints(positions, velocities),
            state=self._state,
            dt_s=dt_s,
        )
        return targets
