"""Dark patches on the ground below robots: WebGL in software draws no shadows."""

from io import BytesIO
from typing import Final

import numpy as np
from PIL import Image

from zensim.proto.se3 import FloatArray, to_yaw
from zensim.spawner.page.model_visuals import Array, ColouredMesh, TriangleMesh

MAX_SHADOWS: Final = 200
"""Robots of a model up to which they have patches: those of more are small, and take time."""
GROUND_M: Final = 0.003
REACH: Final = 0.8
"""How far a patch reaches beyond the robot, in halves of its lesser extent."""
OPACITY: Final = 0.55
"""Opacity of the middle of a patch."""
PIXELS: Final = 64
"""Side of its picture."""
CORNERS: Final = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
FACES: Final = ((0, 1, 2), (0, 2, 3))


def make_shadow(bounds: Array) -> ColouredMesh:
    """Make the patch of a robot with these lowest and highest corners (2, 3) in its base."""
    centre, halves = bounds[:, :2].mean(axis=0), np.ptp(bounds[:, :2], axis=0) / 2.0
    reach = REACH * max(float(halves.min()), GROUND_M)
    corners = np.array(CORNERS)
    mesh = TriangleMesh(
        np.column_stack([centre + corners * (halves + reach), np.zeros(len(corners))]),
        np.array(FACES, np.uint32),
        ((corners + 1.0) / 2.0).astype(np.float32),
        _draw(halves, reach),
    )
    return ColouredMesh(mesh, (0.0, 0.0, 0.0, OPACITY), is_smooth=False, has_file=False)


def _draw(halves: Array, reach: float) -> bytes:
    """Draw a rectangle with soft edges as PNG: opaque in its middle, clear where it ends."""
    across, along = np.meshgrid(*((np.linspace(-1.0, 1.0, PIXELS) * (h + reach)) for h in halves))
    # From where a patch is darkest, well within the robot, to its end.
    within = halves - reach / 2.0
    beyond = np.maximum(np.abs(np.stack([across, along], axis=-1)) - within, 0.0)
    share = np.clip(1.0 - np.linalg.norm(beyond, axis=-1) / (1.5 * reach), 0.0, 1.0)
    opacity = share * share * (3.0 - 2.0 * share)
    pixels = np.zeros((PIXELS, PIXELS, 2), np.uint8)
    pixels[..., 1] = np.round(255.0 * opacity)
    picture = BytesIO()
    Image.fromarray(pixels, "LA").save(picture, "PNG")
    return picture.getvalue()


def find_ground_poses(base: FloatArray) -> FloatArray:
    """Find the poses (k, 7) of patches below bases (k, 7); none of more than `MAX_SHADOWS`."""
    poses = np.array(base[: len(base) if len(base) <= MAX_SHADOWS else 0])
    half = to_yaw(poses[:, 3:7]) / 2.0
    poses[:, 2], poses[:, 3:5] = GROUND_M, 0.0
    poses[:, 5], poses[:, 6] = np.sin(half), np.cos(half)
    return poses
