"""Who goes to which cell."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from zensim.sim_server.physics.cells.cell_assignment import CellCapacity, assign_cells
from zensim.sim_server.scene.broad_phase import IntArray

ROOM = CellCapacity(most=4, at_once=100)


def along_a_line(count: int) -> np.ndarray:
    return np.stack([np.arange(float(count)), np.zeros(count)], axis=1)


def dealt(cells: list[int], groups: list[int], room: CellCapacity = ROOM) -> IntArray:
    return assign_cells(np.array(cells), np.array(groups), along_a_line(len(cells)), room)


def test_deal_leaves_everybody_where_he_is_when_all_is_well() -> None:
    assert dealt([0, 1, 1, 2], [0, 1, 1, 2]).tolist() == [0, 1, 1, 2]


def test_deal_joins_a_group_where_most_of_it_is() -> None:
    assert dealt([0, 1, 1, 2], [0, 0, 0, 1]).tolist() == [1, 1, 1, 2]


def test_deal_joins_a_group_in_the_first_cell_when_as_many_are_in_each() -> None:
    assert dealt([3, 1], [0, 0]).tolist() == [1, 1]


def test_deal_sends_the_far_end_of_a_full_cell_to_a_new_one() -> None:
    assert dealt([0] * 6, [0, 1, 2, 3, 4, 5]).tolist() == [0, 0, 0, 1, 1, 1]


def test_deal_sends_no_more_at_once_than_it_may() -> None:
    found = dealt([0] * 6, [0, 1, 2, 3, 4, 5], CellCapacity(most=4, at_once=1))

    assert found.tolist() == [0, 0, 0, 0, 0, 1]


def test_deal_keeps_a_group_whole_that_is_larger_than_a_cell() -> None:
    assert dealt([0] * 6, [0] * 6).tolist() == [0] * 6


def test_deal_fills_the_nearest_cell_that_has_room() -> None:
    found = dealt([1, 0, 0, 0, 0, 0, 2], [0, 1, 2, 3, 4, 5, 6])

    assert found.tolist() == [1, 0, 0, 0, 2, 2, 2]


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 9)), min_size=1, max_size=40))
def test_deal_never_parts_a_group(bodies: list[tuple[int, int]]) -> None:
    cells = [cell for cell, _ in bodies]
    _, groups = np.unique([group for _, group in bodies], return_inverse=True)

    found = dealt(cells, groups.tolist())

    for group in range(int(groups.max()) + 1):
        assert len(set(found[groups == group].tolist())) == 1
    counts, sizes = np.bincount(found), np.bincount(groups)
    assert counts.max() <= max(ROOM.most, sizes.max())


def test_cells_of_a_large_world_are_larger_but_not_without_end() -> None:
    room = CellCapacity(most=100, at_once=1, largest=250)

    assert [room.max_bodies(count) for count in (0, 400, 500, 900, 1000, 9000)] == [
        *(100, 100, 125),
        *(225, 250, 250),
    ]
