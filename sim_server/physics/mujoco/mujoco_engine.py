"""The Engine over MuJoCo."""

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from copy import deepcopy

import mujoco
import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.blueprint import BlueprintCache, check_mesh_files
from zensim.sim_server.physics.engine import (
    NO_CONTACTS,
    BodyStates,
    ContactPoints,
    Engine,
    EngineCapabilities,
    EngineRefused,
    EngineReplicas,
    FloatArray,
    Place,
    concatenate_contacts,
    make_unknown_efforts,
)
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.link_forces import make_link_forces
from zensim.sim_server.physics.mujoco.body_selection import (
    QPOS_POSE_ORDER,
    BodySelection,
    MujocoBody,
    make_body_selection,
)
from zensim.sim_server.physics.mujoco.compiled_model import (
    COMPILE_CACHE,
    SLOT_ARRAYS,
    SPARES,
    CompiledModel,
    SavedState,
)
from zensim.sim_server.physics.mujoco.mjcf import (
    MAX_PARTS,
    SUPPORTED_JOINT_KINDS,
    SUPPORTED_SHAPE_KINDS,
)
from zensim.sim_server.physics.mujoco.mujoco_contact import read_contact_points
from zensim.sim_server.physics.mujoco.mujoco_replicas import MujocoReplicas
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
    activate_motors,
    activate_slot,
    copy_slot_states,
    deactivate_all_slots,
    deactivate_slot,
    freeze_slot,
    is_within_limits,
    make_zero_targets,
)
from zensim.sim_server.physics.mujoco.stepped_world import SteppedWorld, step_worlds

OVERLAP_M = 0.001
"""Depth from which bodies overlap instead of touching."""
MAX_CACHED_SELECTIONS = 4096
MAX_ANNOUNCED_AT_ONCE = 32
"""Expected bodies whose archetypes are found between two steps."""
_NO_ARRAYS = dict.fromkeys(("_compiled", "_model", "_data", "_selections", "_solved_motors"))


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


class MujocoEngine(SteppedWorld, Engine):
    """MuJoCo with Newton's method, one MjData."""

    name = "mujoco"
    capabilities = EngineCapabilities(hides=True, sleeps="loose", copies=True)

    def __init__(self, config: EngineConfig) -> None:
        super().__init__(config)
        self._is_closed = False
        self._blueprints = BlueprintCache(
            self.name,
            max_parts=MAX_PARTS,
            joint_kinds=SUPPORTED_JOINT_KINDS,
            shape_kinds=SUPPORTED_SHAPE_KINDS,
            mesh_folder=config.mesh_folder,
        )
        self._archetypes, self._slots = ArchetypeCache(), SlotAllocator()
        self._announced: deque[Model] = deque()
        """Models of expected bodies, whose archetypes are not found yet."""
        self._kept_contacts = NO_CONTACTS
        """Contacts of sleeping bodies, when they fell asleep."""
        self._selections: dict[tuple[int, ...], BodySelection] = {}
        self._start_with(COMPILE_CACHE.compile((), config))

    def __getstate__(self) -> dict[str, object]:
        """Take what determines the next steps; not contacts and forces of the last one."""
        return {**self.__dict__, **_NO_ARRAYS, "_saved": self._save()}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Restore the state; compiles the model unless this process has it."""
        self.__dict__.update(state)
        self._load(self.__dict__.pop("_saved"))

    def _save(self) -> SavedState:
        model, data = self._model, self._data
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        numbers = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, numbers, kind)
        arrays = tuple(getattr(model, name).copy() for name in SLOT_ARRAYS)
        return SavedState(self._compiled.layout.slot_counts, numbers, data.qacc.copy(), arrays)

    def _load(self, saved: SavedState) -> None:
        self._compiled = COMPILE_CACHE.compile(saved.counts, self._config)
        self._model, self._data = SPARES.take(self._compiled)
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
        return counts == self._slots.counts or COMPILE_CACHE.is_ready(counts, self._config)

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
                COMPILE_CACHE.compile_ahead(counts, archetype, self._config)
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
        self._switch_model(COMPILE_CACHE.compile(self._slots.counts, self._config))

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
        step_worlds([self])
        return not self._diverged

    def replicate(self, bodies: Sequence[int], count: int) -> EngineReplicas:
        """See `Engine.replicate`; the copies share one model, and no body of them sleeps."""
        if self._diverged or self._hidden:
            raise EngineRefused("an engine with diverged or hidden bodies cannot be copied")
        copied = deepcopy(self)
        copied.wake(sorted(self._asleep))
        return MujocoReplicas(copied, self._save(), bodies, count)

    def close(self) -> None:
        """See `Engine.close`."""
        if self._is_closed:
            return
        self._is_closed = True
        SPARES.give(self._compiled, self._model, self._data)
        self._bodies.clear()
        self._asleep.clear()
        compiled = COMPILE_CACHE.compile((), self._config)
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
            return COMPILE_CACHE.compile(counts, self._config)
        except ValueError:
            self._slots.forget_expected()
            fewer = self._slots.with_one_more(archetype)
            if fewer == counts:
                raise
        return COMPILE_CACHE.compile(fewer, self._config)

    def _find_expected_archetypes(self, count: int) -> None:
        """Find the archetypes of some expected bodies; `insert` refuses those that have none."""
        for _ in range(min(count, len(self._announced))):
            with suppress(EngineRefused):
                self._slots.expect_one_more(self._find_archetype(self._announced.popleft()))

    def _find_archetype(self, model: Model) -> Archetype:
        blueprint = self._blueprints.find(model)
        archetype = self._archetypes.find(blueprint)
        if archetype not in self._compiled.layout.start:
            check_mesh_files(blueprint.name, blueprint.parts, self._config.mesh_folder)
        return archetype

    def _start_with(
        self, compiled: CompiledModel, arrays: tuple[mujoco.MjModel, mujoco.MjData] | None = None
    ) -> None:
        """Use a model, all slots inactive; None = model and data of its own."""
        self._compiled = compiled
        self._model, self._data = SPARES.take(compiled) if arrays is None else arrays
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

    def _selection(self, bodies: Sequence[int]) -> BodySelection:
        key = tuple(bodies)
        if (selection := self._selections.get(key)) is None:
            if len(self._selections) >= MAX_CACHED_SELECTIONS:
                self._selections.clear()
            selection = self._selections[key] = make_body_selection(
                [self._bodies[body] for body in bodies]
            )
        return selection
