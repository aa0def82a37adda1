"""Collisions that points of contact are on."""

import numpy as np
import pytest

from zensim.proto.messages.model_messages import Link, Origin, Shape
from zensim.sim_server.scene.touched_collisions import find_touched_collisions

PYRAMID = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])


def meshes(name: str) -> np.ndarray:
    assert name == "pyramid"
    return PYRAMID


FAR = Origin((5.0, 0.0, 0.0))
UPSIDE = Origin((5.0, 0.0, 0.0), (0.7071067811865476, 0.0, 0.0, 0.7071067811865476))


@pytest.mark.parametrize(
    ("shape", "on_it"),
    [
        (Shape("box", (0.4, 0.4, 2.0), FAR), (5.2, 0.0, 0.9)),
        (Shape("box", (0.4, 0.4, 2.0), UPSIDE), (5.2, 0.9, 0.0)),
        (Shape("sphere", (0.5, 0.0, 0.0), FAR), (5.0, 0.0, -0.5)),
        (Shape("cylinder", (0.5, 2.0, 0.0), FAR), (5.5, 0.0, 0.8)),
        (Shape("capsule", (0.5, 2.0, 0.0), FAR), (5.0, 0.0, 1.5)),
        (Shape("plane", (0.0, 0.0, 0.0), Origin((0.0, 0.0, -9.0))), (3.0, 0.0, -9.0)),
        (Shape("mesh", (2.0, 2.0, 2.0), FAR, mesh="pyramid"), (6.0, 1.0, 2.0)),
    ],
)
def test_point_is_on_the_collision_whose_surface_is_nearest(
    shape: Shape, on_it: tuple[float, float, float]
) -> None:
    ball = Shape("sphere", (0.2, 0.0, 0.0))
    points = np.array([on_it, (0.2, 0.0, 0.0)])

    for order in ((0, 1), (1, 0)):
        link = Link("base", collisions=tuple((shape, ball)[place] for place in order))
        found = find_touched_collisions(link, points, meshes)
        assert [order[place] for place in found] == [0, 1]


def test_point_on_a_shape_inside_another_is_told_apart_by_its_surface() -> None:
    outer, inner = Shape("box", (1.0, 1.0, 1.0)), Shape("sphere", (0.2, 0.0, 0.0))
    points = np.array([(0.0, 0.0, 0.21), (0.0, 0.0, 0.49)])

    found = find_touched_collisions(Link("base", collisions=(outer, inner)), points, meshes)

    assert found.tolist() == [1, 0]


def test_points_of_a_link_with_one_collision_are_on_it() -> None:
    link = Link("base", collisions=(Shape("mesh", mesh="unknown"),))

    assert find_touched_collisions(link, np.zeros((3, 3)), meshes).tolist() == [0, 0, 0]
