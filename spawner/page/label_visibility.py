"""Which labels of the page can be read: those that no nearer one covers."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from zensim.proto.se3 import invert, transform_points
from zensim.spawner.page.model_visuals import Array

LETTER_PX: Final = 7.5
LINE_PX: Final = 18.0
EDGES_PX: Final = 8.0
"""Both edges of a label together, beside its text."""


@dataclass(frozen=True)
class CameraView:
    """A camera and its picture.

    Attributes:
        pose: Position [m] and quaternion x y z w, (7,), of a frame with x to the right, y down
            and z ahead.
        fov_rad: Vertical field of view.
        height_px: Of the picture.
    """

    pose: Array
    fov_rad: float
    height_px: float

    def project(self, points: Array) -> tuple[Array, Array]:
        """Find places (n, 2) in the picture [px from its middle], and depths (n,) [m]."""
        seen = transform_points(invert(self.pose), points)
        focus_px = self.height_px / 2.0 / np.tan(self.fov_rad / 2.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return focus_px * seen[:, :2] / seen[:, 2:], seen[:, 2]


def choose_readable(
    camera: CameraView, texts: Sequence[str], points: Array, kept: int
) -> list[int]:
    """Choose labels that do not cover each other.

    Args:
        camera: Of the visitor.
        texts: n labels; earlier ones have precedence.
        points: Above which they stand, (n, 3) [m].
        kept: Number of first ones that are shown in any case.

    Returns:
        Their numbers, in order; labels behind the camera are left out.
    """
    places, depths = camera.project(points)
    widths = LETTER_PX * np.array([len(text) for text in texts]) + EDGES_PX
    chosen = list(range(kept))
    for number in range(kept, len(texts)):
        away = np.abs(places[chosen] - places[number])
        is_covered = (away[:, 1] < LINE_PX) & (away[:, 0] < (widths[chosen] + widths[number]) / 2.0)
        if depths[number] > 0.0 and not is_covered.any():
            chosen.append(number)
    return chosen
