"""Numbers that Bullet takes for contacts, and which parts of a body touch each other."""

import pytest

from tests.models import a_body
from zensim.proto.messages.model_messages import Contact, Joint, Link, Model, Shape
from zensim.sim_server.physics.blueprint import Part, blueprint_of
from zensim.sim_server.physics.touch import (
    REACH_M,
    self_touching,
    standing_friction,
    touch_of,
    touches_itself,
)

DT_S = 0.004
RIGID = Contact()
BALL = Shape("sphere", (0.1, 0.0, 0.0))


def a_part(contact: Contact = RIGID, friction: float = 0.5) -> Part:
    return Part(
        mass_kg=1.0,
        com=(0.0, 0.0, 0.0),
        principal=(0.0, 0.0, 0.0, 1.0),
        inertia=(1.0, 1.0, 1.0),
        shapes=(BALL,),
        friction=friction,
        contact=contact,
        parent=-1,
        link=0,
    )


def test_rigid_part_has_its_friction_and_nothing_else() -> None:
    touch = touch_of(a_part(), DT_S, is_static=False)

    assert touch == {
        "lateralFriction": 0.5,
        "spinningFriction": 0.0,
        "rollingFriction": 0.0,
        "restitution": 0.0,
        "contactProcessingThreshold": REACH_M,
    }


@pytest.mark.parametrize(("damping", "used"), [(1.0, 16.0), (100.0, 100.0)])
def test_soft_part_is_damped_enough_not_to_jump(damping: float, used: float) -> None:
    touch = touch_of(a_part(Contact(1000.0, damping)), DT_S, is_static=False)

    assert touch["contactStiffness"] == 1000.0
    assert touch["contactDamping"] == pytest.approx(used)


@pytest.mark.parametrize(
    ("along", "across", "most", "shares"),
    [(0.5, 0.25, 0.5, (1.0, 0.5, 0.5)), (0.2, 0.8, 0.8, (0.25, 1.0, 1.0)), (0, 0, 0, (1, 1, 1))],
)
def test_frictions_of_two_directions_are_shares_of_the_greater(
    along: float, across: float, most: float, shares: tuple[float, float, float]
) -> None:
    contact = Contact(direction=(1.0, 0.0, 0.0), friction_across=across)

    touch = touch_of(a_part(contact, along), DT_S, is_static=False)

    assert touch["lateralFriction"] == most
    assert touch["anisotropicFriction"] == pytest.approx(shares)


@pytest.mark.parametrize(("written", "used"), [(0.3, 0.3), (1.0, 1.0), (100.0, 1.0)])
def test_what_stands_still_leaves_others_their_friction(written: float, used: float) -> None:
    assert standing_friction(written) == used
    assert touch_of(a_part(friction=written), DT_S, is_static=True)["lateralFriction"] == used
    assert touch_of(a_part(friction=written), DT_S, is_static=False)["lateralFriction"] == written


def a_row(count: int, *asking: int) -> Model:
    """Links one after another; each but the first has a slippery skin besides."""
    slick = Shape("sphere", (0.1, 0.0, 0.0), friction=0.0)
    links = tuple(
        Link(f"l{i}", a_body(), (BALL, slick) if i else (BALL,), self_collides=i in asking)
        for i in range(count)
    )
    joints = tuple(Joint(f"j{i}", "continuous", f"l{i - 1}", f"l{i}") for i in range(1, count))
    return Model("row", links, joints)


def touching_of(model: Model) -> set[tuple[int, int]]:
    return {(i, j) for i, j, do_touch in self_touching(blueprint_of(model)) if do_touch}


def test_parts_touch_where_either_link_asks_and_no_joint_joins_them() -> None:
    # Parts -1 to 2 are the links, 3 to 5 the skins of the last three.
    assert touching_of(a_row(4, 0)) == {(-1, 1), (-1, 2), (-1, 4), (-1, 5)}
    assert touching_of(a_row(4)) == set()


def test_body_touches_itself_only_when_a_link_asks() -> None:
    assert touches_itself(a_row(2, 1).links)
    assert not touches_itself(a_row(2).links)
