"""Colours of the page, and the scale on its ground."""

import numpy as np
import pytest

from zensim.spawner.page.page_theme import DARK, LIGHT, SCALE_M, PageTheme, make_scale
from zensim.spawner.page.render_state import View, fit_camera
from zensim.spawner.page.robot_colours import ROBOT_COLOURS, Rgb, to_linear
from zensim.spawner.page.scene_lighting import FOV_RAD, START_CAMERA

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


def find_camera(extent: tuple[float, float], aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """Find position and target of the first camera on robots that stand in a rectangle."""
    corners = np.array([(0.0, 0.0, 0.0), (*extent, 0.1)])
    return fit_camera(View(corners), aspect=aspect, fov_rad=FOV_RAD)


@pytest.mark.parametrize(
    "camera",
    [
        START_CAMERA,
        *(
            find_camera(extent, aspect)
            for extent in ((9.0, 0.1), (0.1, 9.0), (3.0, 3.0))
            for aspect in (1.6, 0.46)
        ),
    ],
)
def test_numerals_are_read_from_left_to_right_in_first_views(
    camera: tuple[np.ndarray, np.ndarray],
) -> None:
    points, colours = make_scale(DARK)
    numerals = points[(colours[:, 0] == to_linear([DARK.numerals])[0]).all(axis=1)]
    top, bottom = numerals[0]  # "1" of "1 m" is one stroke, from its top
    ahead = np.subtract(camera[1], camera[0])
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    screen_up = np.cross(right, ahead)

    stroke = top - bottom
    up = stroke @ screen_up / np.linalg.norm(screen_up)
    across = stroke @ right / np.linalg.norm(right)
    reading = numerals[1:5].mean(axis=(0, 1)) - numerals[0].mean(axis=0)

    assert up > 0.0
    width = np.ptp(numerals[1:5].reshape(-1, 3) @ right) / np.linalg.norm(right)  # of "m"

    assert abs(across) < 1.3 * up
    assert up > 0.75 * width
    drop = abs(reading @ screen_up) / np.linalg.norm(screen_up)  # "m" is half as high as "1"
    assert reading @ right / np.linalg.norm(right) > 1.5 * drop


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_numerals_are_beside_their_axis(theme: PageTheme) -> None:
    points, colours = make_scale(theme)
    numerals = points[(colours[:, 0] == to_linear([theme.numerals])[0]).all(axis=1)]
    flat = numerals.reshape(-1, 3)[:, :2]

    near = (np.abs(flat) < 0.05).any(axis=1)
    assert (flat[near].max(axis=1) > SCALE_M).all()  # "x" and "y" at the ends


@pytest.mark.parametrize("theme", THEMES.values(), ids=THEMES)
def test_letters_of_axes_are_clear_of_numerals(theme: PageTheme) -> None:
    points, colours = make_scale(theme)
    numerals = points[(colours[:, 0] == to_linear([theme.numerals])[0]).all(axis=1)]

    last, letter = numerals[-22:-13], numerals[-4:-2]  # strokes of "10 m" and of "x"
    gaps = np.linalg.norm(letter.reshape(-1, 1, 3) - last.reshape(-1, 3), axis=2)

    assert last.mean(axis=(0, 1))[0] == pytest.approx(SCALE_M, abs=0.2)
    assert letter.mean(axis=(0, 1))[1] == pytest.approx(0.0, abs=0.1)
    assert gaps.min() > 0.2


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
