"""Dark patches on the ground below robots: WebGL in software draws no shadows. NumPy only."""

from typing import Final

import numpy as np

from zensim.proto.se3 import FloatArray, to_yaw
from zensim.spawner.page.model_visuals import Array, ColouredMesh, TriangleMesh

MAX_SHADOWS: Final = 200
"""Robots of a model up to which they have patches: those of more are small, and take time."""
GROUND_M: Final = 0.003
LAYER_M: Final = 0.0005
"""Distance of the layers of a patch."""
MARGINS: Final = (0.7, 0.55, 0.4, 0.25, 0.1, -0.05, -0.2)
"""How far the layers reach beyond the robot, in halves of its lesser extent: a soft edge."""
OPACITY: Final = 0.09
CUT: Final = 0.55
"""Share of a side at which its corner is cut."""
OUTLINE: Final = np.array(
    [(1, CUT), (CUT, 1), (-CUT, 1), (-1, CUT), (-1, -CUT), (-CUT, -1), (CUT, -1), (1, -CUT)]
)


def make_shadow(bounds: Array) -> ColouredMesh:
    """Make the patch of a robot with these lowest and highest corners (2, 3) in its base."""
    centre, halves = bounds[:, :2].mean(axis=0), np.ptp(bounds[:, :2], axis=0) / 2.0
    layers, faces = [], []
    fan = np.array([(0, i, i + 1) for i in range(1, len(OUTLINE) - 1)], np.uint32)
    for number, margin in enumerate(MARGINS):
        rim = centre + OUTLINE * (halves + margin * halves.min())
        layers.append(np.column_stack([rim, np.full(len(rim), number * LAYER_M)]))
        faces.append(fan + np.uint32(number * len(OUTLINE)))
    mesh = TriangleMesh(np.concatenate(layers), np.concatenate(faces))
    return ColouredMesh(mesh, (0.0, 0.0, 0.0, OPACITY), is_smooth=False, has_file=False)


def find_ground_poses(base: FloatArray) -> FloatArray:
    """Find the poses (k, 7) of patches below bases (k, 7); none of more than `MAX_SHADOWS`."""
    poses = np.array(base[: len(base) if len(base) <= MAX_SHADOWS else 0])
    half = to_yaw(poses[:, 3:7]) / 2.0
    poses[:, 2], poses[:, 3:5] = GROUND_M, 0.0
    poses[:, 5], poses[:, 6] = np.sin(half), np.cos(half)
    return poses
