"""The Engine over MuJoCo. It and the proof of the engine alone import mujoco."""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from copy import copy, deepcopy
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple, Protocol

import mujoco
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.actuation import impose_planar_twists, make_actuation
from zensim.sim_server.physics.blueprint import BlueprintCache, check_mesh_files
from zensim.sim_server.physics.engine import (
    NO_CONTACTS,
    SUPPORT_NORMAL_Z,
    BodyStates,
    BoolArray,
    ContactPoints,
    Engine,
    EngineCapabilities,
    EngineRefused,
    EngineReplicas,
    FloatArray,
    Place,
    SteppedTogether,
    concatenate_contacts,
    make_unknown_efforts,
)
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.free_spin import can_precess, find_implicit_torques, find_spinning
from zensim.sim_server.physics.link_forces import LinkForce, make_link_forces
from zensim.sim_server.physics.mujoco.body_selection import (
    QPOS_POSE_ORDER,
    BodySelection,
    MujocoBody,
    StateGather,
    make_body_selection,
    make_state_gather,
)
from zensim.sim_server.physics.mujoco.compile_cache import CompileCache
from zensim.sim_server.physics.mujoco.convex_pieces import load_convex_pieces
from zensim.sim_server.physics.mujoco.mjcf import (
    MAX_PARTS,
    SUPPORTED_JOINT_KINDS,
    SUPPORTED_SHAPE_KINDS,
    ModelLayout,
    make_model_layout,
    write_mjcf,
)
from zensim.sim_server.physics.mujoco.mujoco_contact import (
    FrictionAxes,
    LiftIteration,
    Rebounds,
    find_sliding_rows,
    is_deep,
    limit_penetration_recovery,
    make_contact_parameters,
    make_friction_axes,
    make_rebounds,
    may_slide,
    predict_lifts,
    read_contact_points,
)
from zensim.sim_server.physics.mujoco.slot_layout import (
    NO_INDEX,
    Archetype,
    ArchetypeCache,
    IndexArray,
    SlotAddress,
    SlotAllocator,
    SlotCounts,
)
from zensim.sim_server.physics.mujoco.slot_state import (
    MAX_STATE_VALUE,
    POSITION_ERP,
    SLEEP_FLAG,
    ActuatorTargets,
    activate_motors,
    activate_slot,
    copy_slot_states,
    deactivate_all_slots,
    deactivate_slot,
    freeze_slot,
    is_within_limits,
    make_zero_targets,
    set_joint_motor,
    set_sleeping_trees,
)

OVERLAP_M = 0.001
"""Depth from which bodies overlap instead of touching."""
MAX_SPEED_CHANGE = 20.0
"""Change of a speed in a step [m/s or rad/s] above which the step is solved again."""
FALLBACK_SOLVER = int(mujoco.mjtSolver.mjSOL_CG), 1000
"""Solver and iterations of the second solve."""
MAX_SOLVES = 4
"""Solves of a step in which contacts slide."""
MAX_CACHED_SELECTIONS = 4096
MAX_ANNOUNCED_AT_ONCE = 32
"""Expected bodies whose archetypes are found between two steps."""
SLOT_ARRAYS = (
    *("body_pos", "body_quat", "body_gravcomp", "body_contype", "body_conaffinity"),
    *("geom_contype", "geom_conaffinity", "dof_frictionloss", "jnt_stiffness"),
)
"""Arrays of a model that differ between engines: see `MjModelArrays`."""
MAX_SPARES, MAX_SPARE_BYTES = 8, 1 << 22
"""A world that gets ten robots one by one grows through five sizes, which the next one uses."""
_NO_ARRAYS = dict.fromkeys(("_compiled", "_model", "_data", "_selections", "_solved_motors"))
NO_OWNERS = np.zeros(0, np.intp)
GROUP_SIZE = 16
"""Copies that are stepped together: few enough for the cache."""
JOINT_YIELD_SHARE = 0.3
"""Yield of joints with limits, over MuJoCo's least, at which long arms sag at 100 Hz."""
MAX_UNDAMPED_SPRING = 0.25
"""Stiffness of a spring times step squared over mass, up to which it may oscillate undamped."""


class MjBodyMotions(Protocol):
    """Arrays of `mujoco.MjData` about the motion of bodies."""

    cvel: FloatArray
    xipos: FloatArray
    ximat: FloatArray
    subtree_com: FloatArray
    xfrc_applied: FloatArray


@dataclass(frozen=True)
class LinkForceArrays:
    """`LinkForce` as arrays, by the index (n,) of MuJoCo's bodies."""

    bodies: IndexArray
    gravity_forces: FloatArray
    arms: FloatArray
    linear_dampings: FloatArray
    angular_dampings: FloatArray

    def __len__(self) -> int:
        """Number of links with forces."""
        return len(self.bodies)

    def apply(self, data: MjBodyMotions, roots: npt.NDArray[np.int32]) -> None:
        """Add the forces of the next step; `roots` (bodies,) is the root of each body."""
        bodies = self.bodies
        spins = data.cvel[bodies, :3]
        # MuJoCo's velocities refer to the centre of mass of the whole robot.
        arms = data.xipos[bodies] - data.subtree_com[roots[bodies]]
        linear = data.cvel[bodies, 3:] + np.cross(spins, arms)
        rotations = data.ximat[bodies].reshape(-1, 3, 3)
        data.xfrc_applied[bodies] += self.wrenches(rotations, linear, spins)

    def wrenches(
        self, rotations: FloatArray, linear: FloatArray, angular: FloatArray
    ) -> FloatArray:
        """Find forces and torques (n, 6) at the centres of mass, in the world.

        Args:
            rotations: (n, 3, 3) of the principal axes in the world.
            linear: (n, 3) of the centres of mass.
            angular: (n, 3).
        """
        arms = np.einsum("nij,nj->ni", rotations, self.arms)
        spins = np.einsum("nji,nj->ni", rotations, angular)
        damping = np.einsum("nij,nj->ni", rotations, self.angular_dampings * spins)
        forces = self.gravity_forces - self.linear_dampings[:, None] * linear
        return np.concatenate([forces, np.cross(arms, self.gravity_forces) - damping], axis=1)


def make_link_force_arrays(loads: Iterable[tuple[int, LinkForce]]) -> LinkForceArrays:
    """Make arrays of link forces, each with the index of its body."""
    found = list(loads)
    return LinkForceArrays(
        np.array([body for body, _ in found], np.intp),
        np.array([load.gravity_force for _, load in found]).reshape(-1, 3),
        np.array([load.arm for _, load in found]).reshape(-1, 3),
        np.array([load.linear_damping for _, load in found]),
        np.array([load.angular_damping for _, load in found]).reshape(-1, 3),
    )


@dataclass(frozen=True)
class SpinningBodies:
    """Loose bodies that can precess.

    Attributes:
        bodies: (n,) their indexes.
        moments: (n, 3) principal.
    """

    bodies: IndexArray
    moments: FloatArray

    def apply_torques(self, data: MjBodyMotions, dt_s: float) -> bool:
        """Add the torques of the next step; return whether there are any."""
        velocities = data.cvel[self.bodies, :3]
        found = np.flatnonzero(find_spinning(velocities, dt_s))
        if not len(found):
            return False
        bodies = self.bodies[found]
        rotations = data.ximat[bodies].reshape(-1, 3, 3)
        spins = _rotate_each(rotations.transpose(0, 2, 1), velocities[found])
        torques = find_implicit_torques(self.moments[found], spins, dt_s)
        data.xfrc_applied[bodies, 3:] += _rotate_each(rotations, torques)
        return True


def _rotate_each(rotations: FloatArray, vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T[:, :, None]
    return np.asarray(rotations[:, :, 0] * x + rotations[:, :, 1] * y + rotations[:, :, 2] * z)


@dataclass(frozen=True)
class StepInputs:
    """Indexes of all that a step has to set.

    Attributes:
        motors: Indexes in qvel of degrees of freedom with friction, in the order of MuJoCo's rows.
        position_motors, position_qpos: Which of them hold an angle, and their indexes in qpos.
        pushed: Indexes in qvel of controlled joints that get an effort.
        twisted_roots: Roots with a planar twist.
        link_forces: Gravity compensation and damping.
        spinning: Loose bodies that can precess.
    """

    motors: IndexArray
    position_motors: IndexArray
    position_qpos: IndexArray
    pushed: IndexArray
    twisted_roots: StateGather
    link_forces: LinkForceArrays
    spinning: SpinningBodies

    def speeds(self, targets: ActuatorTargets, qpos: FloatArray, dt_s: float) -> FloatArray:
        """Find the target speed of each motor in this step; 0 for joints with friction only."""
        speeds = targets.speeds[self.motors]
        if len(self.position_motors):
            held = self.motors[self.position_motors]
            wanted = POSITION_ERP / dt_s * (targets.angles[held] - qpos[self.position_qpos])
            most = targets.velocities[held]
            if most.any():
                most[most == 0.0] = np.inf
                wanted = np.clip(wanted, -most, most)
            speeds[self.position_motors] = wanted
        return speeds

    def impose_twists(self, targets: ActuatorTargets, qpos: FloatArray, qvel: FloatArray) -> None:
        """Set the planar velocity of roots in `qvel`."""
        rows = self.twisted_roots.read_bases(
            np.empty((len(self.twisted_roots.free), 13)), qpos, qvel
        )
        indexes = self.twisted_roots.twists
        twists = targets.twists[indexes[:, :3]]
        arms = np.zeros((len(rows), 3))
        velocities = impose_planar_twists(rows[:, 7:], rows[:, 3:7], arms, twists)
        qvel[indexes[:, :3]] = velocities[:, :3]
        qvel[indexes[:, 3:]] = rotate(conjugate(rows[:, 3:7]), velocities[:, 3:])


def make_step_inputs(
    bodies: Iterable[MujocoBody],
    targets: ActuatorTargets,
    friction: FloatArray,
    qpos_indexes: IndexArray,
) -> StepInputs:
    """Collect the inputs of the active bodies.

    Args:
        bodies: Active bodies.
        targets: Of all degrees of freedom.
        friction: Of each degree of freedom.
        qpos_indexes: Index in qpos of the joint of each degree of freedom.
    """
    bodies = list(bodies)
    motors = np.flatnonzero(friction > 0.0)
    position_motors = np.flatnonzero(targets.is_position[motors])
    free = [body.address for body in bodies if body.address.is_free]
    return StepInputs(
        motors,
        position_motors,
        qpos_indexes[motors[position_motors]],
        np.flatnonzero(targets.kinds == JointTargetKind.EFFORT),
        make_state_gather(
            [address for address in free if targets.is_twist_imposed[address.start.velocities]]
        ),
        make_link_force_arrays(
            (body.address.start.bodies + body.address.layout.bodies[load.part + 1], load)
            for body in bodies
            for load in body.loads
        ),
        _find_spinning_bodies(bodies),
    )


def _find_spinning_bodies(bodies: Iterable[MujocoBody]) -> SpinningBodies:
    found = []
    for body in bodies:
        parts = body.archetype.link_parts
        moments = parts[0].moments
        if body.address.is_free and len(parts) == 1 and can_precess(moments):
            found.append((body.address.start.bodies, moments))
    return SpinningBodies(
        np.array([index for index, _ in found], np.intp),
        np.array([moments for _, moments in found]).reshape(-1, 3),
    )


def find_near_geometries(centres: FloatArray, radii: FloatArray, own: IndexArray) -> IndexArray:
    """Find the geometries whose bounding spheres meet the sphere around some of them.

    Args:
        centres: (n, 3) of all bounding spheres.
        radii: (n,) likewise.
        own: Indexes of the geometries to enclose; part of the result.
    """
    if not len(own):
        return own
    middle = centres[own].mean(axis=0)
    reach = float((np.linalg.norm(centres[own] - middle, axis=1) + radii[own]).max())
    offsets = centres - middle
    return np.flatnonzero(np.einsum("ij,ij->i", offsets, offsets) <= (radii + reach) ** 2)


# Warnings would go to the terminal and to a file in the working directory.
mujoco.set_mju_user_warning(lambda _: None)


def find_solved_dofs(
    change: FloatArray, islands: npt.NDArray[np.int32], trees: npt.NDArray[np.int32]
) -> npt.NDArray[np.bool_]:
    """Find the degrees of freedom that have nothing to do with those of too large a change.

    Args:
        change: (n,) of their speeds in a step.
        islands: (n,) of constraints that affect each other; -1 = unconstrained.
        trees: (n,) of links that joints connect.

    Returns:
        (n,) mask.
    """
    is_failed = ~(np.abs(change) <= MAX_SPEED_CHANGE)
    in_failed_island = np.isin(islands, np.unique(islands[is_failed & (islands >= 0)]))
    return ~(in_failed_island | np.isin(trees, np.unique(trees[is_failed])))


@dataclass(frozen=True)
class CompiledModel:
    """A compiled model; each engine uses a copy, in which slots may be inactive."""

    model: mujoco.MjModel
    layout: ModelLayout
    friction_axes: FrictionAxes | None
    rebounds: Rebounds | None

    @cached_property
    def most_friction(self) -> float:
        """Greatest friction of a geometry."""
        axes = self.friction_axes
        across = 0.0 if axes is None else float(axes.friction.max())
        return max(float(self.model.geom_friction[:, 0].max(initial=0.0)), across)

    @cached_property
    def idle(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The model and data of engines that are closed."""
        model = copy(self.model)
        return model, mujoco.MjData(model)


@dataclass(frozen=True)
class SavedState:
    """State of an engine, without what its compiled model has.

    Attributes:
        counts: Slots of the compiled model.
        numbers: `mjSTATE_INTEGRATION`.
        accelerations: Of the last step, by which the next one predicts slips.
        arrays: `SLOT_ARRAYS`.
    """

    counts: SlotCounts
    numbers: FloatArray
    accelerations: FloatArray
    arrays: tuple[FloatArray, ...]


class SpareArrays:
    """Models and data that engines have given up: to allocate new ones takes a millisecond."""

    def __init__(self) -> None:
        self._spares: list[tuple[CompiledModel, mujoco.MjModel, mujoco.MjData]] = []

    def give(self, compiled: CompiledModel, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Keep a model and data that are not used any more."""
        if data.nbuffer <= MAX_SPARE_BYTES:
            self._spares = [*self._spares[1 - MAX_SPARES :], (compiled, model, data)]

    def take(self, compiled: CompiledModel) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Find or make a model and data, as if new."""
        for place, (known, model, data) in enumerate(self._spares):
            if known is compiled:
                del self._spares[place]
                for name in SLOT_ARRAYS:
                    getattr(model, name)[:] = getattr(compiled.model, name)
                model.opt.enableflags = compiled.model.opt.enableflags
                mujoco.mj_resetData(model, data)
                return model, data
        model = copy(compiled.model)
        return model, mujoco.MjData(model)


_SPARES = SpareArrays()


class MujocoEngine(Engine):
    """MuJoCo with Newton's method, one MjData."""

    name = "mujoco"
    capabilities = EngineCapabilities(hides=True, sleeps="loose", copies=True)

    def __init__(self, config: EngineConfig) -> None:
        self._is_closed = False
        self._config = config
        self._dt_s = config.step_ns * 1e-9
        self._blueprints = BlueprintCache(
            self.name,
            max_parts=MAX_PARTS,
            joint_kinds=SUPPORTED_JOINT_KINDS,
            shape_kinds=SUPPORTED_SHAPE_KINDS,
            mesh_folder=config.mesh_folder,
        )
        self._bodies: dict[int, MujocoBody] = {}
        self._diverged: set[int] = set()
        self._hidden: dict[int, FloatArray] = {}
        self._archetypes, self._slots = ArchetypeCache(), SlotAllocator()
        self._announced: deque[Model] = deque()
        """Models of expected bodies, whose archetypes are not found yet."""
        self._asleep: set[int] = set()
        self._kept_contacts = NO_CONTACTS
        """Contacts of sleeping bodies, when they fell asleep."""
        self._is_sleep_changed = False
        """Whether MuJoCo does not know yet which bodies sleep, or where static ones are."""
        self._has_loads = False
        self._may_be_invalid = False
        """Whether a solve of this step changed a speed too much."""
        self._selections: dict[tuple[int, ...], BodySelection] = {}
        self._solved_motors: IndexArray | None = None
        """Motors of the last step, in the order of their rows; None before the first."""
        self._start_with(_COMPILE_CACHE.compile((), config))

    def __getstate__(self) -> dict[str, object]:
        """Take what determines the next steps; not contacts and forces of the last one."""
        return {**self.__dict__, **_NO_ARRAYS, "_saved": self._save()}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Restore the state; compiles the model unless this process has it."""
        self.__dict__.update(state)
        self._load(self.__dict__.pop("_saved"))

    def _save(self) -> "SavedState":
        model, data = self._model, self._data
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        numbers = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, numbers, kind)
        arrays = tuple(getattr(model, name).copy() for name in SLOT_ARRAYS)
        return SavedState(self._compiled.layout.slot_counts, numbers, data.qacc.copy(), arrays)

    def _load(self, saved: "SavedState") -> None:
        self._compiled = _COMPILE_CACHE.compile(saved.counts, self._config)
        self._model, self._data = _SPARES.take(self._compiled)
        for name, values in zip(SLOT_ARRAYS, saved.arrays, strict=True):
            getattr(self._model, name)[:] = values
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        mujoco.mj_setState(self._model, self._data, saved.numbers, kind)
        self._data.qacc[:] = saved.accelerations
        self._selections = {}
        self._is_sleep_changed = bool(self._asleep)
        self._solved_motors, self._is_changed = None, True

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`; compiles on a thread."""
        self._find_expected_archetypes(MAX_ANNOUNCED_AT_ONCE)
        if self._announced:
            return False
        try:
            counts = self._slots.with_one_more(self._find_archetype(model))
        except EngineRefused:
            return True
        return counts == self._slots.counts or _COMPILE_CACHE.is_ready(counts, self._config)

    def expect(
        self,
        models: Sequence[Model],
        places: Sequence[Place] = (),  # noqa: ARG002
    ) -> None:
        """See `Engine.expect`; a world is compiled once, not once for each of its models."""
        self._slots.forget_expected()
        self._announced = deque(models)

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        """See `Engine.insert`."""
        self._find_expected_archetypes(len(self._announced))
        archetype = self._find_archetype(model)
        compiled = self._compile_with_one_more(archetype, model.name)
        # Whatever may fail comes first: a slot must not be taken for a refused body.
        actuation = make_actuation(model)
        loads = make_link_forces(self._blueprints.find(model), self._config.gravity, self._dt_s)
        slot = self._slots.take(archetype, body)
        if compiled is not self._compiled:
            self._switch_model(compiled)
            if self._config.compiles_ahead and not self._slots.expects_more:
                counts = compiled.layout.slot_counts
                _COMPILE_CACHE.compile_ahead(counts, archetype, self._config)
        address = compiled.layout.address(archetype, slot)
        known = self._bodies[body] = MujocoBody(model, archetype, slot, address, actuation, loads)
        self._own_geometries(body, address)
        self._activate(known)
        zeros = np.zeros(len(model.joints))
        self.set_state(body, base, zeros, zeros)

    def discard(self, body: int) -> None:
        """See `Engine.discard`; frees the slot."""
        self.wake([body])
        removed = self._bodies.pop(body)
        self._diverged.discard(body)
        self._hidden.pop(body, None)
        self._deactivate(removed.address)
        self._owners[removed.address.geometries] = NO_INDEX
        self._slots.release(removed.archetype, removed.slot)
        self._selections.clear()

    def hide(self, body: int) -> None:
        """See `Engine.hide`."""
        self.wake([body])
        address = self._bodies[body].address
        self._hidden[body] = self._data.qpos[address.positions]
        freeze_slot(self._model, self._data, address)
        self._targets.clear(address.velocities)
        self._is_changed = True

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        for number in bodies:
            body = self._bodies[number]
            # Exactly: gravity compensation leaves a rounding drift.
            self._data.qpos[body.address.positions] = self._hidden.pop(number)
            self._data.qvel[body.address.velocities] = 0.0
            self._activate(body)

    def sleep(self, bodies: Sequence[int]) -> None:
        """See `Engine.sleep`; of bodies without joints. Static ones are never moved anyway."""
        falling = [body for body in bodies if self._bodies[body].address.is_free]
        if not falling:
            return
        kept = [self._kept_contacts, self.read_contacts(falling)]
        self._kept_contacts = concatenate_contacts(kept)
        for body in falling:
            velocities = self._bodies[body].address.velocities
            self._data.qvel[velocities] = self._data.qacc[velocities] = 0.0
        self._asleep.update(falling)
        self._is_sleep_changed = True

    def wake(self, bodies: Sequence[int]) -> None:
        """See `Engine.wake`; they move from the next step on."""
        if self._asleep.isdisjoint(bodies):
            return
        self._asleep.difference_update(bodies)
        kept = self._kept_contacts
        is_asleep = np.isin(kept.bodies[:, 0], list(self._asleep))
        self._kept_contacts = kept.select(np.flatnonzero(is_asleep))
        self._is_sleep_changed = True

    def find_contacts(self, body: int) -> Sequence[int]:
        """See `Engine.find_contacts`."""
        if not self._data.ncon:
            return ()
        owners = self._owners[self._data.contact.geom]
        touching = owners[(owners == body).any(axis=1)]
        return sorted(set(touching.ravel().tolist()) - {body, NO_INDEX})

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._slots = SlotAllocator()
        for body in self._bodies.values():
            self._slots.expect_one_more(body.archetype)
        for number, body in self._bodies.items():
            body.slot = self._slots.take(body.archetype, number)
        self._switch_model(_COMPILE_CACHE.compile(self._slots.counts, self._config))

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`."""
        model, data, owners = self._model, self._data, self._owners
        self._wake_in_mujoco()
        mujoco.mj_kinematics(model, data)
        own = self._bodies[body].address.geometries
        near = find_near_geometries(data.geom_xpos, model.geom_rbound, own)
        found: set[int] = set()
        for other in near[(owners[near] != NO_INDEX) & (owners[near] != body)].tolist():
            for geometry in own.tolist():
                if mujoco.mj_geomDistance(model, data, geometry, other, 1.0, None) < -OVERLAP_M:
                    found.add(int(owners[other]))
        return sorted(found - self._diverged)

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`; diverged bodies have NaN, or the finite values that were set."""
        chosen, data = self._selection(bodies), self._data
        base = chosen.read_bases(data.qpos, data.qvel)
        if self._diverged:
            for body in self._diverged.intersection(bodies):
                base[bodies.index(body)] = self._bodies[body].fixed_state
        return BodyStates(
            base,
            chosen.gather.gather_joints(data.qpos, chosen.gather.positions),
            chosen.gather.gather_joints(data.qvel, chosen.gather.velocities),
        )

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        """See `Engine.read_joint_efforts`; NaN before the first step with new slots."""
        gather, motors = self._selection(bodies).gather, self._solved_motors
        if motors is None:
            return make_unknown_efforts(gather.joint_count)
        data = self._data
        efforts = data.qfrc_spring.copy()
        efforts[motors] += data.efc_force[data.ne : data.ne + data.nf]
        if self._targets.efforts.any():
            efforts += self._targets.efforts
        return gather.gather_joints(efforts, gather.velocities)

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        """See `Engine.read_contacts`."""
        found = self._read_last_contacts(bodies)
        kept = self._kept_contacts
        if not len(kept):
            return found
        rows = np.flatnonzero(np.isin(kept.bodies[:, 0], list(bodies)))
        return concatenate_contacts([found, kept.select(rows)])

    def _read_last_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        data = self._data
        if not data.ncon:
            return NO_CONTACTS
        geometries = data.contact.geom
        is_watched = np.isin(self._owners[geometries], list(set(bodies) - self._asleep))
        if not is_watched.any():
            return NO_CONTACTS
        points = read_contact_points(data.contact, data.efc_force)
        is_touching = (points[:, 6] > 0.0) | points[:, 7:].any(axis=1)
        sides = np.stack([self._owners[geometries], self._links[geometries]], axis=2)
        found = []
        for own, other, towards in ((0, 1, -1.0), (1, 0, 1.0)):
            rows = np.flatnonzero(is_watched[:, own] & is_touching)
            numbers = points[rows]
            # Normals and forces are those on the second geometry.
            numbers[:, 3:6] *= towards
            numbers[:, 7:] *= towards
            pairs = np.concatenate([sides[rows, own], sides[rows, other]], axis=1)
            found.append(ContactPoints(pairs, numbers))
        return concatenate_contacts(found)

    def _own_geometries(self, number: int, address: SlotAddress) -> None:
        """Record to which body and links geometries belong."""
        geometries = address.geometries
        self._owners[geometries] = number
        bodies = self._model.geom_bodyid[geometries] - address.start.bodies
        self._links[geometries] = np.array(address.layout.order)[bodies]

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`."""
        self.wake([body])
        known = self._bodies[body]
        if known.archetype.is_static:
            self._set_static_pose(known, base)
            return
        if not is_within_limits(base):
            self._mark_diverged(body, base)
            return
        if body in self._diverged:
            self._diverged.discard(body)
            self._activate(known)
        qpos, qvel = known.address.start.positions, known.address.start.velocities
        self._data.qpos[qpos + QPOS_POSE_ORDER] = base[:7]
        self._data.qvel[qvel : qvel + 3] = base[7:10]
        self._data.qvel[qvel + 3 : qvel + 6] = rotate(conjugate(base[3:7]), base[10:])
        # The next step predicts slips by accelerations, which a new state does not have.
        self._data.qacc[known.address.velocities] = 0.0
        if body in self._hidden:
            self.hide(body)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        self.set_base_state(body, base)
        moving, qpos, qvel = self._bodies[body].address.joints
        if body not in self._diverged:
            self._data.qpos[qpos] = positions[moving]
            self._data.qvel[qvel] = velocities[moving]

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`."""
        zeros = np.zeros(len(self._bodies[body].model.joints))
        self.set_state(body, base, zeros if positions is None else positions, zeros)
        self.command([body], np.zeros(self._bodies[body].actuation.width))
        self._targets.is_twist_imposed[self._bodies[body].address.velocities] = False
        self._is_changed = True

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        if self._selection(bodies).scatter.apply(self._targets, targets):
            for body in bodies:
                self._set_joint_motors(body)
            self._is_changed = True

    def _set_joint_motors(self, number: int) -> None:
        """Set the motors of the controlled joints of an active body as their kinds say."""
        body = self._bodies[number]
        if not body.actuation.joint_motors or not self._is_active(number):
            return
        for motor in body.actuation.joint_motors:
            if (index := body.address.joint_velocity(motor.joint)) != NO_INDEX:
                friction = float(self._compiled.model.dof_frictionloss[index])
                set_joint_motor(self._model, self._targets, index, motor, friction)

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`."""
        address = self._bodies[body].address
        self._data.xfrc_applied[address.start.bodies + address.layout.bodies[link]] += wrench
        self._has_loads = True

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`."""
        if (index := self._bodies[body].address.joint_velocity(joint)) != NO_INDEX:
            self._data.qfrc_applied[index] += effort
            self._has_loads = True

    def step(self) -> bool:
        """See `Engine.step`; releases the interpreter's lock."""
        data, inputs = self._data, self.begin_step()
        self._may_be_invalid = False
        self._drive_motors(inputs)
        if data.ncon:
            self._solve_contacts()
        else:
            self._solve()
        if self._has_loads or len(inputs.link_forces):
            data.xfrc_applied[:] = 0.0
            data.qfrc_applied[:] = 0.0
            self._has_loads = False
        if self._may_be_invalid and not math.isfinite(data.qvel.sum()):
            self._find_diverged()
        return not self._diverged

    def begin_step(self) -> StepInputs:
        """Make the constraints of a step, and apply all but motors."""
        model, data = self._model, self._data
        if self._is_changed:
            self._update_step_inputs()
        inputs = self._step_inputs
        if len(inputs.twisted_roots.free):
            inputs.impose_twists(self._targets, data.qpos, data.qvel)
        self._make_constraints()
        self._solved_motors = inputs.motors
        if len(inputs.link_forces):
            inputs.link_forces.apply(data, model.body_rootid)
        if len(inputs.spinning.bodies):
            self._has_loads |= inputs.spinning.apply_torques(data, self._dt_s)
        return inputs

    def replicate(self, bodies: Sequence[int], count: int) -> EngineReplicas:
        """See `Engine.replicate`; the copies share one model, and no body of them sleeps."""
        if self._diverged or self._hidden:
            raise EngineRefused("an engine with diverged or hidden bodies cannot be copied")
        copied = deepcopy(self)
        copied.wake(sorted(self._asleep))
        return MujocoReplicas(vars(copied), self._save(), bodies, count)

    def close(self) -> None:
        """See `Engine.close`."""
        if self._is_closed:
            return
        self._is_closed = True
        _SPARES.give(self._compiled, self._model, self._data)
        self._bodies.clear()
        self._asleep.clear()
        compiled = _COMPILE_CACHE.compile((), self._config)
        self._start_with(compiled, compiled.idle)

    def _compile_with_one_more(self, archetype: Archetype, name: str) -> CompiledModel:
        counts = self._slots.with_one_more(archetype)
        if counts == self._slots.counts:
            return self._compiled
        try:
            return self._compile_without_expected(archetype, counts)
        except ValueError as error:
            raise EngineRefused(f"model '{name}': MuJoCo cannot compile it: {error}") from error

    def _compile_without_expected(self, archetype: Archetype, counts: SlotCounts) -> CompiledModel:
        """Compile; without slots for expected bodies if one of these is what cannot be compiled."""
        try:
            return _COMPILE_CACHE.compile(counts, self._config)
        except ValueError:
            self._slots.forget_expected()
            fewer = self._slots.with_one_more(archetype)
            if fewer == counts:
                raise
        return _COMPILE_CACHE.compile(fewer, self._config)

    def _find_expected_archetypes(self, count: int) -> None:
        """Find the archetypes of some expected bodies; `insert` refuses those that have none."""
        for _ in range(min(count, len(self._announced))):
            with suppress(EngineRefused):
                self._slots.expect_one_more(self._find_archetype(self._announced.popleft()))

    def _is_active(self, body: int) -> bool:
        return body not in self._diverged and body not in self._hidden

    def _find_archetype(self, model: Model) -> Archetype:
        blueprint = self._blueprints.find(model)
        archetype = self._archetypes.find(blueprint)
        if archetype not in self._compiled.layout.start:
            check_mesh_files(blueprint.name, blueprint.parts, self._config.mesh_folder)
        return archetype

    def _start_with(
        self,
        compiled: CompiledModel,
        arrays: tuple[mujoco.MjModel, mujoco.MjData] | None = None,
    ) -> None:
        """Use a model, all slots inactive; None = model and data of its own."""
        self._compiled = compiled
        self._model, self._data = _SPARES.take(compiled) if arrays is None else arrays
        self._targets = make_zero_targets(self._model.nv)
        self._owners = np.full(len(self._model.geom_contype), NO_INDEX, np.intp)
        self._links = np.zeros(len(self._owners), np.intp)
        self._is_changed = True
        self._solved_motors = None
        self._is_sleep_changed = bool(self._asleep)
        self._selections = {}
        deactivate_all_slots(self._model, self._data, compiled.layout)

    def _switch_model(self, compiled: CompiledModel) -> None:
        """Move all bodies, with their states, to a model that has other slots."""
        model, data, targets = self._model, self._data, self._targets
        old = [body.address for body in self._bodies.values()]
        self._start_with(compiled)
        for number, body in self._bodies.items():
            body.address = compiled.layout.address(body.archetype, body.slot)
            self._own_geometries(number, body.address)
            if self._is_active(number):
                self._activate(body)
        new = [body.address for body in self._bodies.values()]
        self._targets = copy_slot_states(
            (model, data, old), (self._model, self._data, new), (targets, self._model.nv)
        )
        for number in self._bodies:
            self._set_joint_motors(number)

    def _activate(self, body: MujocoBody) -> None:
        """Activate the slot and the motors of a body."""
        activate_slot(self._model, self._data, self._compiled.model, body.address)
        activate_motors(self._model, self._targets, body.address, body.actuation)
        self._is_changed = True

    def _deactivate(self, address: SlotAddress) -> None:
        """Deactivate a slot and clear its targets."""
        deactivate_slot(self._model, self._data, address)
        self._targets.clear(address.velocities)
        self._is_changed = True

    def _set_static_pose(self, body: MujocoBody, base: FloatArray) -> None:
        body.fixed_state = np.concatenate([base[:7], np.zeros(6)])
        if is_within_limits(base):
            root = body.address.start.bodies
            self._model.body_pos[root] = base[:3]
            self._model.body_quat[root] = base[[6, 3, 4, 5]]
            self._is_sleep_changed |= bool(self._asleep)

    def _mark_diverged(self, number: int, base: FloatArray) -> None:
        """Deactivate a body whose state MuJoCo cannot simulate."""
        body = self._bodies[number]
        body.fixed_state = np.where(np.abs(base) <= MAX_STATE_VALUE, base, np.nan)
        self._deactivate(body.address)
        self._diverged.add(number)

    def _find_diverged(self) -> None:
        for number, body in self._bodies.items():
            state = (
                self._data.qpos[body.address.positions],
                self._data.qvel[body.address.velocities],
            )
            if not np.isfinite(np.concatenate(state)).all():
                self._mark_diverged(number, np.full(13, np.nan))

    def _update_step_inputs(self) -> None:
        """Collect the inputs of a step again."""
        model = self._model
        self._is_changed = False
        self._step_inputs = make_step_inputs(
            (body for number, body in self._bodies.items() if self._is_active(number)),
            self._targets,
            model.dof_frictionloss,
            model.jnt_qposadr[model.dof_jntid].astype(np.intp),
        )

    def _wake_in_mujoco(self) -> None:
        """Let MuJoCo compute all places until the next step, which puts bodies to sleep again."""
        self._model.opt.enableflags &= ~SLEEP_FLAG
        self._is_sleep_changed = bool(self._asleep)

    def _update_sleep(self) -> None:
        """Put bodies to sleep in MuJoCo, and wake others.

        MuJoCo keeps the places of sleeping and static bodies, which must be computed first.
        """
        model, data = self._model, self._data
        self._wake_in_mujoco()
        if self._asleep:
            mujoco.mj_step1(model, data)
            roots = [self._bodies[body].address.start.bodies for body in sorted(self._asleep)]
            set_sleeping_trees(model, data, model.body_treeid[roots].astype(np.intp))
            model.opt.enableflags |= SLEEP_FLAG
        self._is_sleep_changed = False

    def _make_constraints(self) -> None:
        """Find the contacts and make the rows; again where a contact has two frictions.

        Impacts of what rebounds get their wish here.
        """
        if self._is_sleep_changed:
            self._update_sleep()
        model, data, axes = self._model, self._data, self._compiled.friction_axes
        mujoco.mj_step1(model, data)
        if axes is not None and data.ncon and axes.turn_contacts(data.contact, data.xmat):
            mujoco.mj_makeConstraint(model, data)
            mujoco.mj_island(model, data)
            mujoco.mj_referenceConstraint(model, data)
        if (rebounds := self._compiled.rebounds) is not None and data.ncon:
            rebounds.apply(data.efc_aref, data.efc_vel, data.contact, data.efc_KBIP)

    def _solve_contacts(self) -> None:
        """Solve and integrate; again while contacts slide otherwise than assumed."""
        model, data, dt_s = self._model, self._data, self._dt_s
        contacts, wanted, first = data.contact, data.efc_aref, data.ne + data.nf + data.nl
        # Of rows: contacts lie apart in memory, and most steps need none of them.
        if is_deep(data.efc_pos[first:], dt_s):
            limit_penetration_recovery(wanted, contacts, data.efc_KBIP, dt_s)
        # Predicted: friction stops what a step of a curve adds to the velocity of a wheel.
        velocities = np.empty(len(wanted))
        mujoco.mj_mulJacVec(model, data, velocities, data.qvel + dt_s * data.qacc)
        rows = None
        if may_slide(velocities[first:], self._compiled.most_friction):
            rows = find_sliding_rows(contacts, velocities)
        if rows is None:
            self._solve()
            return
        lifts = predict_lifts(rows, data.efc_vel, velocities)
        iteration = LiftIteration(rows, wanted, lifts, dt_s)
        for _ in range(MAX_SOLVES - 1):
            iteration.correct(wanted)
            start = self._solve()
            mujoco.mj_mulJacVec(model, data, velocities, data.qvel)
            if not iteration.refine(velocities).any():
                return
            data.qpos[:], data.qvel[:] = start
        iteration.correct(wanted)
        self._solve()

    def _solve(self) -> tuple[FloatArray, FloatArray]:
        """Solve and integrate; again by conjugate gradients where Newton's method failed.

        It rarely fails, with many contacts that contradict each other.

        Returns:
            qpos and qvel before.
        """
        model, data = self._model, self._data
        positions, velocities = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step2(model, data)
        change = data.qvel - velocities
        # False for NaN, so that small changes are finite, and speeds with them.
        most, least = change.max(initial=0.0), change.min(initial=0.0)
        if most <= MAX_SPEED_CHANGE and least >= -MAX_SPEED_CHANGE:
            return positions, velocities
        self._may_be_invalid = True
        self._solve_again((positions, velocities), change)
        return positions, velocities

    def _solve_again(self, start: tuple[FloatArray, FloatArray], change: FloatArray) -> None:
        """Solve by the second solver what changed its speed too much, from qpos and qvel."""
        model, data = self._model, self._data
        solved = data.qpos.copy(), data.qvel.copy(), data.qacc.copy()
        is_solved = find_solved_dofs(change, data.dof_island, model.dof_treeid)
        data.qpos[:], data.qvel[:] = start
        self._step_by_fallback()
        # The others keep their bits, as if this had not happened.
        for body in self._bodies.values():
            address = body.address
            if is_solved[address.velocities].all():
                data.qpos[address.positions] = solved[0][address.positions]
                data.qvel[address.velocities] = solved[1][address.velocities]
                data.qacc[address.velocities] = solved[2][address.velocities]

    def _step_by_fallback(self) -> None:
        options = self._model.opt
        solver = options.solver, options.iterations
        options.solver, options.iterations = FALLBACK_SOLVER
        mujoco.mj_step2(self._model, self._data)
        options.solver, options.iterations = solver

    def _drive_motors(self, inputs: StepInputs) -> None:
        """Apply the targets of motors to this step."""
        if len(inputs.motors):
            self._apply_motor_speeds()
        if len(inputs.pushed):
            self._data.qfrc_applied[inputs.pushed] += self._targets.efforts[inputs.pushed]
            self._has_loads = True

    def _apply_motor_speeds(self) -> None:
        """Set the target speed of each motor.

        A motor is a friction constraint whose reference speed is shifted from 0 here, between
        `mj_step1`, which makes the rows, and `mj_step2`, which solves them.
        """
        data = self._data
        speeds = self._step_inputs.speeds(self._targets, data.qpos, self._dt_s)
        speeds /= self._dt_s
        data.efc_aref[data.ne : data.ne + data.nf] += speeds

    def _selection(self, bodies: Sequence[int]) -> BodySelection:
        key = tuple(bodies)
        if (selection := self._selections.get(key)) is None:
            if len(self._selections) >= MAX_CACHED_SELECTIONS:
                self._selections.clear()
            selection = self._selections[key] = make_body_selection(
                [self._bodies[body] for body in bodies]
            )
        return selection


class ReplicatedEngine(MujocoEngine):
    """One of many equal engines: it has data and targets of its own and shares all else."""

    def __init__(
        self, shared: dict[str, Any], targets: ActuatorTargets, fallback: mujoco.MjModel
    ) -> None:
        """Make data; `restore` comes before the first step.

        Args:
            shared: Attributes of the engine that is copied, which has no sleeping bodies.
            targets: Of this one.
            fallback: The model with the second solver: another thread may step the first.
        """
        self.__dict__.update(shared)
        self._data = mujoco.MjData(self._model)
        self._targets = targets
        self._fallback = fallback
        self._diverged: set[int] = set()
        self._is_sleep_changed = False

    @property
    def data(self) -> mujoco.MjData:
        """State of this copy."""
        return self._data

    @property
    def is_diverged(self) -> bool:
        """Whether a body has diverged."""
        return bool(self._diverged)

    @property
    def model(self) -> mujoco.MjModel:
        """Model of all copies."""
        return self._model

    @property
    def dt_s(self) -> float:
        """Length of a step."""
        return self._dt_s

    def drive_motors(self) -> None:
        """See `MujocoEngine`."""
        self._drive_motors(self._step_inputs)

    def solve_again(self, start: tuple[FloatArray, FloatArray], change: FloatArray) -> None:
        """See `MujocoEngine`."""
        self._solve_again(start, change)

    def end_step(self, inputs: StepInputs, *, is_finite: bool) -> None:
        """Clear the loads of a step; note whether its state is finite."""
        if self._has_loads or len(inputs.link_forces):
            self._data.xfrc_applied[:] = 0.0
            self._data.qfrc_applied[:] = 0.0
            self._has_loads = False
        if not is_finite:
            self._find_diverged()

    def restore(self, saved: SavedState) -> None:
        """Load a state of the engine that is copied."""
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        mujoco.mj_setState(self._model, self._data, saved.numbers, kind)
        self._data.qacc[:] = saved.accelerations
        self._data.ncon = 0  # a state has no contacts; the next step finds them
        self._has_loads = True  # of the state that is copied
        self._diverged.clear()

    def note_new_modes(self) -> None:
        """Let the next step find which motors are on: their modes have changed."""
        for body in self._bodies:
            self._set_joint_motors(body)
        self._is_changed = True

    def list_touching(self) -> IndexArray:
        """List the bodies that touch another one, repeatedly; what carries them does not count."""
        data = self._data
        if not data.ncon:
            return NO_OWNERS
        owners = self._owners[data.contact.geom]
        is_pair = (owners[:, 0] != owners[:, 1]) & (owners != NO_INDEX).all(axis=1)
        pairs = np.flatnonzero(is_pair)
        if not len(pairs):
            return NO_OWNERS
        # A normal points to the second body: upward if the first one carries it.
        owners, upward = owners[pairs], data.contact.frame[pairs, 2]
        is_static = np.array(
            [[self._bodies[body].archetype.is_static for body in pair] for pair in owners.tolist()]
        )
        upward = np.stack([upward, -upward], axis=1)
        is_carried = (is_static & (upward > SUPPORT_NORMAL_Z)).any(axis=1)
        return np.asarray(owners[~is_carried].ravel())

    def _step_by_fallback(self) -> None:
        mujoco.mj_step2(self._fallback, self._data)

    def _find_diverged(self) -> None:
        """Note that a body diverged; its slot stays active, as it is that of all copies."""
        self._diverged.update(self._bodies)


class StackedContacts(NamedTuple):
    """Rows of the contacts of several worlds, one after another; see `MjRows`."""

    dim: npt.NDArray[np.int32]
    efc_address: npt.NDArray[np.int32]
    friction: FloatArray


class ReplicaGroup:
    """Copies that make their steps together, each with the bits of `MujocoEngine.step`.

    What is computed between two calls of MuJoCo is computed for all of them at once.
    """

    def __init__(self, engines: Sequence[ReplicatedEngine], speeds: FloatArray) -> None:
        """Prepare arrays.

        Args:
            engines: Of one model.
            speeds: (engines or more, degrees of freedom) their `ActuatorTargets.speeds`.
        """
        self._engines = engines
        self._all_speeds = speeds[: len(engines)]

    def step(self) -> bool:
        """See `SteppedTogether`."""
        live = [one for one, engine in enumerate(self._engines) if not engine.is_diverged]
        if not live:
            return False
        engines = [self._engines[one] for one in live]
        inputs = [engine.begin_step() for engine in engines]
        _drive_replicas(engines, inputs[0], self._all_speeds[live])
        solver = ReplicaSolver(engines)
        solver.solve_contacts()
        is_finite = np.isfinite(np.array([data.qvel.sum() for data in solver.states]))
        for engine, own, is_good in zip(engines, inputs, is_finite.tolist(), strict=True):
            engine.end_step(own, is_finite=is_good)
        return len(live) == len(self._engines) and bool(is_finite.all())


def _drive_replicas(
    engines: Sequence[ReplicatedEngine], inputs: StepInputs, speeds: FloatArray
) -> None:
    """Apply the targets of motors to the step of each engine; see `MujocoEngine`."""
    if len(inputs.position_motors) or len(inputs.pushed):
        for engine in engines:
            engine.drive_motors()
    elif len(inputs.motors):
        wanted = speeds[:, inputs.motors]
        wanted /= engines[0].dt_s
        for engine, row in zip(engines, wanted, strict=True):
            data = engine.data
            first = data.ne
            data.efc_aref[first : first + data.nf] += row


class ReplicaSolver:
    """Solves one step of several copies, as `MujocoEngine._solve_contacts` does of one.

    Attributes:
        states: Of the copies.
    """

    def __init__(self, engines: Sequence[ReplicatedEngine]) -> None:
        """Take the copies, whose constraints are made."""
        self._engines = engines
        self._model, self._dt_s = engines[0].model, engines[0].dt_s
        self.states = [engine.data for engine in engines]
        # qpos and qvel before, to start again.
        count = len(engines)
        self._positions = np.concatenate([data.qpos for data in self.states]).reshape(count, -1)
        self._velocities = np.concatenate([data.qvel for data in self.states]).reshape(count, -1)

    def solve_contacts(self) -> None:
        """Solve and integrate; again while contacts slide otherwise than assumed."""
        starts, wanted, velocities, contacts = self._read_rows()
        rows = find_sliding_rows(contacts, velocities) if len(contacts.dim) else None
        if rows is None:
            self._solve(range(len(self.states)))
            return
        owners = np.searchsorted(starts, rows.normals, side="right") - 1
        sliding = set(owners.tolist())
        self._solve([one for one in range(len(self.states)) if one not in sliding])
        now = np.concatenate([data.efc_vel for data in self.states])
        lifts = predict_lifts(rows, now, velocities)
        iteration = LiftIteration(rows, wanted, lifts, self._dt_s)
        for _ in range(MAX_SOLVES - 1):
            active = np.unique(owners).tolist()
            self._correct(iteration, wanted, starts, active)
            for one in active:
                own = velocities[starts[one] : starts[one + 1]]
                mujoco.mj_mulJacVec(self._model, self.states[one], own, self.states[one].qvel)
            is_open = np.isin(owners, owners[iteration.refine(velocities)])
            if not is_open.any():
                return
            iteration.keep(is_open)
            owners = owners[is_open]
            for one in np.unique(owners).tolist():
                self.states[one].qpos[:] = self._positions[one]
                self.states[one].qvel[:] = self._velocities[one]
        self._correct(iteration, wanted, starts, np.unique(owners).tolist())

    def _correct(
        self, iteration: LiftIteration, wanted: FloatArray, starts: IndexArray, active: list[int]
    ) -> None:
        iteration.correct(wanted)
        for one in active:
            self.states[one].efc_aref[:] = wanted[starts[one] : starts[one + 1]]
        self._solve(active)

    def _read_rows(self) -> tuple[IndexArray, FloatArray, FloatArray, StackedContacts]:
        """Read first rows (n + 1,), wished accelerations, predicted velocities, and contacts."""
        states, contacts = self.states, [data.contact for data in self.states]
        counts = [data.nefc for data in states]
        starts = np.concatenate([np.zeros(1, np.intp), np.cumsum(counts, dtype=np.intp)])
        depths = np.concatenate([contact.dist for contact in contacts])
        if len(depths) and is_deep(depths, self._dt_s):
            for data, contact in zip(states, contacts, strict=True):
                if len(contact.dist):
                    limit_penetration_recovery(data.efc_aref, contact, data.efc_KBIP, self._dt_s)
        accelerations = np.concatenate([data.qacc for data in states])
        predicted = self._velocities + self._dt_s * accelerations.reshape(len(states), -1)
        velocities = np.empty(starts[-1])
        # Predicted: friction stops what a step of a curve adds to the velocity of a wheel.
        for one, data in enumerate(states):
            own = velocities[starts[one] : starts[one + 1]]
            mujoco.mj_mulJacVec(self._model, data, own, predicted[one])
        addresses = [contact.efc_address for contact in contacts]
        offsets = np.repeat(starts[:-1], [len(own) for own in addresses])
        first = np.concatenate(addresses)
        stacked = StackedContacts(
            np.concatenate([contact.dim for contact in contacts]),
            np.where(first >= 0, first + offsets, first).astype(np.int32),
            np.concatenate([contact.friction for contact in contacts]),
        )
        return starts, np.concatenate([data.efc_aref for data in states]), velocities, stacked

    def _solve(self, chosen: Sequence[int]) -> None:
        """Solve and integrate some copies; see `MujocoEngine._solve`."""
        chosen = list(chosen)
        if not chosen:
            return
        for one in chosen:
            mujoco.mj_step2(self._model, self.states[one])
        after = np.concatenate([self.states[one].qvel for one in chosen])
        change = after.reshape(len(chosen), -1) - self._velocities[chosen]
        is_good = np.abs(change).max(axis=1) <= MAX_SPEED_CHANGE
        for row in np.flatnonzero(~is_good).tolist():
            one = chosen[row]
            start = self._positions[one], self._velocities[one]
            self._engines[one].solve_again(start, change[row])


class MujocoReplicas(EngineReplicas):
    """Many data of one model; states and targets of all are single arrays.

    Attributes:
        engines: The copies.
    """

    def __init__(
        self, shared: dict[str, Any], saved: SavedState, bodies: Sequence[int], count: int
    ) -> None:
        """Make the copies.

        Args:
            shared: Attributes of a copied engine, which nothing else uses.
            saved: Its state.
            bodies: See `Engine.replicate`.
            count: Likewise.
        """
        self._saved = saved
        model, targets = shared["_model"], shared["_targets"]
        fallback = copy(model)
        fallback.opt.solver, fallback.opt.iterations = FALLBACK_SOLVER
        stacked = [np.tile(getattr(targets, one.name), (count, 1)) for one in fields(targets)]
        self._targets = ActuatorTargets(*(values.reshape(-1) for values in stacked))
        self.engines = [
            ReplicatedEngine(shared, ActuatorTargets(*rows), fallback)
            for rows in zip(*stacked, strict=True)
        ]
        self._speeds = stacked[[one.name for one in fields(targets)].index("speeds")]
        self.restore(range(count))
        states = [engine.data for engine in self.engines]
        self._views = [data.qpos for data in states], [data.qvel for data in states]
        self._numbers = np.empty(count * model.nq), np.empty(count * model.nv)
        known: dict[int, MujocoBody] = shared["_bodies"]
        self._bodies = len(bodies)
        self._columns = np.full(max(known, default=0) + 1, NO_INDEX)
        self._columns[list(bodies)] = np.arange(len(bodies))
        self._selection = make_body_selection(
            [
                _shift_body(known[body], positions=copied * model.nq, velocities=copied * model.nv)
                for copied in range(count)
                for body in bodies
            ]
        )

    def make_groups(self, least: int) -> Sequence[SteppedTogether]:
        """See `EngineReplicas.make_groups`."""
        count = len(self.engines)
        parts = np.array_split(np.arange(count), min(count, max(least, -(-count // GROUP_SIZE))))
        return [
            ReplicaGroup([self.engines[at] for at in part.tolist()], self._speeds[part[0] :])
            for part in parts
        ]

    def read(self) -> BodyStates:
        """See `EngineReplicas.read`."""
        qpos, qvel = self._numbers
        np.concatenate(self._views[0], out=qpos)
        np.concatenate(self._views[1], out=qvel)
        gather = self._selection.gather
        with np.errstate(all="ignore"):  # diverged
            base = self._selection.read_bases(qpos, qvel)
        found = BodyStates(
            base,
            gather.gather_joints(qpos, gather.positions),
            gather.gather_joints(qvel, gather.velocities),
        )
        for copied, engine in enumerate(self.engines):
            if engine.is_diverged:
                for rows in (found.base, found.joint_positions, found.joint_velocities):
                    rows.reshape(len(self.engines), -1)[copied] = np.nan
        return found

    def command(self, targets: FloatArray) -> None:
        """See `EngineReplicas.command`."""
        if self._selection.scatter.apply(self._targets, targets.reshape(-1)):
            for engine in self.engines:
                engine.note_new_modes()

    def restore(self, copies: Iterable[int]) -> None:
        """See `EngineReplicas.restore`."""
        for copied in copies:
            self.engines[copied].restore(self._saved)

    def find_touching(self) -> BoolArray:
        """See `EngineReplicas.find_touching`."""
        found = np.zeros((len(self.engines), self._bodies + 1), np.bool_)
        for row, engine in zip(found, self.engines, strict=True):
            touching = engine.list_touching()
            if len(touching):
                row[self._columns[touching]] = True  # of the others: the last
        return found[:, :-1]


def _shift_body(body: MujocoBody, *, positions: int, velocities: int) -> MujocoBody:
    """Move the indexes of a body in qpos and qvel to those of a copy."""
    start = body.address.start
    start = replace(
        start, positions=start.positions + positions, velocities=start.velocities + velocities
    )
    return replace(body, address=replace(body.address, start=start))


def find_least_spring_damping(stiffness: float, inverse_mass: float, dt_s: float) -> float:
    """Find the damping with which a spring is stable: of a stiff one, stiffness times step.

    MuJoCo integrates springs explicitly and damping implicitly; both together are an implicit
    spring.
    """
    is_soft = stiffness * dt_s**2 * inverse_mass <= MAX_UNDAMPED_SPRING
    return 0.0 if is_soft else stiffness * dt_s


def _compile_model(counts: SlotCounts, config: EngineConfig) -> CompiledModel:
    dt_s = config.step_ns * 1e-9
    load_pieces = partial(load_convex_pieces, config.mesh_folder)
    layout = make_model_layout(counts, config, load_pieces)
    model = mujoco.MjModel.from_xml_string(*write_mjcf(counts, config, load_pieces))
    if invalid := list(layout.invalid_inertias()):
        for body, moments in invalid:
            model.body_inertia[body] = moments
        mujoco.mj_setConst(model, mujoco.MjData(model))
    # One such body makes the constants of all invalid, and then their states.
    if not (np.isfinite(model.body_invweight0).all() and np.isfinite(model.dof_invweight0).all()):
        raise ValueError("its masses cannot be inverted; make masses, moments or distances alike")
    for index in layout.sprung_joints():
        stiffness = float(model.jnt_stiffness[model.dof_jntid[index]])
        least = find_least_spring_damping(stiffness, float(model.dof_invweight0[index]), dt_s)
        model.dof_damping[index] = max(float(model.dof_damping[index]), least)
    # The rows of a joint, its motor's too, yield in proportion to this.
    model.dof_invweight0[list(layout.limited_joints())] *= JOINT_YIELD_SHARE
    bodies = model.geom_bodyid.tolist()
    _set_contact_parameters(model, layout, dt_s)
    axes = make_friction_axes(
        ((geometry, bodies[geometry], part) for geometry, part, _ in layout.geometries()),
        model.geom_friction[:, 0],
        model.geom_priority,
    )
    is_fixed = model.body_weldid[model.geom_bodyid] == 0
    surfaces = ((geometry, part) for geometry, part, _ in layout.geometries())
    return CompiledModel(model, layout, axes, make_rebounds(surfaces, is_fixed, dt_s))


def _set_contact_parameters(model: mujoco.MjModel, layout: ModelLayout, dt_s: float) -> None:
    """Set the parameters of contacts by the masses that take part in them."""
    make_parameters = lru_cache(make_contact_parameters)
    inverse_masses = model.body_invweight0[model.geom_bodyid, 0].tolist()
    geometries, rows = [], []
    for geometry, part, mass_kg in layout.geometries():
        # Of a static body, against which others move, it is 0.
        inverse_mass = inverse_masses[geometry] or 1.0 / mass_kg
        solver = make_parameters(part.contact, dt_s, inverse_mass, mass_kg)
        geometries.append(geometry)
        rows.append((solver.stiffness, solver.damping, solver.impedance))
    parameters = np.array(rows).reshape(-1, 3)
    model.geom_solref[geometries] = parameters[:, :2]
    model.geom_solimp[geometries, :2] = parameters[:, 2:]


_COMPILE_CACHE = CompileCache(_compile_model)
