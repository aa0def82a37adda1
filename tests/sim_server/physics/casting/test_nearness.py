"""Balls tell what may touch."""

import numpy as np
import pytest

from zensim.sim_server.physics.casting.nearness import nearby


@pytest.mark.parametrize(("x", "is_near"), [(2.9, True), (3.1, False), (-1.9, True), (-2.1, False)])
def test_geometry_is_nearby_when_its_ball_reaches_into_that_of_a_body(
    x: float, *, is_near: bool
) -> None:
    centres = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [x, 0.0, 0.0]])
    radii = np.array([0.5, 0.5, 1.4])

    found = nearby(centres, radii, np.array([0, 1]))

    assert found.tolist() == ([0, 1, 2] if is_near else [0, 1])


def test_nothing_is_near_what_has_no_geometry() -> None:
    found = nearby(np.zeros((3, 3)), np.ones(3), np.zeros(0, np.intp))

    assert found.tolist() == []
