"""Bodies are told again only what they have not been told."""

import numpy as np

from zensim.sim_server.physics.command_cache import CommandCache

WIDTHS = {0: 2, 1: 0, 2: 1, 100: 3}


def orders() -> CommandCache:
    return CommandCache(WIDTHS.__getitem__)


def news(
    made: CommandCache, bodies: tuple[int, ...], *numbers: float
) -> list[tuple[int, list[float]]]:
    return list(made.take_changed(bodies, np.array(numbers)))


def test_all_that_comes_first_is_new() -> None:
    assert news(orders(), (2, 0, 1), 5.0, 6.0, 7.0) == [(2, [5.0]), (0, [6.0, 7.0])]


def test_nothing_is_new_when_it_comes_again() -> None:
    made = orders()
    news(made, (0, 2), 1.0, 2.0, 3.0)

    assert news(made, (0, 2), 1.0, 2.0, 3.0) == []


def test_only_what_differs_is_new() -> None:
    made = orders()
    news(made, (0, 2), 1.0, 2.0, 3.0)

    assert news(made, (0, 2), 1.0, 9.0, 3.0) == [(0, [1.0, 9.0])]


def test_bodies_are_known_whatever_company_they_come_in() -> None:
    made = orders()
    news(made, (0, 2), 1.0, 2.0, 3.0)

    assert news(made, (2,), 4.0) == [(2, [4.0])]
    assert news(made, (0, 2), 1.0, 2.0, 3.0) == [(2, [3.0])]


def test_all_is_new_to_a_body_that_was_forgotten() -> None:
    made = orders()
    news(made, (0, 2), 1.0, 2.0, 3.0)

    made.forget(0)

    assert news(made, (0, 2), 1.0, 2.0, 3.0) == [(0, [1.0, 2.0])]


def test_body_that_was_never_told_anything_can_be_forgotten() -> None:
    made = orders()

    made.forget(100)

    assert news(made, (100,), 1.0, 2.0, 3.0) == [(100, [1.0, 2.0, 3.0])]


def test_what_was_told_stays_known_when_wider_and_later_bodies_come() -> None:
    made = orders()
    news(made, (0, 2), 1.0, 2.0, 3.0)
    news(made, (100,), 4.0, 5.0, 6.0)

    assert news(made, (2, 100, 0), 3.0, 4.0, 5.0, 7.0, 1.0, 2.0) == [(100, [4.0, 5.0, 7.0])]


def test_many_companies_of_bodies_do_not_pile_up() -> None:
    made = orders()

    for length in range(1, 600):
        news(made, (0,) * length, *([1.0, 2.0] * length))

    assert news(made, (0,), 1.0, 2.0) == []


def test_nobody_is_told_nothing() -> None:
    assert news(orders(), ()) == []
    assert news(orders(), (1,)) == []
