"""Motion that Coulomb friction allows: the twist at which the friction of all contacts balances.

Without inertia the steady motion of a robot minimises the power that friction takes, the sum of
friction times load times slip over its contacts, for given speeds of its driven wheels. The sum is
convex; its few unknowns are the planar twist and the speeds of the wheels that turn freely.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

SMOOTHINGS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Slips [m/s] below which friction is taken as proportional, one after the other."""
MAX_STEPS = 40
"""Steps of each smoothing."""
TOLERANCE = 1e-6
"""Unbalanced part of the friction, relative to the largest."""
LEAST_GAIN = 1e-3
"""Share of the power of friction that a motion must save: what pulls less does not start a robot.

Wheels of weak motors that pull against each other save 2e-5 where meshes differ by rounding.
"""
LEAST_PULL = 1e-4
"""Unbalanced part of the friction that does not start a robot, relative to the largest."""


@dataclass(frozen=True)
class SlipTerms:
    """Slips of n contacts that are linear in m unknowns; the first three are vx, vy and wz.

    The power that friction takes is the sum of |rows x - offsets| over the contacts, plus the sum
    of `damping` x^2 / 2.

    Attributes:
        rows: (n, 2, m), scaled by friction times load.
        offsets: (n, 2), likewise.
        scales: (n,) friction times load [N].
        damping: (m,) viscous resistance.
    """

    rows: FloatArray
    offsets: FloatArray
    scales: FloatArray
    damping: FloatArray


@dataclass(frozen=True)
class CoulombMotion:
    """The unknowns of `SlipTerms` at least power.

    Attributes:
        unknowns: (m,).
        power_w: That friction takes.
        is_converged: Whether friction balances.
    """

    unknowns: FloatArray
    power_w: float
    is_converged: bool

    @property
    def twist(self) -> tuple[float, float, float]:
        """vx, vy [m/s] and wz [rad/s]."""
        vx, vy, wz = self.unknowns[:3].tolist()
        return vx, vy, wz


def solve_coulomb_motion(terms: SlipTerms) -> CoulombMotion:
    """Find the motion at which friction takes least power; at rest where nothing decides.

    Newton's method on smoothed slips, with reweighted least squares where that does not descend.
    """
    rows = terms.rows
    count = rows.shape[2]
    if not len(rows):
        return CoulombMotion(np.zeros(count), 0.0, is_converged=True)
    size = float(np.abs(rows).max()) or 1.0
    weak = np.eye(count) * size * 1e-9
    found = _Descent(np.zeros(count), 1.0, is_balanced=False)
    for smoothing in SMOOTHINGS:
        found = _descend(terms, found.x, (smoothing * terms.scales) ** 2, weak)
    x = found.x
    power, at_rest = _find_power(terms, x), _find_power(terms, np.zeros(count))
    is_settled = found.is_balanced or found.unbalanced <= LEAST_PULL
    if is_settled and at_rest <= power * (1.0 + LEAST_GAIN):
        # As where weak motors of both sides yield: each speed between their targets costs the same.
        return CoulombMotion(np.zeros(count), at_rest, is_converged=True)
    return CoulombMotion(x, power, found.is_balanced)


class _Descent(NamedTuple):
    """Unknowns of little power, and the part of the friction that they leave unbalanced."""

    x: FloatArray
    unbalanced: float
    """Unbalanced part, relative to the largest friction."""
    is_balanced: bool


def _find_power(terms: SlipTerms, x: FloatArray) -> float:
    slips = terms.rows @ x - terms.offsets
    return float(np.sqrt((slips**2).sum(axis=1)).sum() + terms.damping @ x**2 / 2.0)


def _descend(terms: SlipTerms, x: FloatArray, smooth: FloatArray, weak: FloatArray) -> _Descent:
    rows, damping = terms.rows, terms.damping
    flat = rows.reshape(-1, rows.shape[2])
    largest = max(float(np.abs(flat).max()), 1e-12)
    slips, lengths, power = _measure(terms, x, smooth)
    unbalanced = 1.0
    for _ in range(MAX_STEPS):
        pull = (slips / lengths[:, None]).reshape(-1) @ flat + damping * x
        unbalanced = float(np.abs(pull).max()) / largest
        if unbalanced <= TOLERANCE:
            return _Descent(x, unbalanced, is_balanced=True)
        spread = flat * np.repeat(1.0 / lengths, 2)[:, None]
        bound = flat.T @ spread + np.diag(damping) + weak
        along = np.einsum("ni,nim->nm", slips, rows) / lengths[:, None] ** 1.5
        for matrix, least in ((bound - along.T @ along, 0.25), (bound, 1e-3)):
            step, share = -np.linalg.solve(matrix, pull), 1.0
            found = _measure(terms, x + step, smooth)
            while found[2] >= power and share > least:
                share /= 2.0
                found = _measure(terms, x + share * step, smooth)
            if found[2] < power:
                break
        if found[2] >= power:
            return _Descent(x, unbalanced, is_balanced=unbalanced <= 1e3 * TOLERANCE)
        x = x + share * step
        slips, lengths, power = found
    return _Descent(x, unbalanced, is_balanced=False)


def _measure(
    terms: SlipTerms, x: FloatArray, smooth: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    slips = terms.rows @ x - terms.offsets
    lengths = np.sqrt((slips**2).sum(axis=1) + smooth)
    return slips, lengths, float(lengths.sum() + terms.damping @ x**2 / 2.0)
