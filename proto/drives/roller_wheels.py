"""Mecanum and omni wheels: the base takes the limited twist, and the wheels turn along."""

from typing import Generic

from zensim.proto.drives.column_math import Column, ColumnMath
from zensim.proto.drives.differential_drive import limit_velocity
from zensim.proto.drives.measured_joints import Columns, MeasuredJoints, PlanarTwist
from zensim.proto.drives.planar_motion import MAX_PLANAR_SPEED
from zensim.proto.messages.drive_messages import Limits, OmniDrive


class RollerWheels(Generic[Column]):
    """Base that moves with the limited twist; the speed of each wheel is linear in it.

    State: limited vx, vy and wz; none if nothing is limited.
    """

    def __init__(self, parameters: OmniDrive, xp: ColumnMath[Column]) -> None:
        self._wheels = parameters.wheels
        self._limits = (
            parameters.linear_limits,
            parameters.lateral_limits,
            parameters.angular_limits,
        )
        self._xp: ColumnMath[Column] = xp
        self.state_size = 3 if any(limits != Limits() for limits in self._limits) else 0

    def find_targets(
        self,
        twist: PlanarTwist[Column],
        *,
        measured: MeasuredJoints[Column],  # noqa: ARG002 - of the protocol
        state: Columns[Column],
        dt_s: Column,
    ) -> tuple[Columns[Column], Columns[Column]]:
        """Find vx, vy [m/s], wz [rad/s] and the wheel speeds [rad/s]; see `DriveKinematics`."""
        vx, vy, wz = (self._xp.clamp(speed, MAX_PLANAR_SPEED) for speed in twist)
        if state:
            vx, vy, wz = state = tuple(
                limit_velocity(limits, speed, now, dt_s, self._xp)
                for limits, speed, now in zip(self._limits, (vx, vy, wz), state, strict=True)
            )
        targets = [vx, vy, wz]
        targets += [one.ahead * vx + one.left * vy + one.turn * wz for one in self._wheels]
        return tuple(targets), state
