"""Touching discs, near points and connected components are those found by brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import (
    are_beside,
    expand_ranges,
    find_near_points,
    find_touching_discs,
    label_components,
    make_point_grid,
)

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

    assert list(zip(one.tolist(), other.tolist(), strict=True)) == sorted(
        pairs_by_hand(centres, radii)
    )


def test_touching_discs_are_found_in_the_widest_world() -> None:
    centres = np.array([[-1e6, -1e6], [1e6, 1e6], [1e6, 1e6 - 0.1]])

    one, other = find_touching_discs(centres, np.array([0.1, 0.1, 0.1]))

    assert sorted([*one.tolist(), *other.tolist()]) == [1, 2]


@given(st.integers(1, 30), st.lists(st.tuples(st.integers(0, 29), st.integers(0, 29)), max_size=60))
def test_labels_join_pairs_and_nothing_else(count: int, given_pairs: list[tuple[int, int]]) -> None:
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


def test_touching_finds_no_pair_without_discs() -> None:
    one, other = find_touching_discs(np.zeros((0, 2)), np.zeros(0))

    assert len(one) == len(other) == 0


@pytest.mark.parametrize("count", [1, 5000])
def test_labels_join_a_chain_however_long_it_is(count: int) -> None:
    links = np.arange(count - 1)
    order = np.random.default_rng(1).permutation(count)

    labels = label_components(count, order[links], order[links + 1])

    assert not labels.any()


@settings(max_examples=60, deadline=None)
@given(
    points=arrays(np.float64, (12, 2), elements=st.floats(-9.0, 9.0)),
    queries=arrays(np.float64, (9, 2), elements=st.floats(-9.0, 9.0)),
)
def test_near_points_are_those_found_by_brute_force(
    points: FloatArray, queries: FloatArray
) -> None:
    apart = np.linalg.norm(queries[:, None] - points[None], axis=2)

    found = find_near_points(make_point_grid(points, 0.7), points, queries, 0.7)

    expected = np.argwhere(apart <= 0.7).tolist()
    assert sorted(map(list, zip(*(part.tolist() for part in found), strict=True))) == expected


@given(st.lists(places, min_size=1, max_size=20), st.lists(places, max_size=40))
def test_points_beside_those_of_a_grid_are_all_near_ones_and_no_far_ones(
    sorted_in: list[tuple[float, float]], given_points: list[tuple[float, float]]
) -> None:
    points = np.array(given_points).reshape(-1, 2)
    gaps = np.linalg.norm(points[:, None] - np.array(sorted_in)[None], axis=2).min(axis=1)

    found = are_beside(make_point_grid(np.array(sorted_in), 3.0), points)

    assert found[gaps <= 3.0].all()
    assert not found[gaps > 6.0 * np.sqrt(2.0)].any()


def test_ranges_are_expanded_with_their_owners() -> None:
    owners, numbers = expand_ranges(np.array([5, 0, 9]), np.array([2, 0, 1]))

    assert (owners.tolist(), numbers.tolist()) == ([0, 0, 2], [5, 6, 9])
