"""Labels that cover each other are left out, the farther ones first."""

import numpy as np
import pytest

from zensim.spawner.page.label_visibility import CameraView, choose_readable

AHEAD = CameraView(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.pi / 2.0, 800.0)
"""It looks along z; a point at depth 4 has 100 px a metre."""
NAMES = ("box_bot0", "box_bot1", "box_bot2")


def choose(*points: tuple[float, float, float], kept: int = 0) -> list[int]:
    return choose_readable(AHEAD, NAMES[: len(points)], np.array(points), kept)


def test_point_is_projected_as_a_pinhole_does() -> None:
    places, depths = AHEAD.project(np.array([[1.0, -0.5, 4.0]]))

    assert places[0] == pytest.approx([100.0, -50.0])
    assert depths == pytest.approx([4.0])


def test_turned_and_moved_camera_sees_what_is_before_it() -> None:
    half = np.sqrt(0.5)
    camera = CameraView(np.array([1.0, 2.0, 3.0, 0.0, half, 0.0, half]), np.pi / 2.0, 800.0)

    places, depths = camera.project(np.array([[5.0, 2.0, 3.0]]))  # it looks along x

    assert (*places[0], depths[0]) == pytest.approx((0.0, 0.0, 4.0))


def test_labels_side_by_side_are_shown() -> None:
    assert choose((0.0, 0.0, 4.0), (1.0, 0.0, 4.0), (0.0, 0.3, 4.0)) == [0, 1, 2]


def test_label_that_an_earlier_one_covers_is_left_out() -> None:
    assert choose((0.0, 0.0, 4.0), (0.5, 0.1, 4.0), (1.0, 0.1, 4.0)) == [0, 2]


def test_label_of_a_selected_robot_is_shown_in_any_case() -> None:
    assert choose((0.0, 0.0, 4.0), (0.0, 0.0, 4.1), (0.0, 0.0, 4.2), kept=2) == [0, 1]


def test_label_behind_the_camera_is_left_out() -> None:
    assert choose((0.0, 0.0, -4.0), (0.0, 0.0, 4.0)) == [1]


def test_no_labels_are_none() -> None:
    assert choose_readable(AHEAD, (), np.zeros((0, 3)), 0) == []
