"""Colours of the page in the dark and in the light, and the scale on its ground."""

from collections.abc import Iterator
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from zensim.spawner.page.robot_colours import Rgb, to_linear


class PageTheme(msgspec.Struct, frozen=True):
    """Colours of ground and background."""

    is_dark: bool
    ground: Rgb
    cells: Rgb
    """Lines each 0.25 m."""
    metres: Rgb
    """Lines each metre."""
    sky_top: Rgb
    sky_bottom: Rgb
    numerals: Rgb
    """Colour of the numerals of the scale on the ground."""
    shadow_opacity: float
    brand: Rgb
    """Colour of which viser makes ten tones; tabs, sliders and buttons have the seventh in light
    themes, the ninth in dark ones."""


DARK: Final = PageTheme(
    is_dark=True,
    ground=(44, 48, 56),
    cells=(58, 63, 72),
    metres=(92, 99, 111),
    sky_top=(24, 27, 33),
    sky_bottom=(56, 61, 71),
    numerals=(196, 201, 209),
    shadow_opacity=0.45,
    brand=(96, 165, 240),
)
LIGHT: Final = PageTheme(
    is_dark=False,
    ground=(228, 231, 235),
    cells=(212, 216, 222),
    metres=(165, 172, 182),
    sky_top=(190, 211, 233),
    sky_bottom=(240, 243, 246),
    numerals=(52, 58, 66),
    shadow_opacity=0.3,
    brand=(0, 41, 71),
)
X_AXIS: Final[Rgb] = (213, 84, 70)
Y_AXIS: Final[Rgb] = (46, 160, 98)
SCALE_M: Final = 10
"""Length of both axes on the ground."""
NUMBERED_M: Final = (1, 2, 5, 10)
SCALE_HEIGHT_M: Final = 0.003
"""Height of the lines above the ground, which would hide them."""
TICK_M: Final = 0.05
"""Half of the length of a tick."""
STROKE_M: Final = 0.085
"""Width of a character on the ground."""
RISE_M: Final = 0.17
"""Half of its height: long as on a road, since first views look along the ground."""
GAP_M: Final = 0.055
"""Gap between two characters, and between them and the axis."""
SPACE_M: Final = 0.05
"""Width of the space before a unit."""
END_M: Final = 0.35
"""Gap between the end of an axis and its letter, which is then clear of the last numeral."""

Segments = list[tuple[tuple[float, float], tuple[float, float]]]
READ_ALONG: Final[tuple[float, float]] = (0.5**0.5, 0.5**0.5)
"""Horizontal direction of a camera that sees characters upright: midway, as first views differ."""
_PLACES: Final = {
    **{"a": (0.0, 2.0), "b": (1.0, 2.0), "c": (0.0, 1.0), "d": (1.0, 1.0)},
    **{"e": (0.0, 0.0), "f": (1.0, 0.0), "g": (0.5, 0.0), "h": (0.5, 1.0)},
}
"""Ends of strokes in a character two squares high, in widths: right and up."""
_STROKES: Final = {
    "0": ("ab", "bf", "fe", "ea"),
    "1": ("bf",),
    "2": ("ab", "bd", "dc", "ce", "ef"),
    "5": ("ba", "ac", "cd", "df", "fe"),
    "m": ("ec", "cd", "df", "gh"),
    "x": ("cf", "ed"),
    "y": ("cg", "de"),
}


def make_scale(theme: PageTheme) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Make axes with ticks, and numerals: segments (n, 2, 3) [m], linear colours (n, 2, 3)."""
    coloured = [
        *((segment, X_AXIS) for segment in _draw_axis(is_x=True)),
        *((segment, Y_AXIS) for segment in _draw_axis(is_x=False)),
        *((segment, theme.numerals) for segment in _draw_numerals()),
    ]
    points = np.full((len(coloured), 2, 3), SCALE_HEIGHT_M, dtype=np.float32)
    points[:, :, :2] = [segment for segment, _ in coloured]
    return points, to_linear([colour for _, colour in coloured])[:, None].repeat(2, axis=1)


def _draw_axis(*, is_x: bool) -> Iterator[tuple[tuple[float, float], tuple[float, float]]]:
    ends = [((0.0, 0.0), (float(SCALE_M), 0.0))]
    ends += [((float(at), -TICK_M), (float(at), TICK_M)) for at in range(1, SCALE_M + 1)]
    for start, end in ends:
        yield (start, end) if is_x else (start[::-1], end[::-1])


def _draw_numerals() -> Segments:
    drawn: Segments = []
    for at in NUMBERED_M:
        text = f"{at} m"
        beside = TICK_M + GAP_M + _find_reach(text)
        drawn += _draw_text(text, (float(at), -beside))
        drawn += _draw_text(text, (-beside, float(at)))
    ahead = SCALE_M + END_M + _find_reach("x")
    return [*drawn, *_draw_text("x", (ahead, 0.0)), *_draw_text("y", (0.0, ahead))]


def _find_width(text: str) -> float:
    return sum(map(_find_advance, text)) - GAP_M


def _find_advance(character: str) -> float:
    return (SPACE_M if character == " " else STROKE_M) + GAP_M


def _find_reach(text: str) -> float:
    """Find how far a text reaches from its middle, along x and y alike."""
    return (_find_width(text) / 2.0 + RISE_M) * READ_ALONG[0]


def _draw_text(text: str, middle: tuple[float, float]) -> Segments:
    """Draw characters about a point, upright for a camera that looks along `READ_ALONG`."""
    drawn: Segments = []
    left = -_find_width(text) / 2.0
    for character in text:
        for stroke in _STROKES.get(character, ()):
            start, end = (_place(middle, left, corner) for corner in stroke)
            drawn.append((start, end))
        left += _find_advance(character)
    return drawn


def _place(middle: tuple[float, float], left: float, corner: str) -> tuple[float, float]:
    right, up = _PLACES[corner]
    across, above = left + right * STROKE_M, (up - 1.0) * RISE_M
    x, y = READ_ALONG
    return middle[0] + across * y + above * x, middle[1] - across * x + above * y
