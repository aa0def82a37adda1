"""Driven wheels: which links, their radius, and their reflected inertia."""

import math

import msgspec
import numpy as np
import pytest

from tests.models import WHEEL_RADIUS_M, a_box, a_cart, a_fork, a_puck
from zensim.proto.messages.drive_messages import TricycleDrive
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Shape
from zensim.proto.se3 import from_rpy
from zensim.sim_server.description.wheel_contacts import links_in_contact
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.driven_wheels import find_driven_wheels, measure_rolling_radius

SIDEWAYS = tuple(from_rpy(math.pi / 2.0, 0.0, 0.0).tolist())
AXLE = Joint("j", "continuous", "base", "wheel", axis=(0.0, 2.0, 0.0))


def radius_of(*shapes: Shape) -> float:
    corners = {"m": np.array([[0.1, 0.9, 0.0], [0.0, 0.0, -0.4]])}.__getitem__
    return measure_rolling_radius(Link("wheel", collisions=shapes), AXLE, corners)


@pytest.mark.parametrize(
    ("shape", "radius"),
    [
        (Shape("sphere", (0.2, 0.0, 0.0), Origin((0.1, 5.0, 0.0))), 0.3),
        (Shape("cylinder", (0.2, 0.1, 0.0), Origin((0.0, 1.0, 0.0), SIDEWAYS)), 0.2),
        (Shape("capsule", (0.2, 0.1, 0.0)), 0.25),
        (Shape("box", (0.6, 9.0, 0.8)), 0.5),
        (Shape("mesh", (1.0, 1.0, 2.0), mesh="m"), 0.8),
        (Shape("plane"), 0.0),
    ],
    ids=lambda found: found.kind if isinstance(found, Shape) else "",
)
def test_rolling_radius_is_the_largest_distance_from_the_axle(shape: Shape, radius: float) -> None:
    assert radius_of(shape) == pytest.approx(radius)


def test_rolling_radius_is_that_of_the_largest_shape() -> None:
    assert radius_of() == 0.0
    assert radius_of(Shape("sphere", (0.1, 0.0, 0.0)), Shape("sphere", (0.2, 0.0, 0.0))) == 0.2


def test_wheels_of_a_cart_reflect_a_share_of_its_mass() -> None:
    model = a_cart()

    wheels = list(find_driven_wheels(model, links_in_contact(model)))

    assert [(wheel.link, wheel.radius_m) for wheel in wheels] == [(1, 0.05), (2, 0.05)]
    expected = 0.2 * 2.4 * WHEEL_RADIUS_M**2
    assert [wheel.reflected_inertia for wheel in wheels] == pytest.approx([expected] * 2)


@pytest.mark.parametrize("model", [a_box(), a_puck(), a_fork()], ids=["box", "puck", "shapeless"])
def test_model_without_rolling_actuators_has_no_driven_wheels(model: Model) -> None:
    assert list(find_driven_wheels(model, links_in_contact(model))) == []


def test_wheel_that_only_measures_is_not_driven() -> None:
    drive = TricycleDrive(
        actuated_wheel_joint="left_joint",
        steering_joint="right_joint",
        encoder_wheel_left_joint="right_joint",
    )
    model = msgspec.structs.replace(a_cart(), drive=drive)

    wheels = find_driven_wheels(model, links_in_contact(model))

    assert [model.links[wheel.link].name for wheel in wheels] == ["left"]


def test_prismatic_joint_drives_no_wheel() -> None:
    cart = a_cart()
    sliding = tuple(msgspec.structs.replace(joint, kind="prismatic") for joint in cart.joints)
    model = msgspec.structs.replace(cart, joints=sliding)

    assert list(find_driven_wheels(model, links_in_contact(model))) == []


def test_blueprint_has_the_reflected_inertia_of_driven_wheels() -> None:
    parts = make_blueprint(a_cart()).parts

    assert [part.reflected_inertia > 0.0 for part in parts] == [False, True, True, False]
