"""Where the frames of many robots are that move: the odometry frame, and those of moving joints."""

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Joint
from zensim.robot_agent.driven_base import motion_rates
from zensim.robot_agent.pool.driven import DrivenBases
from zensim.robot_agent.pool.joint_frames import POSE_COLUMNS, JointFrames
from zensim.robot_agent.pool.kinds import Kind
from zensim.robot_agent.pool.rate_gates import RateGates
from zensim.robot_agent.pool.rows import FloatArray, IntArray, carried


class FramePoses:
    """Remembers joints as they were when they were due; each row has a beat of its own."""

    def __init__(self, kind: Kind, bases: DrivenBases) -> None:
        """Take whose they are, and their motions."""
        self._bases = bases
        rate_hz = motion_rates(kind.drive)[2]
        self._gates = None if rate_hz is None else RateGates(rate_hz)
        self._has_odometry = kind.drive.publish_odom_tf
        self._frames = JointFrames(msgspec.msgpack.decode(kind.geometry, type=tuple[Joint, ...]))
        self._moving = list(kind.moving)
        self._positions = np.zeros((0, len(kind.moving)))
        self._found: tuple[IntArray, FloatArray] | None = None

    def carry(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self._found = None
        if self._gates is not None:
            self._gates.recut(before)
        self._positions = carried(self._positions, before)

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self._found = None
        if self._gates is not None:
            self._gates.reset()

    def take(self, rows: IntArray, positions: FloatArray, time_ns: int) -> IntArray:
        """Take the joints of those rows that are due, and return these.

        Args:
            rows: Whose motion is new.
            positions: Of all joints of all rows, (n, joint_count).
            time_ns: Simulation time.
        """
        self._found = None
        if len(rows) and self._gates is not None:
            is_open, _ = self._gates.open(time_ns)
            rows = np.intersect1d(rows, is_open, assume_unique=True)
        self._positions[rows] = positions[rows][:, self._moving]
        return rows

    def of(self, rows: IntArray) -> FloatArray:
        """Find the poses of some rows' frames, (m, 7 * frames); for the same rows but once."""
        if self._found is None or self._found[0] is not rows:
            self._found = rows, self._poses(rows)
        return self._found[1]

    def _poses(self, rows: IntArray) -> FloatArray:
        joints = self._frames.poses(self._positions[rows]).reshape(len(rows), -1)
        if not self._has_odometry:
            return joints
        return np.concatenate([self._bases.motions[rows, :POSE_COLUMNS], joints], axis=1)
