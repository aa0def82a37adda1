import math

import msgspec
import numpy as np
import pytest

from tests.models import TRACK_M, WHEEL_RADIUS_M, a_box_bot, a_cart
from zensim.proto.messages.model_messages import (
    Contact,
    Joint,
    JointKind,
    Link,
    Model,
    Origin,
    Shape,
    Vec3,
)
from zensim.proto.rigid_transforms import from_rpy
from zensim.sim_server.description.ground_friction import GroundFriction, GroundMotion, JointTargets

STRONG_NM = 1e3
SPEED = 4.0


def drive(model: Model, effort: float = STRONG_NM, **speeds: float) -> GroundMotion:
    """Drive joints at speeds [rad/s], by name."""
    index = {joint.name: i for i, joint in enumerate(model.joints)}
    targets = {index[name]: speed for name, speed in speeds.items()}
    return GroundFriction(model).move(
        JointTargets(np.zeros(len(model.joints)), targets, dict.fromkeys(targets, effort))
    )


def drive_cart(model: Model, left: float, right: float) -> GroundMotion:
    return drive(model, left_joint=left, right_joint=right)


def with_collisions(model: Model, link: int, *shapes: Shape) -> Model:
    links = list(model.links)
    links[link] = msgspec.structs.replace(links[link], collisions=shapes)
    return msgspec.structs.replace(model, links=tuple(links))


def with_caster(model: Model, *, swivels: bool) -> Model:
    """Put a cart on one caster wheel behind; it swivels about an axis 4 cm ahead of its axle."""
    radius = 0.02
    axle = (-0.1, 0.0, radius - WHEEL_RADIUS_M)
    fork, wheel = Link("fork", model.links[1].inertial), Link("caster", model.links[1].inertial)
    tyre = Shape(
        "cylinder", (radius, 0.01, 0.0), Origin((0.0, 0.0, 0.0), from_rpy(math.pi / 2.0, 0.0, 0.0))
    )
    kind: JointKind = "continuous" if swivels else "fixed"
    inertial = msgspec.structs.replace(model.links[0].inertial, com_in_link=(-0.03, 0.0, 0.0))
    base = msgspec.structs.replace(
        model.links[0], collisions=model.links[0].collisions[:1], inertial=inertial
    )
    return msgspec.structs.replace(
        model,
        links=(base, *model.links[1:], fork, msgspec.structs.replace(wheel, collisions=(tyre,))),
        joints=(
            *model.joints,
            Joint("swivel", kind, "base", "fork", Origin(axle), (0.0, 0.0, 1.0)),
            Joint("axle", "continuous", "fork", "caster", Origin((-0.04, 0, 0)), (0.0, 1.0, 0.0)),
        ),
    )


def test_wheels_roll_without_slip_where_nothing_else_rubs() -> None:
    found = drive_cart(a_cart(), SPEED, 2.0 * SPEED)

    assert found.twist == pytest.approx(
        (1.5 * SPEED * WHEEL_RADIUS_M, 0.0, SPEED * WHEEL_RADIUS_M / TRACK_M), abs=1e-4
    )


def test_passive_wheels_roll_with_the_robot() -> None:
    found = drive(a_cart(), left_joint=SPEED)

    # The wheel that nothing drives keeps what friction leaves free: no slip of either.
    vx, _, turn = found.twist
    assert vx - turn * TRACK_M / 2.0 == pytest.approx(SPEED * WHEEL_RADIUS_M, abs=1e-4)


@pytest.mark.parametrize(("left", "right"), [(SPEED, SPEED), (-SPEED, SPEED)])
def test_caster_that_swivels_does_not_hold_the_robot(left: float, right: float) -> None:
    found = drive_cart(with_caster(a_cart(), swivels=True), left, right)

    half = (left + right) / 2.0 * WHEEL_RADIUS_M
    assert found.twist == pytest.approx(
        (half, 0.0, (right - left) * WHEEL_RADIUS_M / TRACK_M), abs=1e-4
    )
    assert [one.is_trailing for one in found.contacts].count(True) == 2


def test_swivel_trails_behind_the_motion() -> None:
    model = with_caster(a_cart(), swivels=True)

    backward = drive_cart(model, -SPEED, -SPEED)

    assert abs(backward.rest.positions[2]) == pytest.approx(math.pi, abs=1e-3)


def test_caster_that_cannot_swivel_resists_a_turn() -> None:
    found = drive_cart(with_caster(a_cart(), swivels=False), -SPEED, SPEED)

    contact = next(one for one in found.contacts if one.link == 4)
    assert not contact.is_trailing
    assert found.motion.power_w > 0.01


def test_motor_without_torque_lets_its_wheel_stand() -> None:
    model = with_collisions(
        a_cart(),
        0,
        Shape("sphere", (0.02, 0.0, 0.0), Origin((0.1, 0.0, 0.02 - WHEEL_RADIUS_M)), friction=0.5),
        Shape("sphere", (0.02, 0.0, 0.0), Origin((-0.1, 0.0, 0.02 - WHEEL_RADIUS_M)), friction=0.5),
    )

    weak = drive(model, 0.01, left_joint=SPEED, right_joint=SPEED)
    strong = drive(model, STRONG_NM, left_joint=SPEED, right_joint=SPEED)

    assert weak.twist[0] == pytest.approx(0.0, abs=1e-4)
    assert strong.twist[0] == pytest.approx(SPEED * WHEEL_RADIUS_M, abs=1e-4)


def a_sledge(direction: tuple[float, float, float], along: float, across: float) -> Model:
    """Make a cart whose front foot drags with two frictions; much of the weight is on it."""
    contact = Contact(direction=direction, friction_across=across)
    place = Origin((0.1, 0.0, 0.02 - WHEEL_RADIUS_M))
    foot = Shape("sphere", (0.02, 0.0, 0.0), place, friction=along, contact=contact)
    model = with_collisions(a_cart(), 0, foot)
    inertial = msgspec.structs.replace(model.links[0].inertial, com_in_link=(0.08, 0.0, 0.0))
    base = msgspec.structs.replace(model.links[0], inertial=inertial)
    return msgspec.structs.replace(model, links=(base, *model.links[1:]))


def test_friction_along_its_direction_counts_for_motion_along_it() -> None:
    speeds = (SPEED, SPEED)

    held = drive_cart(a_sledge((1.0, 0.0, 0.0), 9.0, 0.01), *speeds)
    free = drive_cart(a_sledge((0.0, 1.0, 0.0), 9.0, 0.01), *speeds)

    assert held.twist[0] == pytest.approx(0.0, abs=1e-3)
    assert free.twist[0] == pytest.approx(SPEED * WHEEL_RADIUS_M, abs=1e-3)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
def test_friction_direction_of_a_wheel_that_is_not_its_axle_is_across_it(direction: Vec3) -> None:
    contact = Contact(direction=direction, friction_across=0.5)
    tyre = Shape("sphere", (WHEEL_RADIUS_M, 0.0, 0.0), friction=0.2, contact=contact)
    model = with_collisions(a_cart(), 1, tyre)

    found = GroundFriction(model).move(JointTargets(np.zeros(2), {}, {}))

    (wheel,) = (one for one in found.contacts if one.link == 1)
    assert (wheel.friction, wheel.along) == ((0.5, 0.2), (0.0, 1.0))


def test_contacts_of_box_bot_have_its_wheel_radius() -> None:
    model = a_box_bot()

    found = GroundFriction(model).move(JointTargets(np.zeros(len(model.joints)), {}, {}))

    assert [one.radius_m for one in found.contacts] == pytest.approx([0.035, 0.035], abs=1e-6)


def test_ball_joint_of_three_axes_rolls_in_all_directions() -> None:
    model = with_caster(a_cart(), swivels=True)
    yaw, axle = model.joints[2:]
    lying = Link("cross", model.links[1].inertial)
    ball = Shape("sphere", (0.02, 0.0, 0.0), friction=1.0)
    joints = (
        *model.joints[:2],
        msgspec.structs.replace(yaw, name="yaw"),
        msgspec.structs.replace(axle, name="pitch", child="cross", origin=Origin()),
        Joint("roll", "continuous", "cross", "caster", Origin(), (1.0, 0.0, 0.0)),
    )
    caster = msgspec.structs.replace(model.links[-1], collisions=(ball,))
    on_ball = msgspec.structs.replace(
        model, links=(*model.links[:-1], lying, caster), joints=joints
    )

    turned = drive_cart(on_ball, -SPEED, SPEED)
    ahead = drive_cart(on_ball, SPEED, SPEED)

    assert turned.twist[2] == pytest.approx(2.0 * SPEED * WHEEL_RADIUS_M / TRACK_M, abs=1e-4)
    assert ahead.twist[0] == pytest.approx(SPEED * WHEEL_RADIUS_M, abs=1e-4)
    assert ahead.motion.power_w + turned.motion.power_w < 1e-3
