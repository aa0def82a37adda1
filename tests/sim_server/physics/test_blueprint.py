"""Blueprints: parts of a model, skins for further frictions, principal axes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_body, a_box_bot, a_cart
from zensim.proto.messages.model_messages import (
    IDENTITY,
    Contact,
    Inertial,
    Joint,
    Link,
    Model,
    Origin,
    Shape,
)
from zensim.proto.rotation import from_rpy, rotate
from zensim.sim_server.physics.blueprint import DEFAULT_FRICTION, blueprint_of, principal_axes
from zensim.sim_server.physics.engine import FloatArray

angles = st.floats(-3.0, 3.0)
moments = st.floats(1e-4, 10.0)


def matrix_of(turn: FloatArray) -> FloatArray:
    return np.asarray(rotate(turn, np.eye(3)).T)


def six_of(matrix: FloatArray) -> tuple[float, ...]:
    return tuple(matrix[i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))


def a_ball(friction: float, radius_m: float = 0.1) -> Shape:
    return Shape("sphere", (radius_m, 0.0, 0.0), friction=friction)


def test_blueprint_has_a_part_for_each_link_in_the_order_of_joints() -> None:
    model = a_cart()

    blueprint = blueprint_of(model)

    parts = blueprint.parts[: len(model.links)]
    assert [part.joint for part in parts] == [None, *model.joints]
    assert [part.parent for part in parts] == [-1, 0, 0]
    assert [part.mass_kg for part in parts] == [2.0, 0.2, 0.2]


def test_blueprint_finds_parents_down_a_chain() -> None:
    links = tuple(Link(name, a_body()) for name in "abc")
    joints = (Joint("j", "revolute", "a", "b"), Joint("k", "revolute", "b", "c"))

    blueprint = blueprint_of(Model("chain", links, joints))

    assert [part.parent for part in blueprint.parts] == [-1, 0, 1]


def test_blueprint_gives_each_further_friction_a_massless_skin() -> None:
    balls = (a_ball(1.0), a_ball(0.0, 0.2), a_ball(1.0, 0.3), a_ball(0.5), a_ball(0.0, 0.4))
    model = Model("m", (Link("base", a_body(), balls),))

    root, *skins = blueprint_of(model).parts

    assert root.shapes == (balls[0], balls[2])
    assert [skin.shapes for skin in skins] == [(balls[1], balls[4]), (balls[3],)]
    assert [part.friction for part in (root, *skins)] == [1.0, 0.0, 0.5]
    assert all((s.mass_kg, s.parent, s.joint) == (0.0, 0, None) for s in skins)


def test_blueprint_puts_skins_after_all_links() -> None:
    two = (a_ball(1.0), a_ball(0.0))
    links = (Link("a", a_body(), two), Link("b", a_body(), two))

    blueprint = blueprint_of(Model("m", links, (Joint("j", "revolute", "a", "b"),)))

    assert [part.parent for part in blueprint.parts] == [-1, 0, 0, 1]
    assert [part.joint is None for part in blueprint.parts] == [True, False, True, True]


def test_blueprint_of_a_link_without_collisions_has_no_shapes() -> None:
    (root,) = blueprint_of(Model("m", (Link("base", a_body()),))).parts

    assert (root.shapes, root.friction) == ((), DEFAULT_FRICTION)


def test_blueprint_of_box_bot_has_one_skin_for_both_casters() -> None:
    blueprint = blueprint_of(a_box_bot())

    assert len(blueprint.parts) == 4
    assert [shape.friction for shape in blueprint.parts[3].shapes] == [0.0, 0.0]
    assert (blueprint.name, blueprint.is_static) == ("box_bot", False)


def test_principal_axes_are_those_of_the_link_when_products_are_zero() -> None:
    assert principal_axes((3.0, 0.0, 0.0, 1.0, 0.0, 2.0)) == ((3.0, 1.0, 2.0), IDENTITY)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.5), (1.0, 0.0, 0.0), (3.1, 0.0, 0.0), (1.0, 2.0, 3)])
def test_principal_axes_give_the_inertia_back(turn: tuple[float, float, float]) -> None:
    axes = matrix_of(from_rpy(*turn))
    inertia = axes @ np.diag([1.0, 2.0, 2.5]) @ axes.T

    diagonal, principal = principal_axes(six_of(inertia))

    found = matrix_of(np.array(principal))
    assert found @ np.diag(diagonal) @ found.T == pytest.approx(inertia, abs=1e-12)


@given(st.tuples(moments, moments, moments), st.tuples(angles, angles, angles))
def test_principal_axes_are_a_proper_rotation(
    diagonal: tuple[float, float, float], turn: tuple[float, float, float]
) -> None:
    axes = matrix_of(from_rpy(*turn))
    inertia = axes @ np.diag(diagonal) @ axes.T

    found, principal = principal_axes(six_of(inertia))

    rotation = matrix_of(np.array(principal))
    assert np.linalg.norm(principal) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-9)
    assert rotation @ np.diag(found) @ rotation.T == pytest.approx(inertia, abs=1e-9)
    assert sorted(found) == pytest.approx(sorted(diagonal), rel=1e-9)


def test_blueprint_keeps_mass_centre_and_inertia() -> None:
    inertial = Inertial(3.0, (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 2.0, 0.0, 2.5))

    (root,) = blueprint_of(Model("m", (Link("base", inertial),))).parts

    assert (root.mass_kg, root.com, root.inertia) == (3.0, (0.1, 0.2, 0.3), (1.0, 2.0, 2.5))


def test_link_of_many_shapes_is_split_so_that_none_is_passed_over() -> None:
    boxes = tuple(Shape("box", (1.0, 1.0, 1.0), Origin((float(i), 0.0, 0.0))) for i in range(40))

    parts = blueprint_of(Model("m", (Link("base", collisions=boxes),))).parts

    assert [len(part.shapes) for part in parts] == [16, 16, 8]
    assert [part.parent for part in parts] == [-1, 0, 0]


def test_blueprint_gives_each_further_contact_a_skin() -> None:
    soft, hard = Shape("sphere", contact=Contact(1e4, 1.0)), Shape("sphere")
    model = Model("m", (Link("base", a_body(), (hard, soft)),))

    root, skin = blueprint_of(model).parts

    assert (root.contact, skin.contact) == (hard.contact, soft.contact)
    assert (root.link, skin.link) == (0, 0)


@pytest.mark.parametrize(
    "direction", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.6, -0.8, 0.0)]
)
def test_blueprint_lays_the_axes_of_a_skin_along_its_direction(
    direction: tuple[float, float, float],
) -> None:
    foot = Shape("sphere", contact=Contact(direction=direction, friction_across=0.1))

    root, skin = blueprint_of(Model("m", (Link("base", a_body(), (foot,)),))).parts

    assert (root.shapes, skin.shapes) == ((), (foot,))
    assert rotate(np.array(skin.principal), np.array([1.0, 0.0, 0.0])) == pytest.approx(direction)
