"""Torques of bodies that precess."""

import numpy as np
import pytest

from zensim.sim_server.physics.free_spin import (
    can_precess,
    find_explicit_torques,
    find_implicit_torques,
    find_next_spins,
    find_spinning,
)

MOMENTS = np.array([[0.01, 0.02, 0.028], [0.01, 0.01, 0.018]])
SPINS = np.array([[2.0, 0.0, 20.0], [1.0, 0.5, -10.0]])
DT_S = 1.0 / 240.0


def test_next_spins_keep_momentum_and_energy() -> None:
    spins = SPINS
    for _ in range(2400):
        spins = find_next_spins(MOMENTS, spins, DT_S)

    before, after = MOMENTS * SPINS, MOMENTS * spins
    assert np.linalg.norm(after, axis=1) == pytest.approx(np.linalg.norm(before, axis=1), rel=0.02)
    assert (after * spins).sum(axis=1) == pytest.approx((before * SPINS).sum(axis=1), rel=1e-4)


def test_torques_lead_each_engine_to_the_next_spins() -> None:
    following = find_next_spins(MOMENTS, SPINS, DT_S)
    gyroscopic = np.cross(SPINS, MOMENTS * SPINS)

    explicit = find_explicit_torques(MOMENTS, SPINS, DT_S)
    implicit = find_implicit_torques(MOMENTS, SPINS, DT_S)

    assert SPINS + DT_S * (explicit - gyroscopic) / MOMENTS == pytest.approx(following)
    for moments, spin, torque, after in zip(MOMENTS, SPINS, implicit, following, strict=True):
        turned = [np.cross(axis, moments * spin) for axis in np.eye(3)]
        own = [np.cross(spin, moments * axis) for axis in np.eye(3)]
        derivative = np.transpose(np.array(turned) + np.array(own))
        change = np.linalg.solve(
            np.diag(moments) + DT_S * derivative, DT_S * (torque - np.cross(spin, moments * spin))
        )
        assert spin + change == pytest.approx(after)


def test_spin_about_a_principal_axis_needs_no_torque() -> None:
    spins = np.array([[0.0, 0.0, 30.0]])

    assert find_explicit_torques(MOMENTS[:1], spins, DT_S) == pytest.approx(0.0, abs=1e-9)


def test_balls_and_slow_bodies_are_left_alone() -> None:
    assert not can_precess((0.1, 0.1, 0.1))
    assert can_precess((0.1, 0.1, 0.2))
    assert find_spinning(np.array([[0.5, 0.5, 0.5], [2.0, 0.0, 0.0]]), DT_S).tolist() == [
        False,
        True,
    ]
