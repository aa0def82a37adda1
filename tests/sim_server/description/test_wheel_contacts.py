"""Wheels touch the ground as spheres; other shapes are unchanged."""

import math

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from tests.models import WHEEL_RADIUS_M, a_box, a_cart, a_puck
from zensim.proto.messages.model_messages import Joint, JointKind, Link, Model, Origin, Shape, Vec3
from zensim.proto.rigid_transforms import rotate
from zensim.proto.se3 import from_rpy
from zensim.sim_server.description.wheel_contacts import describe_contacts, links_in_contact

SIDEWAYS = tuple(from_rpy(math.pi / 2.0, 0.0, 0.0).tolist())
TYRE = Shape("cylinder", (WHEEL_RADIUS_M, 0.02, 0.0), Origin((0.0, 0.01, 0.0), SIDEWAYS))


def a_cart_on(*shapes: Shape) -> Model:
    """A cart whose right wheel has these collisions."""
    cart = a_cart()
    wheel = msgspec.structs.replace(cart.links[1], collisions=shapes)
    return msgspec.structs.replace(cart, links=(cart.links[0], wheel, cart.links[2]))


def test_wheel_cylinder_becomes_a_sphere() -> None:
    tyre = msgspec.structs.replace(TYRE, friction=0.7)

    (sphere,) = links_in_contact(a_cart_on(tyre))[1].collisions

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
def test_other_cylinder_is_unchanged(shape: Shape) -> None:
    model = a_cart_on(TYRE, shape)

    assert links_in_contact(model)[1].collisions[1] == shape


def a_cart_with_caster(
    height: float, axis: Vec3 = (0.0, 1.0, 0.0), kind: JointKind = "continuous"
) -> Model:
    """A cart with a cylinder of 2 cm radius that nothing drives, this high over its axles."""
    cart = a_cart_on(TYRE)
    roller = Shape("cylinder", (0.02, 0.01, 0.0), Origin(orientation=SIDEWAYS))
    axle = Joint("caster_joint", kind, "base", "caster", Origin((-0.1, 0.0, height)), axis=axis)
    return msgspec.structs.replace(
        cart, links=(*cart.links, Link("caster", collisions=(roller,))), joints=(*cart.joints, axle)
    )


def test_passive_wheel_on_the_ground_becomes_a_sphere() -> None:
    caster = links_in_contact(a_cart_with_caster(0.025 - WHEEL_RADIUS_M))[-1]

    assert [shape.kind for shape in caster.collisions] == ["sphere"]
    assert caster.collisions[0].size[0] == 0.02


@pytest.mark.parametrize(
    "model",
    [
        a_cart_with_caster(0.045 - WHEEL_RADIUS_M),
        a_cart_with_caster(0.02 - WHEEL_RADIUS_M, kind="revolute"),
        a_cart_with_caster(0.02 - WHEEL_RADIUS_M, axis=(1.0, 0.0, 0.0)),
    ],
    ids=["in the air", "limited", "across its axle"],
)
def test_other_passive_cylinder_is_unchanged(model: Model) -> None:
    assert links_in_contact(model)[-1] == model.links[-1]


def test_disc_on_an_upright_axle_is_unchanged() -> None:
    cart = a_cart_with_caster(0.01 - WHEEL_RADIUS_M, axis=(0.0, 0.0, 1.0))
    disc = Link("caster", collisions=(Shape("cylinder", (0.02, 0.01, 0.0)),))
    model = msgspec.structs.replace(cart, links=(*cart.links[:-1], disc))

    assert links_in_contact(model)[-1] == disc


def a_prism(sides: int, *, width: float = 0.4, squash: float = 1.0) -> npt.NDArray[np.float64]:
    """Make the corners (n, 3) of a prism of radius 1 about y; its hub is smaller."""
    turns = np.arange(sides) * math.tau / sides + 0.3
    rim = np.stack([np.cos(turns), np.zeros(sides), squash * np.sin(turns)], axis=1)
    hub = 0.5 * rim[::2] + np.array([0.0, width, 0.0])
    return np.concatenate([rim, rim + np.array([0.0, 0.5 * width, 0.0]), hub])


def a_mesh_cart(shape: Shape, points: npt.NDArray[np.float64]) -> tuple[Link, ...]:
    return links_in_contact(a_cart_on(shape), {"tyre": points}.__getitem__)


@pytest.mark.parametrize("sides", [12, 17, 64])
def test_round_mesh_of_a_wheel_becomes_a_sphere_about_the_middle_of_its_tread(sides: int) -> None:
    tyre = Shape("mesh", (0.05, 0.05, 0.05), Origin((0.0, 0.01, 0.0)), mesh="tyre", friction=0.7)

    (sphere,) = a_mesh_cart(tyre, a_prism(sides))[1].collisions

    assert (sphere.kind, sphere.friction, sphere.mesh) == ("sphere", 0.7, "")
    assert sphere.size[0] == pytest.approx(0.05)
    assert sphere.origin.position == pytest.approx((0.0, 0.015, 0.0))


def test_round_mesh_is_turned_and_mirrored_as_its_shape() -> None:
    upright = a_prism(24)[:, [2, 0, 1]]
    tyre = Shape("mesh", (0.05, 0.05, -0.05), Origin((0.0, 0.01, 0.0), SIDEWAYS), mesh="tyre")

    (sphere,) = a_mesh_cart(tyre, upright)[1].collisions

    assert sphere.size[0] == pytest.approx(0.05)
    assert sphere.origin.position == pytest.approx((0.0, 0.015, 0.0))


def test_round_mesh_of_a_roller_becomes_a_cylinder_along_its_tread() -> None:
    """On a polygon of 38 sides, a robot of MuJoCo hops and turns at 0.8 of its prediction."""
    roller = Shape("mesh", (0.05, 0.05, 0.05), Origin((0.0, 0.01, 0.0)), mesh="tyre", friction=0.7)

    (cylinder,) = a_mesh_cart(roller, a_prism(38, width=5.0))[1].collisions

    assert (cylinder.kind, cylinder.friction, cylinder.mesh) == ("cylinder", 0.7, "")
    assert cylinder.size == pytest.approx((0.05, 0.125, 0.0))
    assert cylinder.origin.position == pytest.approx((0.0, 0.0725, 0.0))
    assert rotate(cylinder.origin.orientation, (0.0, 0.0, 1.0)) == pytest.approx((0.0, 1.0, 0.0))


@pytest.mark.parametrize(
    "points",
    [a_prism(8), a_prism(24, width=3.9), a_prism(24, squash=0.9), a_prism(24)[:, [1, 0, 2]]],
    ids=["octagon", "short tread", "oval", "across"],
)
def test_other_mesh_of_a_wheel_is_unchanged(points: npt.NDArray[np.float64]) -> None:
    tyre = Shape("mesh", (0.05, 0.05, 0.05), mesh="tyre")

    assert a_mesh_cart(tyre, points)[1].collisions == (tyre,)


def test_eccentric_mesh_is_unchanged() -> None:
    tyre = Shape("mesh", (0.05, 0.05, 0.05), Origin((0.003, 0.0, 0.0)), mesh="tyre")

    assert a_mesh_cart(tyre, a_prism(24))[1].collisions == (tyre,)


def test_missing_mesh_is_unchanged() -> None:
    tyre = Shape("mesh", (0.05, 0.05, 0.05), mesh="tyre")

    assert a_mesh_cart(tyre, np.zeros((0, 3)))[1].collisions == (tyre,)


def test_report_names_round_wheels() -> None:
    tyre = Shape("mesh", (0.05, 0.05, 0.05), mesh="tyre")
    cart, round_mesh = a_cart_on(tyre, tyre, TYRE), {"tyre": a_prism(24)}.__getitem__
    undriven = msgspec.structs.replace(cart, drive=None)

    assert len(describe_contacts(cart, round_mesh)) == 2
    assert len(describe_contacts(cart, lambda _: a_prism(6))) == 1
    assert describe_contacts(undriven, round_mesh) == describe_contacts(cart, round_mesh)
    assert "friction" in describe_contacts(a_puck(), round_mesh)[0]


def test_wheel_on_the_ground_without_a_drive_becomes_a_sphere() -> None:
    undriven = msgspec.structs.replace(a_cart_on(TYRE), drive=None)

    assert links_in_contact(undriven) == links_in_contact(a_cart_on(TYRE))


@pytest.mark.parametrize("fields", [{"is_static": True}, {"joints": ()}], ids=["static", "fixed"])
def test_wheel_that_does_not_roll_is_unchanged(fields: dict[str, object]) -> None:
    cart = msgspec.structs.replace(a_cart_on(TYRE), drive=None)
    joints = tuple(msgspec.structs.replace(one, kind="fixed") for one in cart.joints)
    model = msgspec.structs.replace(cart, **({"joints": joints} if "joints" in fields else fields))

    assert links_in_contact(model) == model.links


@pytest.mark.parametrize(
    "shapes",
    [
        (TYRE, Shape("box", (0.01, 0.01, 0.01))),
        (msgspec.structs.replace(TYRE, size=(WHEEL_RADIUS_M, 0.004, 0.0)),),
        (msgspec.structs.replace(TYRE, size=(WHEEL_RADIUS_M, 0.11, 0.0)),),
        (),
    ],
    ids=["with a box", "propeller", "roller", "without"],
)
def test_link_that_is_more_or_less_than_a_wheel_is_unchanged(shapes: tuple[Shape, ...]) -> None:
    model = msgspec.structs.replace(a_cart_on(*shapes), drive=None)

    assert links_in_contact(model)[1] == model.links[1]


def test_wheel_of_a_swivel_and_a_cambered_one_are_unchanged_without_a_drive() -> None:
    cart = msgspec.structs.replace(a_cart_on(TYRE), drive=None)
    wheel, *others = cart.joints
    tilted = Origin(wheel.origin.position, tuple(from_rpy(0.02, 0.0, 0.0).tolist()))
    cambered = (msgspec.structs.replace(wheel, origin=tilted), *others)
    fork = Joint("swivel", "continuous", "base", "fork", axis=(0.0, 0.0, 1.0))
    caster = msgspec.structs.replace(wheel, parent="fork")

    for links, joints in (
        (cart.links, cambered),
        ((cart.links[0], Link("fork"), *cart.links[1:]), (fork, caster, *others)),
    ):
        model = msgspec.structs.replace(cart, links=links, joints=joints)
        assert links_in_contact(model) == model.links


def test_disc_above_the_ground_without_a_drive_is_unchanged() -> None:
    cart = msgspec.structs.replace(a_cart_on(TYRE), drive=None)
    leg = Shape("box", (0.02, 0.02, 0.02), Origin((0.0, 0.0, -0.1)))
    base = msgspec.structs.replace(cart.links[0], collisions=(leg,))
    model = msgspec.structs.replace(cart, links=(base, *cart.links[1:]))

    assert links_in_contact(model) == model.links


def test_links_without_wheels_are_unchanged() -> None:
    for model in (a_box(), a_cart()):
        assert links_in_contact(model) == model.links


def test_collisions_of_a_planar_move_have_no_friction() -> None:
    links = links_in_contact(a_puck())

    assert [shape.friction for link in links for shape in link.collisions] == [0.0]
