"""Poses are put one after another."""

import math

import numpy as np
import pytest

from zensim.proto.messages.model_messages import Joint, Origin
from zensim.sim_server.description.model_geometry import (
    compose_poses,
    find_link_poses,
    rotate_vector,
    to_rotation_matrix,
    transform_point,
)

HALF = math.sqrt(0.5)
QUARTER_LEFT = Origin((1.0, 0.0, 0.0), (0.0, 0.0, HALF, HALF))


def test_pose_is_turned_and_moved_when_composed() -> None:
    pose = compose_poses(QUARTER_LEFT, QUARTER_LEFT)

    assert pose.position == pytest.approx((1.0, 1.0, 0.0))
    assert pose.orientation == pytest.approx((0.0, 0.0, 1.0, 0.0), abs=1e-12)


def test_pose_is_exactly_itself_when_the_outer_one_is_the_frame() -> None:
    assert compose_poses(Origin(), QUARTER_LEFT) is QUARTER_LEFT


def test_pose_keeps_its_turn_exactly_when_the_outer_one_only_moves() -> None:
    pose = compose_poses(Origin((0.0, 0.0, 2.0)), QUARTER_LEFT)

    assert pose == Origin((1.0, 0.0, 2.0), QUARTER_LEFT.orientation)


def test_point_and_direction_are_turned_when_the_frame_is() -> None:
    assert transform_point(QUARTER_LEFT, (1.0, 0.0, 0.0)) == pytest.approx((1.0, 1.0, 0.0))
    assert rotate_vector(QUARTER_LEFT, (1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))


def test_matrix_turns_as_the_pose_does() -> None:
    assert to_rotation_matrix(QUARTER_LEFT) == pytest.approx(
        np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    )


def test_links_are_placed_along_their_joints() -> None:
    joints = (
        Joint("j", "continuous", "a", "b", QUARTER_LEFT),
        Joint("k", "continuous", "b", "c", QUARTER_LEFT),
    )

    poses = find_link_poses("a", joints)

    assert poses["a"] == Origin()
    assert poses["c"].position == pytest.approx((1.0, 1.0, 0.0))
