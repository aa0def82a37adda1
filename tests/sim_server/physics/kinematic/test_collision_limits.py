"""Discs stop before each other and before edges."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.kinematic.collision_limits import (
    STOPPING_GAP_M,
    DiscMotions,
    find_distances_to_edges,
    limit_by_edges,
    limit_by_other_discs,
)

MANY = 30
places = arrays(np.float64, (MANY, 2), elements=st.floats(-3.0, 3.0))
ways = arrays(np.float64, (MANY, 2), elements=st.floats(-2.0, 2.0))
radii = arrays(np.float64, MANY, elements=st.floats(0.05, 0.5))


def some_moves(start: FloatArray, way: FloatArray, radius: FloatArray) -> DiscMotions:
    count = len(radius)
    reach = radius + np.linalg.norm(way, axis=1) + STOPPING_GAP_M
    return DiscMotions(start, way, radius, np.zeros(count), reach, np.ones(count, np.bool_))


def all_pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    one, other = np.triu_indices(count, 1)
    return one, other


def nearest(start: FloatArray, way: FloatArray, pairs: tuple[np.ndarray, np.ndarray]) -> FloatArray:
    """Sample the least distance of pairs on their ways."""
    one, other = pairs
    apart, closing = start[one] - start[other], way[one] - way[other]
    times = np.linspace(0.0, 1.0, 101)[:, None, None]
    return np.asarray(np.linalg.norm(apart + closing * times, axis=2).min(axis=0))


@settings(max_examples=60, deadline=None)
@given(start=places, way=ways, radius=radii)
def test_discs_keep_their_distance(start: FloatArray, way: FloatArray, radius: FloatArray) -> None:
    pairs = all_pairs(MANY)

    shares = limit_by_other_discs(some_moves(start, way, radius), *pairs, np.ones(MANY))

    one, other = pairs
    before = np.linalg.norm(start[one] - start[other], axis=1)
    least = np.minimum(before, radius[one] + radius[other])
    assert (nearest(start, way * shares[:, None], pairs) >= least - 1e-6).all()
    assert ((shares >= 0.0) & (shares <= 1.0)).all()


@settings(max_examples=60, deadline=None)
@given(start=places, way=ways, radius=radii)
def test_disc_without_neighbours_is_not_limited(
    start: FloatArray, way: FloatArray, radius: FloatArray
) -> None:
    pairs = all_pairs(MANY)
    one, other = pairs
    reach = np.linalg.norm(way, axis=1) + radius + 0.01
    meets = np.linalg.norm(start[one] - start[other], axis=1) < reach[one] + reach[other]

    shares = limit_by_other_discs(some_moves(start, way, radius), *pairs, np.ones(MANY))

    alone = np.setdiff1d(np.arange(MANY), np.concatenate([one[meets], other[meets]]))
    assert (shares[alone] == 1.0).all()


def test_follower_does_not_stop_its_leader() -> None:
    moves = some_moves(
        np.array([[0.0, 0.0], [0.21, 0.0]]), np.array([[0.5, 0.0], [0.1, 0.0]]), np.full(2, 0.1)
    )

    shares = limit_by_other_discs(moves, np.array([0]), np.array([1]), np.ones(2))

    assert shares[1] == 1.0
    assert 0.0 < shares[0] < 0.3


def test_overlapping_discs_may_separate_only() -> None:
    start = np.array([[0.0, 0.0], [0.1, 0.0]])

    parting = some_moves(start, np.array([[-0.1, 0.0], [0.0, 0.0]]), np.full(2, 0.1))
    closing = some_moves(start, np.array([[0.05, 0.0], [0.0, 0.0]]), np.full(2, 0.1))

    pair = np.array([0]), np.array([1])
    assert (limit_by_other_discs(parting, *pair, np.ones(2)) == 1.0).all()
    assert limit_by_other_discs(closing, *pair, np.ones(2))[0] == 0.0


@settings(max_examples=60, deadline=None)
@given(
    start=places,
    way=ways,
    radius=radii,
    ends=arrays(np.float64, (5, 4), elements=st.floats(-3.0, 3.0)),
)
def test_disc_does_not_pass_through_an_edge(
    start: FloatArray, way: FloatArray, radius: FloatArray, ends: FloatArray
) -> None:
    disc, edge = (part.ravel() for part in np.meshgrid(np.arange(MANY), np.arange(5)))
    moves = some_moves(start, way, radius)

    shares = limit_by_edges(moves, disc, ends[edge], np.zeros(len(edge)))

    _, before = find_distances_to_edges(start[disc], ends[edge])
    for part in np.linspace(0.0, 1.0, 51):
        at = start + way * shares[:, None] * part
        _, apart = find_distances_to_edges(at[disc], ends[edge])
        assert (apart >= np.minimum(before, radius[disc]) - 1e-6).all()


def test_disc_may_slide_along_a_wall() -> None:
    moves = some_moves(np.array([[0.0, 0.101]]), np.array([[1.0, 0.0]]), np.array([0.1]))

    shares = limit_by_edges(moves, np.array([0]), np.array([[-5.0, 0.0, 5.0, 0.0]]), np.zeros(1))

    assert shares[0] == 1.0
