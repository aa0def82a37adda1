"""Contact and friction as MuJoCo's solver parameters; correction of contacts and of their rows."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Contact
from zensim.sim_server.physics.blueprint import MIN_DAMPING_STEPS, RigidPart
from zensim.sim_server.physics.engine import (
    CONTACT_NUMBERS,
    MAX_PENETRATION_RECOVERY_MPS,
    FloatArray,
)
from zensim.sim_server.physics.mujoco.slot_layout import NO_INDEX, IndexArray

if TYPE_CHECKING:
    import mujoco

RIGID_ERP = 0.2
"""Share of a penetration or error that a step corrects, where rigid."""
RIGID_IMPEDANCE = 0.97
"""d of rigid contacts: they yield by 0.03 of what would move without them.

What shares a load in many ways shares it by this alone. With 0.99, an error of a lift below its
tolerance shifts most of the load of four wheels, and the correction of six and more diverges.
"""
MIN_HARD_ERP = 0.05
"""Least share that a step corrects of a compliant contact that is as hard as a rigid one."""
MAX_IMPEDANCE = 0.9999
"""Largest d: MuJoCo limits it to this and 1e-4."""
MIN_IMPEDANCE = 1e-4
STATIC_PRIORITY = -2_000_000_000
"""Priority of the ground and of static models whose friction does not count."""
PRIORITIES_PER_FRICTION = 1e6
MAX_FRICTION = 10.0
"""Friction of a shape: a steeper cone lifts at the least slip, and `LiftIteration` takes longer."""
MIN_FRICTION = 1e-5
"""MuJoCo's least friction along a tangent."""
MIN_FRICTION_RATIO = 1e-3
"""Least share of the greater friction: wheels of 3 and 1e-5 along two tangents ran away."""
MIN_LEVEL_AXIS = 0.1
"""Length on the plane of contact from which an axis of friction has an effect."""
MIN_REBOUND_MPS = 0.05
"""Least speed of an impact that rebounds: what rests is hit by gravity in each step."""
REBOUND_STIFFENING = 100.0
"""How much less than others the rows of an impact yield."""
FRICTION_CONDIM = 3
"""Rows of a contact with friction: normal, and two tangents."""
TANGENTS = 2
TANGENT_ROWS = np.array([[1], [2]], np.int32)
"""Rows of the tangents after that of the normal."""
MIN_LIFT_MPS = 1e-5
"""Lift that is corrected; at 240 Hz, it shifts 0.8 % of the load between rigid supports."""
STEEP_FRICTION = 2.0
MAX_CREEP_MPS = 2.5e-3
"""Slip of steeper contacts that stick: at 240 Hz, rigid friction yields so to twice the weight."""
LEAST_SLIP_SHARE = 0.7
"""Share of a slip along one tangent or both: below 1 / sqrt(2), so rounding changes nothing."""
LIFT_TOLERANCE_MPS = 3e-4
"""Difference of lift that does not need another solve."""
MIN_LIFT_CHANGE_MPS = 1e-9
"""Change between two solves from which their feedback is computed."""
MIN_FEEDBACK, MAX_FEEDBACK = -10.0, 0.9
"""Limits of the slope of the secant method. It is negative for a hinged link that leans on its
edge: limited to 0, the iteration would alternate between two lifts."""

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
    """Find the friction of a part; of two, the mean, which `FrictionAxes` replaces in contacts."""
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


class MjRows(Protocol):
    """Arrays of `mujoco.MjData.contact` about the rows of contacts."""

    @property
    def dim(self) -> ContactInts:
        """Dimensions (n,)."""

    @property
    def efc_address(self) -> ContactInts:
        """First rows (n,); -1 = none."""

    @property
    def friction(self) -> FloatArray:
        """(n, 5)."""


class MjContacts(MjRows, Protocol):
    """Arrays of `mujoco.MjData.contact`."""

    geom: ContactInts
    dist: FloatArray
    frame: FloatArray


class MjPlacedContacts(MjContacts, Protocol):
    """Arrays of `mujoco.MjData.contact`, with their places."""

    pos: FloatArray


@dataclass(frozen=True)
class FrictionAxes:
    """Geometries with two frictions: along an axis of their body, and across it.

    Attributes:
        rows: (geometries,) row of each below; NO_INDEX = one friction in all directions.
        bodies: (n,) body of each.
        axes: (n, 3) unit axis in the body.
        friction: (n, 2) along the axis and across it.
        limits: (geometries,) friction of each as the other of a pair; infinite if it has no effect.
    """

    rows: IndexArray
    bodies: IndexArray
    axes: FloatArray
    friction: FloatArray
    limits: FloatArray

    def turn_contacts(self, contacts: MjContacts, rotations: FloatArray) -> bool:
        """Turn the tangents of contacts along the axis; return whether there are such contacts.

        Args:
            contacts: Their frames and frictions are changed.
            rotations: (bodies, 9) matrices of the bodies in the world.
        """
        rows = self.rows[contacts.geom]
        found = np.flatnonzero((rows.max(axis=1) != NO_INDEX) & (contacts.dim == FRICTION_CONDIM))
        if not len(found):
            return False
        # Of two such geometries, the second counts by its mean.
        own = np.argmax(rows[found] != NO_INDEX, axis=1)
        row = rows[found, own]
        matrices = rotations[self.bodies[row]].reshape(-1, 3, 3)
        axes = np.einsum("nij,nj->ni", matrices, self.axes[row])
        is_turned = _turn_frames(contacts.frame, found, axes)
        found, row, other = found[is_turned], row[is_turned], 1 - own[is_turned]
        limits = self.limits[contacts.geom[found, other]]
        limited = np.minimum(self.friction[row], limits[:, None])
        least = np.maximum(MIN_FRICTION, MIN_FRICTION_RATIO * limited.max(axis=1, keepdims=True))
        contacts.friction[found, :TANGENTS] = np.maximum(limited, least)
        return bool(len(found))


def _turn_frames(frames: FloatArray, chosen: IndexArray, axes: FloatArray) -> npt.NDArray[np.bool_]:
    """Turn the tangents of chosen contacts along axes; return which are not normal to the plane."""
    normals = frames[chosen, :3]
    level = axes - np.einsum("ij,ij->i", axes, normals)[:, None] * normals
    lengths = np.sqrt(np.einsum("ij,ij->i", level, level))
    is_level = np.asarray(lengths > MIN_LEVEL_AXIS)
    along = level[is_level] / lengths[is_level, None]
    frames[chosen[is_level], 3:6] = along
    frames[chosen[is_level], 6:] = np.cross(normals[is_level], along)
    return is_level


def make_friction_axes(
    parts: Iterable[tuple[int, int, RigidPart]], frictions: FloatArray, priorities: ContactInts
) -> FrictionAxes | None:
    """Make the axes of a model; None if each geometry has one friction.

    Args:
        parts: Index of each geometry, of its body, and its part.
        frictions: (geometries,) of a pair of equals.
        priorities: (geometries,)
    """
    found = [one for one in parts if _has_two_frictions(one[2])]
    if not found:
        return None
    rows = np.full(len(frictions), NO_INDEX, np.intp)
    rows[[geometry for geometry, _, _ in found]] = np.arange(len(found))
    axes = np.array([part.contact.direction for _, _, part in found])
    pairs = [(part.friction, part.contact.friction_across) for _, _, part in found]
    return FrictionAxes(
        rows,
        np.array([body for _, body, _ in found], np.intp),
        axes / np.linalg.norm(axes, axis=1)[:, None],
        np.minimum(pairs, MAX_FRICTION),
        np.where(priorities == STATIC_PRIORITY, np.inf, frictions),
    )


def _has_two_frictions(part: RigidPart) -> bool:
    return any(part.contact.direction) and max(part.friction, part.contact.friction_across) > 0.0


@dataclass(frozen=True)
class Rebounds:
    """Coefficients of restitution of geometries; of a pair, the lesser counts.

    Attributes:
        coefficients: (geometries,) infinite where that of the other counts.
        thresholds: (geometries,) speeds [m/s] up to which nothing rebounds.
        dt_s: Length of a step.
    """

    coefficients: FloatArray
    thresholds: FloatArray
    dt_s: float

    def apply(self, data: "mujoco.MjData") -> None:
        """Let impacts rebound, before rows are solved.

        MuJoCo has no coefficient: the wish of a normal becomes the acceleration that reverses its
        speed within the step, and what `limit_penetration_recovery` will take from it. Its rows do
        not yield: corners that hit together, or beside the middle, yield otherwise than one alone.
        """
        contacts, rows = data.contact, data.efc_KBIP
        pairs = self.coefficients[contacts.geom].min(axis=1)
        found = np.flatnonzero((pairs > 0.0) & (contacts.efc_address >= 0))
        normals = contacts.efc_address[found]
        speeds = -data.efc_vel[normals]
        least = np.maximum(self.thresholds[contacts.geom[found]].min(axis=1), MIN_REBOUND_MPS)
        hits = speeds > least
        normals, found = normals[hits], found[hits]
        if not len(found):
            return
        data.efc_aref[normals] = (1.0 + pairs[found]) * speeds[hits] / self.dt_s
        data.efc_aref[normals] += _find_excess_pushes(
            contacts.dist[found], rows[normals], self.dt_s
        )
        dims = contacts.dim[found]
        all_rows = np.repeat(normals - np.cumsum(dims) + dims, dims) + np.arange(dims.sum())
        _stiffen(data, all_rows)


def _stiffen(data: "mujoco.MjData", rows: IndexArray) -> None:
    """Let rows yield less, also in the copies that islands have."""
    data.efc_R[rows] /= REBOUND_STIFFENING
    data.efc_D[rows] *= REBOUND_STIFFENING
    if data.nisland:
        copies = data.map_efc2iefc[rows]
        data.iefc_R[copies] /= REBOUND_STIFFENING
        data.iefc_D[copies] *= REBOUND_STIFFENING


def make_rebounds(
    parts: Iterable[tuple[int, RigidPart]], is_fixed: npt.NDArray[np.bool_], dt_s: float
) -> Rebounds | None:
    """Make the rebounds of a model; None if nothing rebounds.

    Args:
        parts: Index of each geometry, and its part.
        is_fixed: (geometries,) whether it never moves.
        dt_s: Length of a step.
    """
    coefficients = np.where(is_fixed, np.inf, 0.0)
    thresholds = np.full(len(is_fixed), np.inf)
    for geometry, part in parts:
        if part.contact.restitution is not None:
            coefficients[geometry] = part.contact.restitution
            thresholds[geometry] = part.contact.bounce_threshold
    if not (coefficients[~is_fixed] > 0.0).any():
        return None
    return Rebounds(coefficients, thresholds, dt_s)


def is_deep(depths: FloatArray, dt_s: float) -> bool:
    """Whether the recovery of a penetration among some depths (n,) is limited."""
    return bool(depths.min(initial=0.0) * RIGID_ERP < -MAX_PENETRATION_RECOVERY_MPS * dt_s)


def may_slide(velocities: FloatArray, friction: float) -> bool:
    """Whether `find_sliding_rows` may find a contact.

    It reads a line of memory for each contact; rows lie side by side.

    Args:
        velocities: Of the rows of contacts, predicted for the end of the step.
        friction: Greatest of the model.
    """
    return bool(np.abs(velocities).max(initial=0.0) * friction > LEAST_SLIP_SHARE * MIN_LIFT_MPS)


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
    if is_deep(depths, dt_s):
        is_solved = addresses >= 0
        rows = addresses[is_solved]
        wanted[rows] -= _find_excess_pushes(depths[is_solved], parameters[rows], dt_s)


def _find_excess_pushes(depths: FloatArray, parameters: FloatArray, dt_s: float) -> FloatArray:
    """Find by how much the push out of each penetration is too large [m/s^2]."""
    pushes = -parameters[:, 0] * parameters[:, 2] * depths
    return np.asarray(np.maximum(pushes - MAX_PENETRATION_RECOVERY_MPS / dt_s, 0.0))


@dataclass(frozen=True)
class FrictionRows:
    """Contacts with friction: their normal rows, and (2, n) rows and friction of the tangents."""

    normals: ContactInts
    tangents: ContactInts
    friction: FloatArray

    def find_slips(self, velocities: FloatArray) -> FloatArray:
        """Find slip speeds (2, n) along the tangents, each times its friction [m/s].

        Args:
            velocities: Of each row.
        """
        return np.asarray(velocities[self.tangents] * self.friction)

    def find_lifts(self, velocities: FloatArray) -> FloatArray:
        """Find the speed [m/s] at which convex friction lifts each contact; see `LiftIteration`."""
        along, across = self.find_slips(velocities)
        # Not einsum: its bits depend on the number of contacts, which may be those of many worlds.
        lifts: FloatArray = np.sqrt(along * along + across * across)
        return lifts

    def take(self, chosen: npt.NDArray[np.bool_]) -> "FrictionRows":
        """Select some contacts."""
        return FrictionRows(
            self.normals[chosen], self.tangents[:, chosen], self.friction[:, chosen]
        )


def find_sliding_rows(contacts: MjRows, velocities: FloatArray) -> FrictionRows | None:
    """Find the contacts that friction would lift; None = none.

    Args:
        contacts: In MuJoCo's order; of one world, or of several one after another.
        velocities: Of each row, predicted for the end of the step.
    """
    addresses = contacts.efc_address
    has_friction = (contacts.dim == FRICTION_CONDIM) & (addresses >= 0)
    normals = addresses[has_friction]
    tangents = normals + TANGENT_ROWS
    if not len(normals):
        return None
    rows = FrictionRows(normals, tangents, contacts.friction[has_friction, :TANGENTS].T)
    # Of a steep cone, the lift of a creep would take most of the load.
    steep = np.minimum(*rows.friction)
    least: float | FloatArray = MIN_LIFT_MPS
    if steep.max() > STEEP_FRICTION:
        least = np.where(steep > STEEP_FRICTION, MAX_CREEP_MPS * steep, MIN_LIFT_MPS)
    slides = rows.find_lifts(velocities) > least
    count = np.count_nonzero(slides)
    if count == len(slides):
        return rows
    return rows.take(slides) if count else None


def predict_lifts(rows: FrictionRows, now: FloatArray, predicted: FloatArray) -> FloatArray:
    """Predict the lift of each contact after a step; 0 where the slip comes to a stop.

    Args:
        rows: Contacts that slide.
        now: Velocity of each row.
        predicted: Likewise after the step, if accelerations stayed as they are.
    """
    slips, following = rows.find_slips(now), rows.find_slips(predicted)
    continues = slips[0] * following[0] + slips[1] * following[1] > 0.0
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

    def refine(self, velocities: FloatArray) -> npt.NDArray[np.bool_]:
        """Take the velocity of each row after a solve; find which lifts do not agree with it.

        Those of the next solve are found by the secant method.
        """
        found = self._rows.find_lifts(velocities)
        is_off: npt.NDArray[np.bool_] = np.abs(found - self._lifts) > LIFT_TOLERANCE_MPS
        feedback = self._find_feedback(found)
        better = np.maximum((found - feedback * self._lifts) / (1.0 - feedback), 0.0)
        self._last = self._lifts, found
        self._lifts = np.where(is_off, better, self._lifts)
        return is_off

    def keep(self, chosen: npt.NDArray[np.bool_]) -> None:
        """Go on with some contacts."""
        self._rows, self._wanted = self._rows.take(chosen), self._wanted[chosen]
        self._lifts = self._lifts[chosen]
        if self._last is not None:
            self._last = self._last[0][chosen], self._last[1][chosen]

    def _find_feedback(self, found: FloatArray) -> FloatArray:
        """Find by how much the lift after a solve grows with the lift that was subtracted."""
        if self._last is None:
            return np.zeros_like(found)
        change = self._lifts - self._last[0]
        is_known = np.abs(change) > MIN_LIFT_CHANGE_MPS
        growth = (found - self._last[1]) / np.where(is_known, change, 1.0)
        return np.where(is_known, np.clip(growth, MIN_FEEDBACK, MAX_FEEDBACK), 0.0)


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
