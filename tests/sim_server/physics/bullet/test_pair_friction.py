"""Collision filters of surfaces by friction."""

import pytest

from tests.models import a_box, a_cart
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.bullet.pair_friction import (
    COLLIDE_WITH_ALL,
    OTHER_BITS,
    STATIC_FILTER,
    CollisionFilter,
    FrictionGroups,
    MovingSurface,
    add_twin_surfaces,
    find_copy_friction,
    list_moving_surfaces,
    list_slippery_surfaces,
)


def list_surfaces(model: Model) -> tuple[MovingSurface, ...]:
    return list_moving_surfaces(add_twin_surfaces(make_blueprint(model)))


def collide(one: CollisionFilter, other: CollisionFilter) -> bool:
    return bool(one[0] & other[1]) and bool(other[0] & one[1])


def list_products(one: Model, other: Model) -> list[float]:
    """List the frictions of the pairs of surfaces of two loose bodies that collide."""
    groups = FrictionGroups()
    pairs = [(a, b) for a in list_surfaces(one) for b in list_surfaces(other)]
    for pair in pairs:
        groups.add(pair)
    return [
        a.friction * b.friction
        for a, b in pairs
        if collide(groups.find_filter(a), groups.find_filter(b))
    ]


@pytest.mark.parametrize(
    ("one", "other", "friction"),
    [
        (0.4, 0.4, 0.4),
        (0.4, 1.0, 0.4),
        (0.4, 5.0, 0.4),
        (1.0, 5.0, 1.0),
        (5.0, 5.0, 1.0),
        (0.0, 0.4, 0.0),
        (0.25, 0.64, 0.4),
    ],
)
def test_one_pair_of_surfaces_of_two_loose_bodies_collides(
    one: float, other: float, friction: float
) -> None:
    found = list_products(a_box(friction=one), a_box(friction=other))

    assert found == pytest.approx([friction])


@pytest.mark.parametrize("friction", [0.4, 5.0])
def test_loose_body_meets_static_ones_by_its_own_friction(friction: float) -> None:
    groups = FrictionGroups()
    surfaces = list_surfaces(a_box(friction=friction))

    for is_grouped in (False, True):
        if is_grouped:
            groups.add(surfaces)
        met = [one for one in surfaces if collide(groups.find_filter(one), STATIC_FILTER)]
        assert [one.friction for one in met] == [friction]


@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_frictions_that_multiply_to_the_lesser_need_nothing(friction: float) -> None:
    (surface,) = list_surfaces(a_box(friction=friction))
    groups = FrictionGroups()

    assert not groups.add([surface])
    assert groups.find_filter(surface) == COLLIDE_WITH_ALL


def test_robots_have_no_twins() -> None:
    assert not any(one.is_twin for one in list_surfaces(a_cart()))


def test_surfaces_beyond_the_last_group_are_common() -> None:
    groups = FrictionGroups()
    frictions = [0.01 + 0.02 * i for i in range(len(OTHER_BITS) + 1)]

    groups.add(MovingSurface(-1, one, is_twin=False, is_paired=False) for one in frictions)

    last = MovingSurface(-1, frictions[-1], is_twin=False, is_paired=False)
    assert len(groups.list_frictions()) == len(OTHER_BITS)
    assert groups.find_filter(last) == COLLIDE_WITH_ALL


def test_only_static_bodies_below_1_are_slippery() -> None:
    found = [
        list_slippery_surfaces(make_blueprint(a_box(friction=friction, is_static=is_static)))
        for friction, is_static in ((0.5, True), (1.0, True), (0.5, False))
    ]

    assert found == [((-1, 0.5),), (), ()]


@pytest.mark.parametrize("static", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("moving", [0.2, 0.5, 3.0])
def test_product_with_a_copy_is_the_lesser(static: float, moving: float) -> None:
    assert find_copy_friction(static, moving) * moving == pytest.approx(min(static, moving))
