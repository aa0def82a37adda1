"""Discs that touch, and what hangs together by it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import find_touching_discs, label_components

places = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
discs = st.lists(
    st.tuples(places, st.one_of(st.floats(0.0, 2.0), st.floats(0.0, 50.0))), max_size=40
)


def pairs_by_hand(centres: FloatArray, radii: FloatArray) -> set[tuple[int, int]]:
    apart = centres[:, None] - centres[None]
    touch = (apart * apart).sum(axis=2) <= (radii[:, None] + radii[None]) ** 2
    return {(i, j) for i, j in zip(*np.nonzero(touch), strict=True) if i < j}


@given(discs)
def test_touching_finds_every_pair_and_no_other(
    given_discs: list[tuple[tuple[float, float], float]],
) -> None:
    centres = np.array([centre for centre, _ in given_discs]).reshape(-1, 2)
    radii = np.array([radius for _, radius in given_discs])

    one, other = find_touching_discs(centres, radii)

    found = {(min(i, j), max(i, j)) for i, j in zip(one.tolist(), other.tolist(), strict=True)}
    assert found == pairs_by_hand(centres, radii)


def test_touching_bears_a_world_as_wide_as_can_be() -> None:
    centres = np.array([[-1e6, -1e6], [1e6, 1e6], [1e6, 1e6 - 0.1]])

    one, other = find_touching_discs(centres, np.array([0.1, 0.1, 0.1]))

    assert sorted([*one.tolist(), *other.tolist()]) == [1, 2]


@given(st.integers(1, 30), st.lists(st.tuples(st.integers(0, 29), st.integers(0, 29)), max_size=60))
def test_labels_join_what_is_paired_and_nothing_else(
    count: int, given_pairs: list[tuple[int, int]]
) -> None:
    pairs = [(i % count, j % count) for i, j in given_pairs]

    labels = label_components(
        count,
        np.array([i for i, _ in pairs], dtype=np.intp),
        np.array([j for _, j in pairs], dtype=np.intp),
    )

    assert [int(label) for label in labels] == groups_by_hand(count, pairs)


def groups_by_hand(count: int, pairs: list[tuple[int, int]]) -> list[int]:
    least = list(range(count))
    for _ in range(count):
        for i, j in pairs:
            least[i] = least[j] = min(least[i], least[j])
    names = sorted(set(least))
    return [names.index(one) for one in least]


def test_touching_finds_nothing_among_no_discs() -> None:
    one, other = find_touching_discs(np.zeros((0, 2)), np.zeros(0))

    assert len(one) == len(other) == 0


@pytest.mark.parametrize("count", [1, 5000])
def test_labels_join_a_chain_however_long_it_is(count: int) -> None:
    links = np.arange(count - 1)
    order = np.random.default_rng(1).permutation(count)

    labels = label_components(count, order[links], order[links + 1])

    assert not labels.any()
