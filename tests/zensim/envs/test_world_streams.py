"""WorldStreams: seeds, and independence of worlds."""

import numpy as np

from zensim.envs.world_streams import WorldStreams


def make_streams(worlds: int, seed: int) -> WorldStreams:
    found = WorldStreams(worlds)
    found.seed(seed, np.arange(worlds))
    return found


def test_a_world_draws_the_same_whatever_the_others_draw() -> None:
    few, many = make_streams(2, 7), make_streams(50, 7)
    many.draw(np.array([0, 3]), 5)

    one, other = few.draw(np.array([1]), 3), many.draw(np.arange(1, 50), 4)

    assert (one[0] == other[0, :3]).all()
    assert len(np.unique(other)) == other.size


def test_numbers_are_even_in_the_unit_interval() -> None:
    drawn = make_streams(1000, 1).draw(np.arange(1000), 100)

    assert (drawn >= 0.0).all()
    assert (drawn < 1.0).all()
    counts, _ = np.histogram(drawn, 10)
    assert np.abs(counts / 1e4 - 1.0).max() < 0.05


def test_a_world_with_a_seed_of_its_own_is_the_first_of_that_seed() -> None:
    streams = make_streams(3, 1)
    kept = make_streams(3, 1).draw(np.array([1]), 4)

    streams.seed_each([5, None, 6])

    found = streams.draw(np.arange(3), 4)
    assert (found[0] == make_streams(9, 5).draw(np.array([0]), 4)).all()
    assert (found[1] == kept).all()
    assert (found[2] == make_streams(1, 6).draw(np.array([0]), 4)).all()


def test_seeds_differ_by_draw_and_world() -> None:
    streams = make_streams(4, 1)

    drawn = [*streams.draw_seeds(np.arange(4)), *streams.draw_seeds(np.arange(4))]

    assert len(set(drawn)) == 8
    assert all(0 <= seed < 1 << 62 for seed in drawn)
