"""Moments of inertia that a body can have: the nearest to impossible ones, and a least share."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.sim_server.description.model_geometry import find_extents

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Inertial, Link
    from zensim.sim_server.description.model_geometry import FindCorners

FloatArray = npt.NDArray[np.float64]
Moments = tuple[float, float, float, float, float, float]
"""(ixx, ixy, ixz, iyy, iyz, izz) [kg m^2]."""
LEAST_SHARE = 0.25
"""Least moment of a loose body, and of a link without any, over that of a solid box around its
collisions.

That of a uniform ball is 0.6, of a cylinder 0.75. Below 0.25, PyBullet's 20 iterations let a body
creep and sink.
"""
SPREADS: FloatArray = np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
"""Principal moments of a body whose mass is spread along x, y or z only: those of all bodies are
sums of these."""


def find_nearest_moments(inertia: Moments) -> Moments:
    """Find the moments that a body can have next to some (least squares of the matrix).

    A body's principal moments are sums of `SPREADS`, which keeps the triangle inequality.
    """
    moments, axes = np.linalg.eigh(to_inertia_matrix(inertia))
    return from_inertia_matrix(axes @ np.diag(_project(moments)) @ axes.T)


def _project(moments: FloatArray) -> FloatArray:
    """Find the nearest sum of spreads, by trying each set of them."""
    best = np.zeros(3)
    for count in (1, 2, 3):
        for chosen in combinations(range(3), count):
            columns = SPREADS[:, chosen]
            shares = np.linalg.lstsq(columns, moments, rcond=None)[0]
            found = columns @ shares
            if (shares >= 0.0).all() and _distance(found, moments) < _distance(best, moments):
                best = found
    return best


def _distance(one: FloatArray, other: FloatArray) -> float:
    return float(np.linalg.norm(one - other))


def to_inertia_matrix(inertia: Moments) -> FloatArray:
    """Make the matrix (3, 3) of moments."""
    ixx, ixy, ixz, iyy, iyz, izz = inertia
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def from_inertia_matrix(matrix: FloatArray) -> Moments:
    """Read the moments of a matrix (3, 3)."""
    xx, xy, xz, _, yy, yz, _, _, zz = matrix.ravel().tolist()
    return (xx, xy, xz, yy, yz, zz)


def describe_moments(inertia: Moments) -> str:
    """Write the principal moments, ascending."""
    moments = np.linalg.eigvalsh(to_inertia_matrix(inertia)).tolist()
    return ", ".join(f"{moment:.3g}" for moment in moments)


def raise_light_moments(link: Link, corners: FindCorners) -> Inertial | None:
    """Find the inertia with which a body rests; None if its own will do.

    Args:
        link: It has collisions and a mass.
        corners: Finds the corners of meshes.
    """
    moments, axes = np.linalg.eigh(to_inertia_matrix(link.inertial.inertia))
    squares = np.array(find_extents(link, axes.T.tolist(), corners)) ** 2
    least = LEAST_SHARE * link.inertial.mass_kg * (squares.sum() - squares) / 12.0
    if (moments >= least).all():
        return None
    raised = axes @ np.diag(np.maximum(moments, least)) @ axes.T
    return msgspec.structs.replace(
        link.inertial, inertia=find_nearest_moments(from_inertia_matrix(raised))
    )
