"""Frictions, priorities, and correction of sliding contacts."""

import numpy as np
import pytest

from zensim.sim_server.physics.mujoco.mujoco_contact import correct_sliding_rows, make_geom_friction


@pytest.mark.parametrize(("one", "other"), [(0.3, 1.0), (0.0, 0.2), (0.5, 0.6), (1.0, 2.0)])
def test_lesser_friction_has_the_higher_priority(one: float, other: float) -> None:
    lesser, greater = (
        make_geom_friction(one, is_static=False),
        make_geom_friction(other, is_static=False),
    )

    assert lesser.priority > greater.priority


@pytest.mark.parametrize("ground", [1.0, 100.0])
@pytest.mark.parametrize("friction", [0.0, 1.0, 50.0, 1e9])
def test_friction_of_rough_ground_does_not_count(ground: float, friction: float) -> None:
    assert (
        make_geom_friction(friction, is_static=False).priority
        > make_geom_friction(ground, is_static=True).priority
    )


def test_friction_of_smooth_ground_counts() -> None:
    assert (
        make_geom_friction(0.2, is_static=True).priority
        > make_geom_friction(0.5, is_static=False).priority
    )
    assert make_geom_friction(0.2, is_static=True).friction == 0.2


def test_compliant_part_has_priority_at_equal_friction() -> None:
    assert (
        make_geom_friction(0.5, is_static=False, is_soft=True).priority
        > make_geom_friction(0.5, is_static=False).priority
    )
    assert (
        make_geom_friction(0.5, is_static=False, is_soft=True).priority
        < make_geom_friction(0.4999, is_static=False).priority
    )


def test_contact_without_friction_is_one_row() -> None:
    assert make_geom_friction(0.0, is_static=False).rows == 1
    assert make_geom_friction(0.1, is_static=False).rows == 3


def test_slip_that_a_step_stops_changes_nothing() -> None:
    wanted = np.array([5.0, -3.0, 4.0])

    correct_sliding_rows(wanted, np.array([0], np.int32), np.array([0.6]), 9.81)

    assert wanted.tolist() == [5.0, -3.0, 4.0]


def test_rest_of_a_slip_is_subtracted_from_the_normal() -> None:
    wanted = np.array([9.0, 5.0, -30.0, 40.0])

    correct_sliding_rows(wanted, np.array([1], np.int32), np.array([0.5]), 10.0)

    assert wanted.tolist() == [9.0, 5.0 - 0.5 * (50.0 - 5.0), -30.0, 40.0]
