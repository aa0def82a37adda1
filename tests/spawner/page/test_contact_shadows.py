"""Patches below robots: their extent, where they lie, and for how many robots."""

import math
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from zensim.spawner.page.contact_shadows import (
    GROUND_M,
    MAX_SHADOWS,
    find_ground_poses,
    make_shadow,
)

BOUNDS = np.array([(-0.3, -0.1, -0.2), (0.1, 0.1, 0.4)])


def test_patch_is_dark_below_the_robot_and_clear_where_it_ends() -> None:
    patch = make_shadow(BOUNDS)
    opacity = np.asarray(Image.open(BytesIO(patch.mesh.image)))[..., 1].astype(int)
    middle = len(opacity) // 2

    assert (np.abs(patch.mesh.vertices[:, :2] - (-0.1, 0.0)) > (0.2, 0.1)).all()
    assert opacity[middle, middle] == 255
    assert opacity[[0, -1]].max() == opacity[:, [0, -1]].max() == 0
    assert (np.diff(opacity[middle, middle:]) <= 0).all()
    assert np.abs(np.diff(opacity[middle])).max() < 40
    assert patch.rgba[3] < 1.0


def test_flat_robot_has_a_patch() -> None:
    patch = make_shadow(np.array([(-0.3, 0.0, 0.0), (0.1, 0.0, 0.4)]))

    assert np.asarray(Image.open(BytesIO(patch.mesh.image)))[..., 1].max() > 100


def test_faces_are_seen_from_above() -> None:
    mesh = make_shadow(BOUNDS).mesh
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))

    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()


def test_patch_lies_on_the_ground_below_a_tilted_robot_and_turns_with_it() -> None:
    yaw, roll = 1.0, 0.4
    turn = [math.cos(yaw / 2) * math.sin(roll / 2), math.sin(yaw / 2) * math.sin(roll / 2)]
    turn += [math.sin(yaw / 2) * math.cos(roll / 2), math.cos(yaw / 2) * math.cos(roll / 2)]
    base = np.array([(1.0, 2.0, 0.7, *turn)])

    (found,) = find_ground_poses(base)

    lying = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    assert found == pytest.approx((1.0, 2.0, GROUND_M, *lying))
    assert base[0, 2] == 0.7


@pytest.mark.parametrize(("robots", "patches"), [(0, 0), (MAX_SHADOWS, MAX_SHADOWS)])
def test_each_robot_has_a_patch(robots: int, patches: int) -> None:
    assert find_ground_poses(np.zeros((robots, 7))).shape == (patches, 7)


def test_many_robots_have_none() -> None:
    assert find_ground_poses(np.zeros((MAX_SHADOWS + 1, 7))).shape == (0, 7)
