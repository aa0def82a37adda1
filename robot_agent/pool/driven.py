"""Robots of one kind under their drives: states and twists in, targets and motions out.

Each row is what `robot_agent.driven_base.DrivenBase` finds; no network.
"""

import numpy as np

from zensim.robot_agent.driven_base import motion_rates
from zensim.robot_agent.pool.controllers import controllers_of
from zensim.robot_agent.pool.kinds import Kind
from zensim.robot_agent.pool.motions import (
    AT_REST,
    MOTION_COLUMNS,
    EncoderOdometries,
    world_motions,
)
from zensim.robot_agent.pool.rate_gates import RateGates
from zensim.robot_agent.pool.rows import FloatArray, IntArray, carried


class DrivenBases:
    """Keeps drives and odometries at their own rates."""

    def __init__(self, kind: Kind) -> None:
        drive = kind.drive
        self.targets = np.zeros((0, kind.target_count))
        """Numbers for `Model.actuators`, a row a robot."""
        self.motions = np.zeros((0, MOTION_COLUMNS))
        """As of each row's last odometry; see `motions`."""
        self._kind = kind
        self._measured = list(kind.measured)
        self._controllers = controllers_of(drive)
        self._gates = RateGates(drive.update_rate_hz)
        motion_hz = motion_rates(drive)[0]
        self._motion_gates = None if motion_hz is None else RateGates(motion_hz)
        self._encoders: EncoderOdometries | None = None
        if (pair := drive.encoder) is not None:
            is_unsigned = drive.compat == "gazebo11"
            self._encoders = EncoderOdometries(pair, is_speed_unsigned=is_unsigned)

    def recut(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self.targets = carried(self.targets, before)
        self.motions = carried(self.motions, before)
        self.motions[before < 0] = AT_REST
        for part in (self._controllers, self._gates, self._motion_gates, self._encoders):
            if part is not None:
                part.recut(before)

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self.targets[:] = 0.0
        self.motions[:] = AT_REST
        for part in (self._controllers, self._gates, self._motion_gates, self._encoders):
            if part is not None:
                part.reset()

    def update(
        self,
        time_ns: int,
        *,
        base: FloatArray,
        positions: FloatArray,
        velocities: FloatArray,
        twists: FloatArray,
    ) -> IntArray:
        """Take a state.

        Args:
            time_ns: Simulation time.
            base: States of root links, (n, STATE_COLUMNS).
            positions: Of all joints of each robot [rad or m], (n, joint_count).
            velocities: The same, a second.
            twists: As commanded, (n, 6).

        Returns:
            The rows whose motion is new.
        """
        if self._encoders is not None and self._kind.encoder is not None:
            self._encoders.update(positions[:, list(self._kind.encoder)], time_ns)
        rows, elapsed_s = self._gates.open(time_ns)
        if len(rows):
            self.targets[rows] = self._controllers.update(
                rows,
                twists[rows],
                positions=positions[rows][:, self._measured],
                velocities=velocities[rows][:, self._measured],
                elapsed_s=elapsed_s,
            )
        if self._motion_gates is not None:
            rows, _ = self._motion_gates.open(time_ns)
        if len(rows):
            self.motions[rows] = self._new_motions(rows, base)
        return rows

    def _new_motions(self, rows: IntArray, base: FloatArray) -> FloatArray:
        if self._encoders is not None:
            return self._encoders.motions[rows]
        return world_motions(base[rows], self._kind.base_in_root)
