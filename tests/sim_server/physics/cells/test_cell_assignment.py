"""Groups of bodies that may touch are together, in cells with room."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.sim_server.physics.cells.cell_assignment import (
    CELL_GAP_M,
    SPEED_MARGIN_MPS,
    CellCapacity,
    CellLoads,
    assign_cells,
    find_interaction_groups,
)
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.scene.broad_phase import IntArray

CAPACITY = CellCapacity(cell_bodies=4, moved_bodies=100)


def along_a_line(count: int) -> np.ndarray:
    return np.stack([np.arange(float(count)), np.zeros(count)], axis=1)


def assign(cells: list[int], groups: list[int], capacity: CellCapacity = CAPACITY) -> IntArray:
    return assign_cells(np.array(cells), np.array(groups), along_a_line(len(cells)), capacity)


def test_assignment_keeps_cells_within_their_capacity() -> None:
    assert assign([0, 1, 1, 2], [0, 1, 1, 2]).tolist() == [0, 1, 1, 2]


def test_assignment_joins_a_group_in_the_cell_with_most_of_it() -> None:
    assert assign([0, 1, 1, 2], [0, 0, 0, 1]).tolist() == [1, 1, 1, 2]


def test_assignment_joins_a_group_in_the_first_of_equal_cells() -> None:
    assert assign([3, 1], [0, 0]).tolist() == [1, 1]


def test_assignment_moves_the_far_end_of_an_overfull_cell_to_a_new_one() -> None:
    assert assign([0] * 6, [0, 1, 2, 3, 4, 5]).tolist() == [0, 0, 0, 1, 1, 1]


def test_assignment_moves_at_most_the_given_number_at_once() -> None:
    found = assign([0] * 6, [0, 1, 2, 3, 4, 5], CellCapacity(cell_bodies=4, moved_bodies=1))

    assert found.tolist() == [0, 0, 0, 0, 0, 1]


def test_assignment_does_not_split_a_group_larger_than_a_cell() -> None:
    assert assign([0] * 6, [0] * 6).tolist() == [0] * 6


def test_assignment_fills_the_nearest_cell_with_capacity() -> None:
    found = assign([1, 0, 0, 0, 0, 0, 2], [0, 1, 2, 3, 4, 5, 6])

    assert found.tolist() == [1, 0, 0, 0, 2, 2, 2]


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 9)), min_size=1, max_size=40))
def test_assignment_never_splits_a_group(bodies: list[tuple[int, int]]) -> None:
    cells = [cell for cell, _ in bodies]
    _, groups = np.unique([group for _, group in bodies], return_inverse=True)

    found = assign(cells, groups.tolist())

    for group in range(int(groups.max()) + 1):
        assert len(set(found[groups == group].tolist())) == 1
    counts, sizes = np.bincount(found), np.bincount(groups)
    assert counts.max() <= max(CAPACITY.cell_bodies, sizes.max())


@given(
    cells=st.lists(st.integers(0, 3), min_size=1, max_size=30),
    moves=st.lists(st.tuples(st.integers(0, 29), st.integers(0, 6)), max_size=10),
)
def test_loads_that_follow_moves_are_those_of_a_new_count(
    cells: list[int], moves: list[tuple[int, int]]
) -> None:
    now, places = np.array(cells, np.intp), along_a_line(len(cells))
    loads = CellLoads(now, places)

    for body, cell in moves:
        member, target = np.array([body % len(cells)]), min(cell, len(loads.counts))
        loads.move(member, int(now[member[0]]), target)
        now[member] = target

    anew = CellLoads(now, places)
    used = len(anew.counts)
    assert loads.counts[:used].tolist() == anew.counts.tolist()
    assert not loads.counts[used:].any()
    assert loads.sums[:used] == pytest.approx(anew.sums)


def test_capacity_grows_with_the_world_up_to_its_limit() -> None:
    capacity = CellCapacity(cell_bodies=100, moved_bodies=1, large_cell_bodies=250)

    assert [capacity.max_bodies(count) for count in (0, 400, 500, 900, 1000, 9000)] == [
        *(100, 100, 125),
        *(225, 250, 250),
    ]


PERIOD_S = 0.01


def points_on_a_line(*places: float) -> FloatArray:
    return np.stack([np.array(places), np.zeros(len(places))], axis=1)


def test_groups_join_bodies_that_can_meet_within_the_periods() -> None:
    near = 0.2 + CELL_GAP_M + 2 * 3.0 * PERIOD_S

    for gap, groups in ((near - 1e-6, [0, 0]), (near + 1e-6, [0, 1])):
        found = find_interaction_groups(
            points_on_a_line(0.0, gap), np.full(2, 0.1), np.full(2, 3.0), PERIOD_S, periods=1
        )
        assert found.groups.tolist() == groups


def test_groups_reach_farther_for_more_periods() -> None:
    places, radii, speeds = points_on_a_line(0.0, 0.4), np.full(2, 0.1), np.full(2, 3.0)

    found = [
        find_interaction_groups(places, radii, speeds, PERIOD_S, periods=n).groups.tolist()
        for n in (1, 4)
    ]

    assert found == [[0, 1], [0, 0]]


def test_groups_assume_the_speed_of_the_fastest_body_after_an_impact() -> None:
    places = points_on_a_line(0.0, 0.3, 0.6)

    found = find_interaction_groups(
        places, np.full(3, 0.1), np.array([20.0, 2.0, 2.0]), PERIOD_S, periods=1
    )

    assert found.groups.tolist() == [0, 0, 0]
    assert (found.speeds >= 20.0 - SPEED_MARGIN_MPS / 2.0).all()


def test_groups_keep_bodies_without_a_finite_place_apart() -> None:
    places = points_on_a_line(0.0, np.nan, np.inf, 0.1)

    found = find_interaction_groups(places, np.full(4, 0.1), np.full(4, 1.0), PERIOD_S, periods=1)

    assert found.groups.tolist() == [0, 1, 2, 0]
    assert found.largest == 2
