"""Inputs of drive kinematics: planar twist and measured joints, in columns."""

from collections.abc import Sequence
from typing import Generic, TypeAlias

import msgspec

from zensim.proto.drives.column_math import Column

Columns: TypeAlias = tuple[Column, ...]
PlanarTwist: TypeAlias = tuple[Column, Column, Column]
"""vx, vy [m/s] and wz [rad/s], as commanded."""


class MeasuredJoints(msgspec.Struct, Generic[Column], frozen=True, gc=False):
    """Measured state of the joints of a drive's actuators, in order; empty for a twist."""

    positions: Sequence[Column] = ()
    """Positions [rad]."""
    velocities: Sequence[Column] = ()
    """Velocities [rad/s]."""
