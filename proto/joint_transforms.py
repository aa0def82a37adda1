"""Transforms of the moving joints of many robots of one model, in arrays."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.messages.model_messages import Joint
from zensim.proto.rigid_transforms import multiply, normalize, rotate, rotate_about
from zensim.proto.se3 import FloatArray

POSE_COLUMNS: Final = 7
ODOMETRY: Final = -1
"""Stands for odometry among the joints of moving frames."""


class JointTransforms:
    """Transforms of some joints at any positions.

    `zensim.robot_agent.robot_frames.MovingJoint` is the same for one joint.
    """

    def __init__(self, joints: Sequence[Joint]) -> None:
        """Stack the constants of joints that move."""
        self.count = len(joints)
        self._at = np.array([joint.origin.position for joint in joints]).reshape(-1, 3)
        self._turned = np.array([joint.origin.orientation for joint in joints]).reshape(-1, 4)
        self._axes = np.array([normalize(joint.axis) for joint in joints]).reshape(-1, 3)
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
            x, y, z = self._axes[turns].T
            turn = rotate_about((x, y, z), positions[:, turns], ARRAY_MATH)
            ox, oy, oz, ow = self._turned[turns].T
            found[:, turns, 3:] = np.stack(multiply((ox, oy, oz, ow), turn), axis=-1)
        if len(slides):
            ox, oy, oz, ow = self._turned[slides].T
            shift = self._axes[slides] * positions[:, slides, None]
            moved = rotate((ox, oy, oz, ow), (shift[..., 0], shift[..., 1], shift[..., 2]))
            found[:, slides, :3] += np.stack(moved, axis=-1)
        return found


class FramePoses:
    """Poses of moving frames of equal robots, in the order of their transforms.

    Pools publish them, and recorders make them of the odometry of a fleet: with equal bytes.
    """

    def __init__(self, columns: Sequence[int], joints: Sequence[Joint]) -> None:
        """Stack the constants.

        Args:
            columns: Of the position of each frame's joint, or `ODOMETRY`.
            joints: In this order, without odometry.
        """
        of_frames = np.array(columns, dtype=np.int64)
        self._count = len(of_frames)
        self._is_joint = of_frames != ODOMETRY
        self._columns = of_frames[self._is_joint]
        self._joints = JointTransforms(joints)

    def find(self, motions: FloatArray, positions: FloatArray) -> FloatArray:
        """Find the poses, (m, 7 * frames).

        Args:
            motions: Pose of the base in its odometry frame, and more, (m, 7 or more).
            positions: Of joints [rad or m], (m, ...).
        """
        found = np.empty((len(motions), self._count, POSE_COLUMNS))
        found[:, self._is_joint] = self._joints.poses(positions[:, self._columns])
        found[:, ~self._is_joint] = motions[:, None, :POSE_COLUMNS]
        return found.reshape(len(motions), -1)
