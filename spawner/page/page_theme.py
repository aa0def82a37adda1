"""Colours of the page in the dark and in the light, and the axes on its ground."""

from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from zensim.spawner.page.robot_colours import Rgb, to_linear


class PageTheme(msgspec.Struct, frozen=True):
    """Colours of ground and background."""

    is_dark: bool
    ground: Rgb
    metres: Rgb
    """Lines each metre."""
    sections: Rgb
    """Lines each five metres."""
    sky: Rgb
    """Colour at the top of the picture."""
    haze: Rgb
    """Colour of the horizon, where the ground ends."""
    shadow_opacity: float
    brand: Rgb
    """Colour of which viser makes ten tones; tabs, sliders and buttons have the seventh in light
    themes, the ninth in dark ones."""


DARK: Final = PageTheme(
    is_dark=True,
    ground=(43, 48, 57),
    metres=(84, 92, 106),
    sections=(124, 134, 150),
    sky=(32, 36, 44),
    haze=(64, 72, 85),
    shadow_opacity=0.6,
    brand=(96, 165, 240),
)
LIGHT: Final = PageTheme(
    is_dark=False,
    ground=(226, 230, 235),
    metres=(188, 196, 206),
    sections=(138, 148, 162),
    sky=(178, 203, 230),
    haze=(239, 243, 247),
    shadow_opacity=0.42,
    brand=(0, 41, 71),
)
MUTED_BUTTON: Final[Rgb] = (66, 71, 80)
"""Colour of buttons beside the one that stands out; the style sheet has that of light themes."""
STOP_BUTTON: Final[Rgb] = (179, 38, 30)
"""Colour of buttons that stop robots; white text on it has a contrast of 6."""
X_AXIS: Final[Rgb] = (213, 84, 70)
Y_AXIS: Final[Rgb] = (46, 160, 98)
AXIS_M: Final = 1.0
"""Length of both axes on the ground."""
AXIS_HEIGHT_M: Final = 0.003
"""Height of the axes above the ground, which would hide them."""


def make_axes() -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Make x and y of the world: segments (2, 2, 3) [m], linear colours (2, 2, 3)."""
    points = np.zeros((2, 2, 3), dtype=np.float32)
    points[:, :, 2] = AXIS_HEIGHT_M
    points[[0, 1], 1, [0, 1]] = AXIS_M
    return points, to_linear([X_AXIS, Y_AXIS])[:, None].repeat(2, axis=1)
