"""Wheels touch at one point; a body that is moved itself slides."""

import math

import msgspec
import pytest

from tests.models import WHEEL_RADIUS_M, a_box, a_cart, a_puck
from zensim.proto.messages.model_messages import Model, Origin, Shape
from zensim.proto.rotation import from_rpy
from zensim.sim_server.description.rolling import touching_links

SIDEWAYS = tuple(from_rpy(math.pi / 2.0, 0.0, 0.0).tolist())
TYRE = Shape("cylinder", (WHEEL_RADIUS_M, 0.02, 0.0), Origin((0.0, 0.01, 0.0), SIDEWAYS))


def a_cart_on(*shapes: Shape) -> Model:
    """A cart whose right wheel has these collisions."""
    cart = a_cart()
    wheel = msgspec.structs.replace(cart.links[1], collisions=shapes)
    return msgspec.structs.replace(cart, links=(cart.links[0], wheel, cart.links[2]))


def test_cylinder_about_an_axle_touches_as_a_sphere_about_its_centre() -> None:
    tyre = msgspec.structs.replace(TYRE, friction=0.7)

    (sphere,) = touching_links(a_cart_on(tyre))[1].collisions

    assert sphere == Shape(
        "sphere", (WHEEL_RADIUS_M, 0.0, 0.0), Origin((0.0, 0.01, 0.0)), friction=0.7
    )


@pytest.mark.parametrize(
    "shape",
    [
        Shape("box", (0.1, 0.1, 0.1)),
        Shape("cylinder", (0.05, 0.02, 0.0)),
        Shape("cylinder", (0.05, 0.11, 0.0), Origin(orientation=SIDEWAYS)),
        Shape("cylinder", (0.05, 0.02, 0.0), Origin((0.01, 0.0, 0.0), SIDEWAYS)),
    ],
    ids=["box", "upright", "roller", "eccentric"],
)
def test_what_is_no_tyre_stays_as_it_is(shape: Shape) -> None:
    model = a_cart_on(TYRE, shape)

    assert touching_links(model)[1].collisions[1] == shape


def test_links_that_no_drive_moves_stay_as_they_are() -> None:
    for model in (a_box(), a_cart(), msgspec.structs.replace(a_cart_on(TYRE), drive=None)):
        assert touching_links(model) == model.links


def test_body_that_is_moved_itself_slides() -> None:
    links = touching_links(a_puck())

    assert [shape.friction for link in links for shape in link.collisions] == [0.0]
