import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.sim_server.description.coulomb_motion import SlipTerms, solve_coulomb_motion

FloatArray = np.ndarray


def contacts(places: FloatArray, speeds: FloatArray, loads: FloatArray) -> SlipTerms:
    """Make isotropic contacts at places (n, 2) on ground that moves with speeds (n, 2)."""
    rows = np.zeros((len(places), 2, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = 1.0
    rows[:, 0, 2], rows[:, 1, 2] = -places[:, 1], places[:, 0]
    scaled = rows * loads[:, None, None]
    return SlipTerms(scaled, speeds * loads[:, None], loads, np.zeros(3))


def power(terms: SlipTerms, x: FloatArray) -> float:
    slips = terms.rows @ x - terms.offsets
    return float(np.hypot(slips[:, 0], slips[:, 1]).sum())


def least_power_by_search(terms: SlipTerms, seed: int) -> float:
    """Search at random about the best found so far, in ever smaller boxes."""
    random = np.random.default_rng(seed)
    best, size = np.zeros(3), 2.0
    least = power(terms, best)
    while size > 1e-7:
        tried = best + size * random.uniform(-1.0, 1.0, (64, 3))
        slips = np.einsum("nim,tm->tni", terms.rows, tried) - terms.offsets
        powers = np.hypot(slips[..., 0], slips[..., 1]).sum(axis=1)
        at = int(powers.argmin())
        if powers[at] < least:
            best, least = tried[at], float(powers[at])
        else:
            size *= 0.8
    return least


def test_motion_is_that_of_the_wheels_where_none_slips() -> None:
    places = np.array([[0.0, 0.2], [0.0, -0.2]])
    speeds = np.array([[0.1, 0.0], [0.3, 0.0]])

    found = solve_coulomb_motion(contacts(places, speeds, np.array([10.0, 10.0])))

    assert found.is_converged
    assert found.twist == pytest.approx((0.2, 0.0, 0.5), abs=1e-5)
    assert found.power_w == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("half_base", [0.05, 0.2, 0.4])
def test_square_of_skidding_wheels_turns_as_the_closed_form(half_base: float) -> None:
    half_track, spin = 0.25, 0.5
    places = np.array([(x, y) for x in (half_base, -half_base) for y in (half_track, -half_track)])
    speeds = np.stack([-places[:, 1] * spin, 0.0 * places[:, 1]], axis=1)

    found = solve_coulomb_motion(contacts(places, speeds, np.full(4, 50.0)))

    # Each wheel's friction passes the centre where track^2 (spin - turn) = base^2 turn.
    expected = spin * half_track**2 / (half_track**2 + half_base**2)
    assert found.twist == pytest.approx((0.0, 0.0, expected), abs=1e-5)


def test_motion_is_at_rest_where_locked_contacts_hold_more_than_wheels_push() -> None:
    places = np.array([[0.0, 0.2], [0.0, -0.2], [-0.2, 0.0]])
    speeds = np.array([[0.2, 0.0], [0.2, 0.0], [0.0, 0.0]])

    found = solve_coulomb_motion(contacts(places, speeds, np.array([1.0, 1.0, 5.0])))

    assert found.twist == pytest.approx((0.0, 0.0, 0.0), abs=1e-5)


def test_motion_is_rest_where_each_speed_between_two_pulls_costs_the_same() -> None:
    speeds = np.array([[1.0, 0.0], [-2.0, 0.0]])

    found = solve_coulomb_motion(contacts(np.zeros((2, 2)), speeds, np.ones(2)))

    assert found.twist == (0.0, 0.0, 0.0)
    assert found.power_w == pytest.approx(3.0)


def test_motion_without_contacts_is_rest() -> None:
    none = SlipTerms(np.zeros((0, 2, 3)), np.zeros((0, 2)), np.zeros(0), np.zeros(3))

    assert solve_coulomb_motion(none).twist == (0.0, 0.0, 0.0)


@given(seed=st.integers(0, 10**6), count=st.integers(2, 7))
def test_power_is_the_least_that_a_search_finds(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    terms = contacts(
        random.uniform(-0.5, 0.5, (count, 2)),
        random.uniform(-0.3, 0.3, (count, 2)),
        random.uniform(0.1, 30.0, count),
    )

    found = solve_coulomb_motion(terms)

    searched = least_power_by_search(terms, seed)
    slack = 1e-4 if found.is_converged else 1e-3
    assert found.power_w <= searched + slack * terms.scales.sum()
    assert math.isclose(found.power_w, power(terms, np.array(found.twist)), rel_tol=1e-9)
