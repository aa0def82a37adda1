"""Contact and friction as MuJoCo's solver parameters; correction of contact rows before a solve."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.sim_server.physics.blueprint import MIN_DAMPING_STEPS, RigidPart
from zensim.sim_server.physics.engine import FloatArray

RIGID_ERP = 0.2
"""Share of a penetration or error that a step corrects, where rigid."""
RIGID_IMPEDANCE = 0.99
"""d of rigid contacts: compliance is a hundredth of the unconstrained one."""
MAX_IMPEDANCE = 0.9999
"""MuJoCo limits d to this and 1e-4."""
MIN_IMPEDANCE = 1e-4
STATIC_PRIORITY = -2_000_000_000
"""Of the ground and static models whose friction does not count."""
PRIORITIES_PER_FRICTION = 1e6
MAX_FRICTION = 900.0
MAX_PENETRATION_RECOVERY_MPS = 0.5
"""Limit of the speed that corrects a penetration."""
FRICTION_CONDIM = 3
"""Rows of a contact with friction: normal, and two tangents."""

ContactInts = npt.NDArray[np.int32]


@dataclass(frozen=True)
class SolverParameters:
    """MuJoCo's `solref` (-k d, -b d) and the constant d of its `solimp`."""

    stiffness: float
    damping: float
    impedance: float


def make_rigid_parameters(dt_s: float, impedance: float = RIGID_IMPEDANCE) -> SolverParameters:
    """Make the parameters of rigid contacts."""
    return SolverParameters(-impedance * RIGID_ERP / dt_s**2, -impedance / dt_s, impedance)


def make_motor_parameters(dt_s: float) -> SolverParameters:
    """Make the parameters of motors: reach a speed within a step, position does not count."""
    return SolverParameters(-1.0, -MAX_IMPEDANCE / dt_s, MAX_IMPEDANCE)


def make_soft_parameters(part: RigidPart, dt_s: float, inverse_mass: float) -> SolverParameters:
    """Make the parameters of a compliant contact, by ODE's formula.

    Args:
        part: A part with a contact stiffness.
        dt_s: Length of a step.
        inverse_mass: Acceleration of the contact point per unit of force [1/kg].
    """
    stiffness = part.contact.stiffness
    damping = max(part.contact.damping, MIN_DAMPING_STEPS * stiffness * dt_s)
    step_damping = dt_s * stiffness + damping
    impedance = 1.0 / (1.0 + 1.0 / (max(inverse_mass, 1e-12) * dt_s * step_damping))
    impedance = min(max(impedance, MIN_IMPEDANCE), MAX_IMPEDANCE)
    return SolverParameters(
        -impedance * stiffness / (dt_s * step_damping), -impedance / dt_s, impedance
    )


@dataclass(frozen=True)
class GeomFriction:
    """Friction of a shape; of a pair, the higher priority counts, which has the lesser friction."""

    friction: float
    priority: int

    @property
    def rows(self) -> int:
        """Constraint rows of a contact."""
        return FRICTION_CONDIM if self.friction > 0.0 else 1


def find_geom_friction(part: RigidPart, *, is_static: bool) -> GeomFriction:
    """Find the friction of a part; the mean of two directions, as MuJoCo has one for both."""
    friction = part.friction
    if any(part.contact.direction):
        friction = (friction + part.contact.friction_across) / 2.0
    return make_geom_friction(friction, is_static=is_static, is_soft=part.contact.stiffness > 0.0)


def make_geom_friction(friction: float, *, is_static: bool, is_soft: bool = False) -> GeomFriction:
    """Make friction and priority; of equal frictions, the compliant one has priority."""
    if is_static and friction >= 1.0:
        return GeomFriction(1.0, STATIC_PRIORITY)
    bounded = min(friction, MAX_FRICTION)
    return GeomFriction(bounded, -2 * round(bounded * PRIORITIES_PER_FRICTION) + is_soft)


class MjContacts(Protocol):
    """Arrays of `mujoco.MjData.contact`."""

    dim: ContactInts
    efc_address: ContactInts
    dist: FloatArray
    friction: FloatArray


def correct_contact_rows(
    wanted: FloatArray, contacts: MjContacts, parameters: FloatArray, dt_s: float, weight: float
) -> None:
    """Limit penetration recovery and lift by friction, before rows are solved.

    Args:
        wanted: Reference acceleration of each row; changed.
        contacts: In MuJoCo's order.
        parameters: (n, 4) stiffness, damping, impedance and its slope of each row.
        dt_s: Length of a step.
        weight: Approximate contact force [N] per kg.
    """
    addresses, depths = contacts.efc_address, contacts.dist
    if depths.min() * RIGID_ERP < -MAX_PENETRATION_RECOVERY_MPS * dt_s:
        is_solved = addresses >= 0
        rows = addresses[is_solved]
        pushes = -parameters[rows, 0] * parameters[rows, 2] * depths[is_solved]
        wanted[rows] -= np.maximum(pushes - MAX_PENETRATION_RECOVERY_MPS / dt_s, 0.0)
    has_friction = (contacts.dim == FRICTION_CONDIM) & (addresses >= 0)
    correct_sliding_rows(
        wanted, addresses[has_friction], contacts.friction[:, 0][has_friction], weight
    )


def correct_sliding_rows(
    wanted: FloatArray, rows: ContactInts, friction: FloatArray, weight: float
) -> None:
    """Remove the lift that convex friction gives to sliding contacts.

    MuJoCo's friction cone couples a normal speed of friction times slip speed: at 2 m/s a cube
    hops by centimetres. The part of a slip that a step cannot stop is subtracted from the normal
    row, which leaves Coulomb's law. Source: De Saxce and Feng, the bipotential method, 1998.

    Args:
        wanted: Reference acceleration of each row; changed.
        rows: Of the normals of contacts with friction; two tangents follow each.
        friction: Of each of these contacts.
        weight: As in `correct_contact_rows`.
    """
    along, across = wanted[rows + 1], wanted[rows + 2]
    limit = weight * friction
    slides = along * along + across * across > limit * limit
    if slides.any():
        slips = np.hypot(along[slides], across[slides])
        wanted[rows[slides]] -= friction[slides] * (slips - limit[slides])
