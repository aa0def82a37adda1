"""Slots of a compiled model."""

import pytest

from tests.models import a_box, a_cart
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.mujoco.slot_layout import (
    MAX_UNUSED_ARCHETYPES,
    Archetype,
    SlotAllocator,
    SlotSizes,
    make_archetype,
    round_up_slots,
)

BOX, CART = make_archetype(make_blueprint(a_box())), make_archetype(make_blueprint(a_cart()))


@pytest.mark.parametrize(("count", "slots"), [(1, 1), (2, 2), (3, 4), (5, 8), (64, 64), (65, 128)])
def test_slot_count_is_the_next_power_of_two(count: int, slots: int) -> None:
    assert round_up_slots(count) == slots


def test_lowest_free_slot_is_assigned_first() -> None:
    slots = SlotAllocator()
    assert [slots.take(BOX, body) for body in range(4)] == [0, 1, 2, 3]

    slots.release(BOX, 2)
    slots.release(BOX, 1)

    assert [slots.take(BOX, body) for body in (7, 8, 9)] == [1, 2, 4]


def test_counts_are_in_the_order_of_first_bodies() -> None:
    slots = SlotAllocator()
    for body, archetype in enumerate((CART, BOX, BOX, CART, BOX)):
        slots.take(archetype, body)

    assert slots.counts == ((CART, 2), (BOX, 4))


def test_counts_with_one_more_need_no_slot_taken() -> None:
    slots = SlotAllocator()
    for body, archetype in enumerate((CART, BOX, BOX)):
        expected = slots.with_one_more(archetype)
        slots.take(archetype, body)

        assert slots.counts == expected


def test_robots_that_differ_in_name_only_have_one_archetype() -> None:
    assert make_archetype(make_blueprint(a_box("other"))) == BOX
    assert hash(make_archetype(make_blueprint(a_box("other")))) == hash(BOX)
    assert make_archetype(make_blueprint(a_box(friction=0.5))) != BOX


def test_slots_of_models_that_came_and_went_are_dropped() -> None:
    slots = SlotAllocator()
    kept = Archetype((), (), is_static=True)
    slots.take(kept, 0)

    for number in range(1, 10 * MAX_UNUSED_ARCHETYPES):
        archetype = Archetype((), (True,) * number, is_static=False)
        expected = slots.with_one_more(archetype)
        slot = slots.take(archetype, number)
        assert slots.counts == expected
        slots.release(archetype, slot)

    assert slots.counts[0] == (kept, 1)
    assert len(slots.counts) <= MAX_UNUSED_ARCHETYPES + 2


def test_expected_slots_are_those_that_bodies_get_one_by_one() -> None:
    order = [CART, BOX, BOX, CART, BOX]
    one_by_one, at_once = SlotAllocator(), SlotAllocator()
    for archetype in order:
        at_once.expect_one_more(archetype)

    final = at_once.with_one_more(CART)
    slots = [
        (one_by_one.take(archetype, body), at_once.take(archetype, body))
        for body, archetype in enumerate(order)
    ]

    assert final == at_once.counts == one_by_one.counts
    assert all(alone == together for alone, together in slots)
    assert not at_once.expects_more


def test_expected_bodies_fill_free_slots_first() -> None:
    slots = SlotAllocator()
    for body in range(3):
        slots.take(BOX, body)

    slots.expect_one_more(BOX)

    assert slots.with_one_more(CART) == ((BOX, 4), (CART, 1))


def test_expected_scenery_gets_no_more_slots_than_it_needs() -> None:
    slots = SlotAllocator()
    tree = make_archetype(make_blueprint(a_box(is_static=True)))
    for _ in range(5):
        slots.expect_one_more(tree)

    assert slots.with_one_more(tree) == ((tree, 5),)


def test_forgotten_bodies_get_no_slots() -> None:
    slots = SlotAllocator()
    slots.expect_one_more(CART)

    slots.forget_expected()

    assert slots.with_one_more(BOX) == ((BOX, 1),)


def test_sizes_of_slots_add_up_array_by_array() -> None:
    sizes = SlotSizes(1, 2, 3, 4, 5)

    assert sizes + SlotSizes(10, 20, 30, 40, 50) == SlotSizes(11, 22, 33, 44, 55)
    assert sizes + SlotSizes() == sizes
    assert sizes.times(3) == SlotSizes(3, 6, 9, 12, 15)
