"""Who may touch whom before the next look."""

import numpy as np

from zensim.sim_server.physics.cells.cell_assignment import (
    CELL_GAP_M,
    SPEED_MARGIN_MPS,
    find_interaction_groups,
)
from zensim.sim_server.physics.engine import FloatArray

PERIOD_S = 0.01


def along_a_line(*places: float) -> FloatArray:
    return np.stack([np.array(places), np.zeros(len(places))], axis=1)


def test_part_puts_two_together_that_can_meet_in_time() -> None:
    near = 0.2 + CELL_GAP_M + 2 * 3.0 * PERIOD_S

    for gap, groups in ((near - 1e-6, [0, 0]), (near + 1e-6, [0, 1])):
        found = find_interaction_groups(
            along_a_line(0.0, gap), np.full(2, 0.1), np.full(2, 3.0), PERIOD_S, periods=1
        )
        assert found.groups.tolist() == groups


def test_part_looks_farther_when_it_is_to_hold_for_longer() -> None:
    places, radii, speeds = along_a_line(0.0, 0.4), np.full(2, 0.1), np.full(2, 3.0)

    found = [
        find_interaction_groups(places, radii, speeds, PERIOD_S, periods=n).groups.tolist()
        for n in (1, 4)
    ]

    assert found == [[0, 1], [0, 0]]


def test_part_takes_who_may_be_hit_for_as_fast_as_who_hits() -> None:
    places = along_a_line(0.0, 0.3, 0.6)

    found = find_interaction_groups(
        places, np.full(3, 0.1), np.array([20.0, 2.0, 2.0]), PERIOD_S, periods=1
    )

    assert found.groups.tolist() == [0, 0, 0]
    assert (found.speeds >= 20.0 - SPEED_MARGIN_MPS / 2.0).all()


def test_part_leaves_alone_what_is_nowhere() -> None:
    places = along_a_line(0.0, np.nan, np.inf, 0.1)

    found = find_interaction_groups(places, np.full(4, 0.1), np.full(4, 1.0), PERIOD_S, periods=1)

    assert found.groups.tolist() == [0, 1, 2, 0]
    assert found.largest == 2
