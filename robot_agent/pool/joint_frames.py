"""Where the joints of many robots of one model have their children."""

from collections.abc import Sequence

import numpy as np

from zensim.proto.messages.model_messages import Joint
from zensim.proto.rotation import multiply, rotate
from zensim.robot_agent.pool.rows import FloatArray
from zensim.robot_agent.transforms import unit

POSE_COLUMNS = 7


class JointFrames:
    """Transforms of some joints at any positions, as `frames.MovingJoint` has them."""

    def __init__(self, joints: Sequence[Joint]) -> None:
        """Take the joints.

        Args:
            joints: Those that move.
        """
        self.count = len(joints)
        self._at = np.array([joint.origin.position for joint in joints]).reshape(-1, 3)
        self._turned = np.array([joint.origin.orientation for joint in joints]).reshape(-1, 4)
        self._axes = np.array([unit(joint.axis) for joint in joints]).reshape(-1, 3)
        slides = np.array([joint.kind == "prismatic" for joint in joints], dtype=np.bool_)
        self._slides = np.flatnonzero(slides)
        self._turns = np.flatnonzero(~slides)

    def poses(self, positions: FloatArray) -> FloatArray:
        """Find poses (n, count, 7) of children in their parents.

        Args:
            positions: Of the joints [rad or m], (n, count).
        """
        found = np.empty((*positions.shape, POSE_COLUMNS))
        found[..., :3] = self._at
        found[..., 3:] = self._turned
        turns, slides = self._turns, self._slides
        if len(turns):
            half = positions[:, turns, None] / 2.0
            turn = np.concatenate([self._axes[turns] * np.sin(half), np.cos(half)], axis=-1)
            found[:, turns, 3:] = multiply(self._turned[turns], turn)
        if len(slides):
            shift = self._axes[slides] * positions[:, slides, None]
            found[:, slides, :3] += rotate(self._turned[slides], shift)
        return found
