"""Contact and friction in MuJoCo's solver parameters, and the correction of contact rows before each solve."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.blueprint import MIN_DAMPING_STEPS, RigidPart
from zensim.sim_server.physics.engine import FloatArray

RIGID_ERP = 0.2
"""Share of a depth or of an error that one step mends, where rigid."""
RIGID_IMPEDANCE = 0.99
"""d of what is rigid: what it yields is a hundredth of what it would without contact."""
MAX_IMPEDANCE = 0.9999
"""MuJoCo's own bounds on d are this and 1e-4."""
MIN_IMPEDANCE = 1e-4
STATIC_PRIORITY = -2_000_000_000
"""Of ground and static models that leave what touches them its own friction."""
PRIORITIES_PER_FRICTION = 1e6
MAX_FRICTION = 900.0
MAX_PENETRATION_RECOVERY_MPS = 0.5
"""Speed at which what is deep in another is pushed out, at most."""
FRICTION_CONDIM = 3
"""What MuJoCo solves of a contact with friction: its normal, and two ways across it."""

ContactInts = npt.NDArray[np.int32]


@dataclass(frozen=True)
class SolverParameters:
    """MuJoCo's `solref` (-k d, -b d) and the constant d of its `solimp`."""

    stiffness: float
    damping: float
    impedance: float


def make_rigid_parameters(dt_s: float, impedance: float = RIGID_IMPEDANCE) -> SolverParameters:
    """Yield as rigid contacts do."""
    return SolverParameters(-impedance * RIGID_ERP / dt_s**2, -impedance / dt_s, impedance)


def make_motor_parameters(dt_s: float) -> SolverParameters:
    """Reach a speed within a step, as far as the effort goes; place does not matter."""
    return SolverParameters(-1.0, -MAX_IMPEDANCE / dt_s, MAX_IMPEDANCE)


def make_soft_parameters(part: RigidPart, dt_s: float, lightness: float) -> SolverParameters:
    """Yield as ODE does.

    Args:
        part: What has a stiffness.
        dt_s: Length of a step.
        lightness: A [1/kg], what a unit of force accelerates its point by.
    """
    stiffness = part.contact.stiffness
    damping = max(part.contact.damping, MIN_DAMPING_STEPS * stiffness * dt_s)
    firm = dt_s * stiffness + damping
    impedance = 1.0 / (1.0 + 1.0 / (max(lightness, 1e-12) * dt_s * firm))
    impedance = min(max(impedance, MIN_IMPEDANCE), MAX_IMPEDANCE)
    return SolverParameters(-impedance * stiffness / (dt_s * firm), -impedance / dt_s, impedance)


@dataclass(frozen=True)
class GeomFriction:
    """Friction of a shape: of a pair, the one of higher rank counts, and that is the lesser."""

    friction: float
    priority: int

    @property
    def rows(self) -> int:
        """What MuJoCo solves of a contact."""
        return FRICTION_CONDIM if self.friction > 0.0 else 1


def find_geom_friction(part: RigidPart, *, is_static: bool) -> GeomFriction:
    """Find the grip of a part; MuJoCo has one friction for all ways, so two have their mean."""
    friction = part.friction
    if any(part.contact.direction):
        friction = (friction + part.contact.friction_across) / 2.0
    return make_geom_friction(friction, is_static=is_static, is_soft=part.contact.stiffness > 0.0)


def make_geom_friction(friction: float, *, is_static: bool, is_soft: bool = False) -> GeomFriction:
    """Rank a friction; of two alike, the soft one says how both yield."""
    if is_static and friction >= 1.0:
        return GeomFriction(1.0, STATIC_PRIORITY)
    bounded = min(friction, MAX_FRICTION)
    return GeomFriction(bounded, -2 * round(bounded * PRIORITIES_PER_FRICTION) + is_soft)


class MjContacts(Protocol):
    """What MuJoCo tells of contacts, each an entry."""

    dim: ContactInts
    efc_address: ContactInts
    dist: FloatArray
    friction: FloatArray


def correct_contact_rows(
    wanted: FloatArray, contacts: MjContacts, how: FloatArray, dt_s: float, weight: float
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
    if depths.min() * RIGID_ERP < -MAX_PENETRATION_RECOVERY_MPS * dt_s:
        is_solved = addresses >= 0
        rows = addresses[is_solved]
        pushes = -how[rows, 0] * how[rows, 2] * depths[is_solved]
        wanted[rows] -= np.maximum(pushes - MAX_PENETRATION_RECOVERY_MPS / dt_s, 0.0)
    grips = (contacts.dim == FRICTION_CONDIM) & (addresses >= 0)
    correct_sliding_rows(wanted, addresses[grips], contacts.friction[:, 0][grips], weight)


def correct_sliding_rows(
    wanted: FloatArray, rows: ContactInts, friction: FloatArray, weight: float
) -> None:
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
