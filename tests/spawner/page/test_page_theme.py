"""Colours of the page, and the scale on its ground."""

import numpy as np
import pytest

from zensim.spawner.page.page_theme import DARK, LIGHT, SCALE_M, PageTheme, make_scale
from zensim.spawner.page.robot_colours import ROBOT_COLOURS, Rgb

THEMES = {"dark": DARK, "light": LIGHT}


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_numerals_stand_out_from_the_ground(theme: PageTheme) -> None:
    assert find_contrast(theme.numerals, theme.ground) >= 4.5


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_tabs_stand_out_from_the_panel(theme: PageTheme) -> None:
    panel = (36, 36, 36) if theme.is_dark else (255, 255, 255)

    assert find_contrast(theme.brand, panel) >= 4.5


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_robots_differ_from_the_ground(theme: PageTheme) -> None:
    ground = np.array(theme.ground)

    assert min(np.linalg.norm(ground - colour) for colour in ROBOT_COLOURS) > 60.0


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_scale_has_a_tick_at_each_metre_of_both_axes(theme: PageTheme) -> None:
    points, colours = make_scale(theme)

    for axis in (0, 1):
        spans = np.abs(points[:, 1, :2] - points[:, 0, :2])
        crossing = points[(spans[:, axis] == 0.0) & (np.abs(points[:, :, 1 - axis]).max(1) < 0.06)]
        assert set(range(1, SCALE_M + 1)) <= set(crossing[:, 0, axis].tolist())
    assert colours.shape == points.shape
    assert (points[:, :, 2] > 0.0).all()


def find_contrast(one: Rgb, other: Rgb) -> float:
    """Find the contrast of two colours as WCAG 2.2 defines it."""
    low, high = sorted(_find_luminance(colour) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


def _find_luminance(colour: Rgb) -> float:
    linear = [
        channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4
        for channel in (part / 255.0 for part in colour)
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
