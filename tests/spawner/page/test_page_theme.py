"""Colours of the page, and the axes on its ground."""

import numpy as np
import pytest

from zensim.spawner.page.page_theme import AXIS_M, DARK, LIGHT, STOP_BUTTON, PageTheme, make_axes
from zensim.spawner.page.robot_colours import ROBOT_COLOURS, Rgb

THEMES = {"dark": DARK, "light": LIGHT}


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_tabs_stand_out_from_the_panel(theme: PageTheme) -> None:
    panel = (36, 36, 36) if theme.is_dark else (255, 255, 255)

    assert find_contrast(theme.brand, panel) >= 4.5


def test_text_of_buttons_that_stop_has_contrast() -> None:
    assert find_contrast(STOP_BUTTON, (255, 255, 255)) >= 4.5


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_robots_differ_from_the_ground(theme: PageTheme) -> None:
    ground = np.array(theme.ground)

    assert min(np.linalg.norm(ground - colour) for colour in ROBOT_COLOURS) > 60.0


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_strong_lines_of_the_ground_differ_more_than_fine_ones(theme: PageTheme) -> None:
    fine, strong = (find_contrast(line, theme.ground) for line in (theme.metres, theme.sections))

    assert 1.2 < fine < strong


def test_axes_are_a_metre_long_above_the_ground() -> None:
    points, colours = make_axes()

    assert (points[:, 1] - points[:, 0]).tolist() == [[AXIS_M, 0.0, 0.0], [0.0, AXIS_M, 0.0]]
    assert (points[:, :, 2] > 0.0).all()
    assert colours.shape == points.shape


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
