"""How shapes touch, in the numbers that MuJoCo takes: Bullet's rigid contact, ODE's soft one.

MuJoCo solves a + R f = -b v - k r for each row, with R = (1 - d) / d A, where A is about what the
row gains by a unit of force. ODE's formula, which Bullet has too, says R = 1 / (h (h kp + kd)),
b = 1 / h and k = erp / h^2 with erp = h kp / (h kp + kd).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.blueprint import Part
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.touch import SOFTEST_STEPS

MENDED = 0.2
"""Share of a depth or of an error that one step mends, where rigid."""
RIGID = 0.99
"""d of what is rigid: what it yields is a hundredth of what it would without contact."""
STIFFEST = 0.9999
"""MuJoCo's own bounds on d are this and 1e-4."""
SOFTEST = 1e-4
PLAIN_RANK = -2_000_000_000
"""Of ground and static models that leave what touches them its own friction."""
RANKS_PER_FRICTION = 1e6
MOST_FRICTION = 900.0
FASTEST_OUT_MPS = 0.5
"""Speed at which what is deep in another is pushed out, at most."""
GRIPPING_ROWS = 3
"""What MuJoCo solves of a contact with friction: its normal, and two ways across it."""

Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Yield:
    """MuJoCo's `solref` (-k d, -b d) and the constant d of its `solimp`."""

    stiffness: float
    damping: float
    impedance: float


def rigid(dt_s: float, impedance: float = RIGID) -> Yield:
    """Yield as rigid contacts do."""
    return Yield(-impedance * MENDED / dt_s**2, -impedance / dt_s, impedance)


def motor(dt_s: float) -> Yield:
    """Reach a speed within a step, as far as the effort goes; place does not matter."""
    return Yield(-1.0, -STIFFEST / dt_s, STIFFEST)


def soft(part: Part, dt_s: float, lightness: float) -> Yield:
    """Yield as ODE does.

    Args:
        part: What has a stiffness.
        dt_s: Length of a step.
        lightness: A [1/kg], what a unit of force accelerates its point by.
    """
    stiffness = part.contact.stiffness
    damping = max(part.contact.damping, SOFTEST_STEPS * stiffness * dt_s)
    firm = dt_s * stiffness + damping
    impedance = 1.0 / (1.0 + 1.0 / (max(lightness, 1e-12) * dt_s * firm))
    impedance = min(max(impedance, SOFTEST), STIFFEST)
    return Yield(-impedance * stiffness / (dt_s * firm), -impedance / dt_s, impedance)


@dataclass(frozen=True)
class Grip:
    """Friction of a shape: of a pair, the one of higher rank counts, and that is the lesser."""

    friction: float
    rank: int

    @property
    def rows(self) -> int:
        """What MuJoCo solves of a contact."""
        return GRIPPING_ROWS if self.friction > 0.0 else 1


def grip_of(part: Part, *, is_static: bool) -> Grip:
    """Find the grip of a part; MuJoCo has one friction for all ways, so two have their mean."""
    friction = part.friction
    if any(part.contact.direction):
        friction = (friction + part.contact.friction_across) / 2.0
    return grip(friction, is_static=is_static, is_soft=part.contact.stiffness > 0.0)


def grip(friction: float, *, is_static: bool, is_soft: bool = False) -> Grip:
    """Rank a friction; of two alike, the soft one says how both yield."""
    if is_static and friction >= 1.0:
        return Grip(1.0, PLAIN_RANK)
    bounded = min(friction, MOST_FRICTION)
    return Grip(bounded, -2 * round(bounded * RANKS_PER_FRICTION) + is_soft)


class Contacts(Protocol):
    """What MuJoCo tells of contacts, each an entry."""

    dim: Ints
    efc_address: Ints
    dist: FloatArray
    friction: FloatArray


def correct(
    wanted: FloatArray, contacts: Contacts, how: FloatArray, dt_s: float, weight: float
) -> None:
    """Correct what the rows of contacts are to do, before they are solved; see below.

    Args:
        wanted: Acceleration that each row is to have; changed.
        contacts: In the order of MuJoCo's.
        how: (n, 4) stiffness, damping, impedance and its slope of each row.
        dt_s: Length of a step.
        weight: Force [N] on each kg that presses contacts together, about.
    """
    addresses, depths = contacts.efc_address, contacts.dist
    if depths.min() * MENDED < -FASTEST_OUT_MPS * dt_s:
        is_solved = addresses >= 0
        rows = addresses[is_solved]
        pushes = -how[rows, 0] * how[rows, 2] * depths[is_solved]
        wanted[rows] -= np.maximum(pushes - FASTEST_OUT_MPS / dt_s, 0.0)
    grips = (contacts.dim == GRIPPING_ROWS) & (addresses >= 0)
    sliding(wanted, addresses[grips], contacts.friction[:, 0][grips], weight)


def sliding(wanted: FloatArray, rows: Ints, friction: FloatArray, weight: float) -> None:
    """Keep what slides from being lifted, as friction does to it where it is a convex problem.

    Such friction wants the speed away from a contact to be as high as friction times the speed
    along it: at 2 m/s a cube hops by centimetres. What a step cannot stop of a slip is taken off
    the normal's wish, so that Coulomb's law is left. Source: De Saxce and Feng, the bipotential
    method, 1998.

    Args:
        wanted: Acceleration that each row is to have; changed.
        rows: Of the normals of contacts with friction; two ways follow each.
        friction: Of each of these contacts.
        weight: See `correct`.
    """
    along, across = wanted[rows + 1], wanted[rows + 2]
    stopped = weight * friction
    slides = along * along + across * across > stopped * stopped
    if slides.any():
        slips = np.hypot(along[slides], across[slides])
        wanted[rows[slides]] -= friction[slides] * (slips - stopped[slides])
