"""Planar motion: the base takes the planar part of the commanded twist."""

from typing import Generic

from zensim.proto.drives.column_math import Column, ColumnMath
from zensim.proto.drives.measured_joints import Columns, MeasuredJoints, PlanarTwist

MAX_PLANAR_SPEED = 1e6
"""Speed beyond that of any robot [m/s, rad/s]; keeps targets finite for every twist."""


class PlanarMotion(Generic[Column]):
    """Base that moves with the commanded twist itself: x, y and yaw."""

    state_size = 0

    def __init__(self, xp: ColumnMath[Column]) -> None:
        self._xp: ColumnMath[Column] = xp

    def find_targets(
        self,
        twist: PlanarTwist[Column],
        *,
        measured: MeasuredJoints[Column],  # noqa: ARG002 - of the protocol
        state: Columns[Column],
        dt_s: Column,  # noqa: ARG002 - of the protocol
    ) -> tuple[Columns[Column], Columns[Column]]:
        """Find vx, vy [m/s] and wz [rad/s] in the base; see `DriveKinematics`."""
        return tuple(self._xp.clamp(speed, MAX_PLANAR_SPEED) for speed in twist), state
