"""Only changed targets are returned."""

import numpy as np

from zensim.sim_server.physics.command_cache import CommandCache

WIDTHS = {0: 2, 1: 0, 2: 1, 100: 3}


def make_cache() -> CommandCache:
    return CommandCache(WIDTHS.__getitem__)


def changes(
    cache: CommandCache, bodies: tuple[int, ...], *numbers: float
) -> list[tuple[int, list[float]]]:
    return list(cache.take_changed(bodies, np.array(numbers)))


def test_first_targets_are_changed() -> None:
    assert changes(make_cache(), (2, 0, 1), 5.0, 6.0, 7.0) == [(2, [5.0]), (0, [6.0, 7.0])]


def test_repeated_targets_are_not_changed() -> None:
    cache = make_cache()
    changes(cache, (0, 2), 1.0, 2.0, 3.0)

    assert changes(cache, (0, 2), 1.0, 2.0, 3.0) == []


def test_only_bodies_with_different_targets_are_changed() -> None:
    cache = make_cache()
    changes(cache, (0, 2), 1.0, 2.0, 3.0)

    assert changes(cache, (0, 2), 1.0, 9.0, 3.0) == [(0, [1.0, 9.0])]


def test_targets_are_stored_by_body_in_any_sequence() -> None:
    cache = make_cache()
    changes(cache, (0, 2), 1.0, 2.0, 3.0)

    assert changes(cache, (2,), 4.0) == [(2, [4.0])]
    assert changes(cache, (0, 2), 1.0, 2.0, 3.0) == [(2, [3.0])]


def test_targets_of_a_forgotten_body_are_changed() -> None:
    cache = make_cache()
    changes(cache, (0, 2), 1.0, 2.0, 3.0)

    cache.forget(0)

    assert changes(cache, (0, 2), 1.0, 2.0, 3.0) == [(0, [1.0, 2.0])]


def test_body_without_targets_can_be_forgotten() -> None:
    cache = make_cache()

    cache.forget(100)

    assert changes(cache, (100,), 1.0, 2.0, 3.0) == [(100, [1.0, 2.0, 3.0])]


def test_stored_targets_survive_growth() -> None:
    cache = make_cache()
    changes(cache, (0, 2), 1.0, 2.0, 3.0)
    changes(cache, (100,), 4.0, 5.0, 6.0)

    assert changes(cache, (2, 100, 0), 3.0, 4.0, 5.0, 7.0, 1.0, 2.0) == [(100, [4.0, 5.0, 7.0])]


def test_index_cache_is_bounded() -> None:
    cache = make_cache()

    for length in range(1, 600):
        changes(cache, (0,) * length, *([1.0, 2.0] * length))

    assert changes(cache, (0,), 1.0, 2.0) == []


def test_no_bodies_have_no_changes() -> None:
    assert changes(make_cache(), ()) == []
    assert changes(make_cache(), (1,)) == []


def test_last_targets_are_found_and_zeros_of_bodies_that_have_none() -> None:
    cache = make_cache()
    changes(cache, (0,), 1.0, 2.0)

    assert cache.find(0, 2) == [1.0, 2.0]
    assert cache.find(2, 1) == [0.0]
    assert cache.find(100, 3) == [0.0, 0.0, 0.0]
