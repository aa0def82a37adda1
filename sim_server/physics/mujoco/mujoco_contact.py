"""Contact and friction as MuJoCo's solver parameters; correction of contact rows between solves."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Contact
from zensim.sim_server.physics.blueprint import MIN_DAMPING_STEPS, RigidPart
from zensim.sim_server.physics.engine import CONTACT_NUMBERS, FloatArray

RIGID_ERP = 0.2
"""Share of a penetration or error that a step corrects, where rigid."""
RIGID_IMPEDANCE = 0.99
"""d of rigid contacts: compliance is a hundredth of the unconstrained one."""
MIN_HARD_ERP = 0.05
"""Likewise, of a compliant contact that is as hard as a rigid one."""
MAX_IMPEDANCE = 0.9999
"""MuJoCo limits d to this and 1e-4."""
MIN_IMPEDANCE = 1e-4
STATIC_PRIORITY = -2_000_000_000
"""Of the ground and static models whose friction does not count."""
PRIORITIES_PER_FRICTION = 1e6
MAX_FRICTION = 2.0
"""Of a shape: a steeper cone turns the least slip into lift, and `LiftIteration` fails."""
MAX_PENETRATION_RECOVERY_MPS = 0.5
"""Limit of the speed that corrects a penetration."""
FRICTION_CONDIM = 3
"""Rows of a contact with friction: normal, and two tangents."""
TANGENTS = 2
MIN_LIFT_MPS = 1e-5
"""Lift that is corrected; at 240 Hz, it shifts 2 % of the load between rigid supports."""
LIFT_TOLERANCE_MPS = 3e-4
"""Difference of lift that does not need another solve."""
MIN_LIFT_CHANGE_MPS = 1e-9
"""Between two solves, to compute their feedback."""
MAX_FEEDBACK = 0.9
"""Limits the steps of the secant method."""

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


def find_rigid_impedance(inverse_mass: float, mass_kg: float) -> float:
    """Find the impedance of rigid contacts of a link.

    All contacts of a robot get the compliance that RIGID_IMPEDANCE means for its whole mass, so
    that supports share its weight equally. MuJoCo makes those of light links more compliant.

    Args:
        inverse_mass: Acceleration of the link per unit of force [1/kg].
        mass_kg: Of the robot.
    """
    compliance = (1.0 - RIGID_IMPEDANCE) / RIGID_IMPEDANCE / mass_kg
    return min(max(inverse_mass / (inverse_mass + compliance), RIGID_IMPEDANCE), MAX_IMPEDANCE)


def make_contact_parameters(
    contact: Contact, dt_s: float, inverse_mass: float, mass_kg: float
) -> SolverParameters:
    """Make the parameters of a contact: rigid, or compliant by ODE's formula.

    A compliant one is at least as compliant as a rigid one: with less, rounding decides which of
    four supports carry a robot.

    Args:
        contact: Without stiffness if rigid.
        dt_s: Length of a step.
        inverse_mass: Acceleration of the contact point per unit of force [1/kg].
        mass_kg: Of the robot.
    """
    rigid = find_rigid_impedance(inverse_mass, mass_kg)
    if not contact.stiffness:
        return make_rigid_parameters(dt_s, rigid)
    stiffness = contact.stiffness
    damping = max(contact.damping, MIN_DAMPING_STEPS * stiffness * dt_s)
    step_damping = dt_s * stiffness + damping
    impedance = 1.0 / (1.0 + 1.0 / (max(inverse_mass, 1e-12) * dt_s * step_damping))
    erp = dt_s * stiffness / step_damping
    if impedance > rigid:
        impedance, erp = rigid, max(erp, MIN_HARD_ERP)
    impedance = max(impedance, MIN_IMPEDANCE)
    return SolverParameters(-impedance * erp / dt_s**2, -impedance / dt_s, impedance)


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


class MjPlacedContacts(MjContacts, Protocol):
    """Arrays of `mujoco.MjData.contact`, with their places."""

    pos: FloatArray
    frame: FloatArray


def limit_penetration_recovery(
    wanted: FloatArray, contacts: MjContacts, parameters: FloatArray, dt_s: float
) -> None:
    """Limit the speed that corrects penetrations, before rows are solved.

    Args:
        wanted: Reference acceleration of each row; changed.
        contacts: In MuJoCo's order.
        parameters: (n, 4) stiffness, damping, impedance and its slope of each row.
        dt_s: Length of a step.
    """
    addresses, depths = contacts.efc_address, contacts.dist
    if depths.min() * RIGID_ERP < -MAX_PENETRATION_RECOVERY_MPS * dt_s:
        is_solved = addresses >= 0
        rows = addresses[is_solved]
        pushes = -parameters[rows, 0] * parameters[rows, 2] * depths[is_solved]
        wanted[rows] -= np.maximum(pushes - MAX_PENETRATION_RECOVERY_MPS / dt_s, 0.0)


@dataclass(frozen=True)
class FrictionRows:
    """Contacts with friction: their normal rows, and (n, 2) friction along the tangents.

    Two tangent rows follow each normal row.
    """

    normals: ContactInts
    friction: FloatArray

    def find_slips(self, velocities: FloatArray) -> FloatArray:
        """Find slip speeds (2, n) along the tangents, each times its friction [m/s].

        Args:
            velocities: Of each row.
        """
        slips = np.stack((velocities[self.normals + 1], velocities[self.normals + 2]))
        slips *= self.friction.T
        return slips

    def find_lifts(self, velocities: FloatArray) -> FloatArray:
        """Find the speed [m/s] at which convex friction lifts each contact; see `LiftIteration`."""
        slips = self.find_slips(velocities)
        lifts: FloatArray = np.sqrt(np.einsum("ij,ij->j", slips, slips))
        return lifts


def find_sliding_rows(contacts: MjContacts, velocities: FloatArray) -> FrictionRows | None:
    """Find the contacts that friction would lift; None = none, which is the usual case.

    Args:
        contacts: In MuJoCo's order.
        velocities: Of each row, predicted for the end of the step.
    """
    has_friction = (contacts.dim == FRICTION_CONDIM) & (contacts.efc_address >= 0)
    normals = contacts.efc_address[has_friction]
    squares = velocities[normals + 1] ** 2 + velocities[normals + 2] ** 2
    slips = squares > (MIN_LIFT_MPS / MAX_FRICTION) ** 2
    if not slips.any():
        return None
    rows = FrictionRows(normals[slips], contacts.friction[has_friction, :TANGENTS][slips])
    slides = rows.find_lifts(velocities) > MIN_LIFT_MPS
    return FrictionRows(rows.normals[slides], rows.friction[slides]) if slides.any() else None


def predict_lifts(rows: FrictionRows, now: FloatArray, predicted: FloatArray) -> FloatArray:
    """Predict the lift of each contact after a step; 0 where the slip comes to a stop.

    Args:
        rows: Contacts that slide.
        now: Velocity of each row.
        predicted: Likewise after the step, if accelerations stayed as they are.
    """
    slips, following = rows.find_slips(now), rows.find_slips(predicted)
    continues = np.einsum("ij,ij->j", slips, following) > 0.0
    return np.where(continues, np.hypot(*following), 0.0)


class LiftIteration:
    """Finds what to subtract from the normal rows of sliding contacts, by repeated solves.

    MuJoCo's friction cone couples a normal speed of friction times slip speed: a cube at 2 m/s hops
    by centimetres, and a dragged caster loses the load that it should brake by. That speed, of the
    slip after the step, is subtracted from the wish of the normal, which leaves Coulomb's law.
    The slip is known after a solve only. Source: De Saxce and Feng, the bipotential method, 1998.
    """

    def __init__(
        self, rows: FrictionRows, wanted: FloatArray, lifts: FloatArray, dt_s: float
    ) -> None:
        """Start with predicted lifts.

        Args:
            rows: Contacts that slide.
            wanted: Reference acceleration of each row.
            lifts: Predicted, of each contact.
            dt_s: Length of a step.
        """
        self._rows = rows
        self._wanted = wanted[rows.normals]
        self._lifts = lifts
        self._dt_s = dt_s
        self._last: tuple[FloatArray, FloatArray] | None = None

    def correct(self, wanted: FloatArray) -> None:
        """Write the corrected reference accelerations of the normals."""
        wanted[self._rows.normals] = self._wanted - self._lifts / self._dt_s

    def refine(self, velocities: FloatArray) -> bool:
        """Take the velocity of each row after a solve; return whether the lifts agree with it.

        Otherwise the lifts of the next solve are found, per contact, by the secant method.
        """
        found = self._rows.find_lifts(velocities)
        is_off = np.abs(found - self._lifts) > LIFT_TOLERANCE_MPS
        if not is_off.any():
            return True
        feedback = self._find_feedback(found)
        better = np.maximum((found - feedback * self._lifts) / (1.0 - feedback), 0.0)
        self._last = self._lifts, found
        self._lifts = np.where(is_off, better, self._lifts)
        return False

    def _find_feedback(self, found: FloatArray) -> FloatArray:
        """Find by how much the lift after a solve grows with the lift that was subtracted."""
        if self._last is None:
            return np.zeros_like(found)
        change = self._lifts - self._last[0]
        is_known = np.abs(change) > MIN_LIFT_CHANGE_MPS
        growth = (found - self._last[1]) / np.where(is_known, change, 1.0)
        return np.where(is_known, np.clip(growth, 0.0, MAX_FEEDBACK), 0.0)


def read_contact_points(contacts: MjPlacedContacts, row_forces: FloatArray) -> FloatArray:
    """Read all contacts as `ContactPoints.points`, seen from the second geometry of each.

    Args:
        contacts: Of the last step; the cone is elliptic.
        row_forces: Of all constraint rows [N].
    """
    count = len(contacts.dist)
    found = np.zeros((count, CONTACT_NUMBERS))
    frames = contacts.frame.reshape(count, 3, 3)
    found[:, :3], found[:, 3:6], found[:, 6] = contacts.pos, frames[:, 0], -contacts.dist
    first = contacts.efc_address
    for axis in range(FRICTION_CONDIM):
        has_row = (first >= 0) & (axis < contacts.dim)
        forces = row_forces[first[has_row] + axis]
        found[has_row, 7:] += forces[:, None] * frames[has_row, axis]
    return found
