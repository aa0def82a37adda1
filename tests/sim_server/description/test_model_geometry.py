"""Link poses and ground clearance."""

import math

import numpy as np
import pytest

from zensim.proto.messages.model_messages import IDENTITY, Joint, Link, Model, Origin, Quat, Shape
from zensim.sim_server.description import model_geometry
from zensim.sim_server.description.model_geometry import find_link_poses

HALF = math.sqrt(0.5)
ON_ITS_SIDE = (HALF, 0.0, 0.0, HALF)


WEDGE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -2.0]])


def ground_clearance(model: Model, turn: Quat = IDENTITY) -> float:
    return model_geometry.find_ground_clearance(model, turn, {"wedge": WEDGE}.__getitem__)


def a_model(*shapes: Shape) -> Model:
    return Model("m", (Link("base", collisions=shapes),))


@pytest.mark.parametrize(
    ("shape", "lowest"),
    [
        (Shape("sphere", (0.5, 0.0, 0.0), Origin((0.0, 0.0, 2.0))), 1.5),
        (Shape("box", (1.0, 2.0, 4.0)), -2.0),
        (Shape("box", (1.0, 2.0, 4.0), Origin(orientation=ON_ITS_SIDE)), -1.0),
        (Shape("cylinder", (0.5, 4.0, 0.0)), -2.0),
        (Shape("cylinder", (0.5, 4.0, 0.0), Origin(orientation=ON_ITS_SIDE)), -0.5),
        (Shape("capsule", (0.5, 4.0, 0.0)), -2.5),
        (Shape("mesh", (1.0, 1.0, 0.5), Origin((0.0, 0.0, 3.0)), mesh="wedge"), 2.0),
        (Shape("mesh", (1.0, -2.0, 1.0), Origin(orientation=ON_ITS_SIDE), mesh="wedge"), -2.0),
        (Shape("capsule", (0.5, 4.0, 0.0), Origin(orientation=ON_ITS_SIDE)), -0.5),
    ],
)
def test_clearance_is_the_lowest_point_of_a_shape(shape: Shape, lowest: float) -> None:
    assert ground_clearance(a_model(shape)) == pytest.approx(lowest)


def test_clearance_is_that_of_an_edge_when_a_box_is_tilted() -> None:
    eighth = (math.sin(math.pi / 8), 0.0, 0.0, math.cos(math.pi / 8))
    tilted = Shape("box", (2.0, 2.0, 2.0), Origin(orientation=eighth))

    assert ground_clearance(a_model(tilted)) == pytest.approx(-math.sqrt(2.0))


def test_clearance_uses_the_poses_of_links() -> None:
    ball = Shape("sphere", (0.1, 0.0, 0.0), Origin((0.0, 0.0, -1.0)))
    hung = Joint("j", "continuous", "base", "leg", Origin((0.0, 0.0, -2.0)))

    model = Model("m", (Link("base"), Link("leg", collisions=(ball,))), (hung,))

    assert ground_clearance(model) == pytest.approx(-3.1)


def test_clearance_is_zero_without_collisions() -> None:
    assert ground_clearance(a_model(Shape("plane"))) == 0.0


def test_clearance_depends_on_the_orientation() -> None:
    arm = Joint("j", "continuous", "base", "arm", Origin((0.0, 3.0, 0.0)))
    base = Link("base", collisions=(Shape("box", (1.0, 2.0, 4.0)),))
    ball = Link("arm", collisions=(Shape("sphere", (0.5, 0.0, 0.0)),))

    model = Model("m", (base, ball), (arm,))

    assert ground_clearance(model) == pytest.approx(-2.0)
    assert ground_clearance(model, ON_ITS_SIDE) == pytest.approx(-1.0)
    assert ground_clearance(model, (-HALF, 0.0, 0.0, HALF)) == pytest.approx(-3.5)


def test_links_are_placed_along_their_joints() -> None:
    quarter_left = Origin((1.0, 0.0, 0.0), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    joints = (
        Joint("j", "continuous", "a", "b", quarter_left),
        Joint("k", "continuous", "b", "c", quarter_left),
    )

    poses = find_link_poses("a", joints)

    assert poses["a"] == Origin()
    assert poses["c"].position == pytest.approx((1.0, 1.0, 0.0))
