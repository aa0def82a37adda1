"""The Engine over MuJoCo. The only module that imports mujoco."""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from itertools import count

import mujoco
import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.blueprint import BlueprintCache, check_mesh_files
from zensim.sim_server.physics.engine import (
    BodyStates,
    Engine,
    EngineCapabilities,
    EngineRefused,
    FloatArray,
)
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.link_forces import make_link_forces
from zensim.sim_server.physics.mujoco.actuator_targets import make_zero_targets
from zensim.sim_server.physics.mujoco.body_selection import (
    QPOS_POSE_ORDER,
    BodySelection,
    MujocoBody,
    make_body_selection,
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
    correct_contact_rows,
    make_soft_parameters,
)
from zensim.sim_server.physics.mujoco.slot_activation import (
    MAX_STATE_VALUE,
    activate_motors,
    activate_slot,
    copy_slot_states,
    deactivate_all_slots,
    deactivate_slot,
    freeze_slot,
    is_within_limits,
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
from zensim.sim_server.physics.mujoco.step_inputs import make_step_inputs


def find_near_geometries(centres: FloatArray, radii: FloatArray, own: IndexArray) -> IndexArray:
    """Find the geometries that reach into the ball around some of them.

    Args:
        centres: (n, 3) of all.
        radii: (n,) of the balls around all.
        own: Which of them the ball is around; they are among those found.
    """
    if not len(own):
        return own
    middle = centres[own].mean(axis=0)
    reach = float((np.linalg.norm(centres[own] - middle, axis=1) + radii[own]).max())
    apart = centres - middle
    return np.flatnonzero(np.einsum("ij,ij->i", apart, apart) <= (radii + reach) ** 2)


# They would be said on the terminal, and in a file of the working directory.
mujoco.set_mju_user_warning(lambda _: None)

OVERLAP_M = 0.001
"""Bodies that only touch do not overlap."""
MAX_SPEED_CHANGE = 20.0
"""A change of a speed in one step [m/s or rad/s] that is solved again to be sure of it."""
FALLBACK_SOLVER = int(mujoco.mjtSolver.mjSOL_CG), 1000
"""Method and most iterations of what is solved again."""
MAX_CACHED_SELECTIONS = 4096


@dataclass(frozen=True)
class CompiledModel:
    """A compiled cast; each engine works on a copy of its model, where slots may be empty."""

    model: mujoco.MjModel
    plan: ModelLayout


class MujocoEngine(Engine):
    """MuJoCo's constraints solved by Newton's method, one MjData."""

    name = "mujoco"
    capabilities = EngineCapabilities(hides=True)

    def __init__(self, config: EngineConfig) -> None:
        self._config = config
        self._dt_s = config.step_ns * 1e-9
        self._weight = math.hypot(*config.gravity)
        self._blueprints = BlueprintCache(
            self.name,
            max_parts=MAX_PARTS,
            joint_kinds=SUPPORTED_JOINT_KINDS,
            shape_kinds=SUPPORTED_SHAPE_KINDS,
        )
        self._bodies: dict[int, MujocoBody] = {}
        self._broken: set[int] = set()
        self._hidden: dict[int, FloatArray] = {}
        self._numbers = count(1)
        self._archetypes, self._slots = ArchetypeCache(), SlotAllocator()
        self._is_pushed = False
        self._start_with(_COMPILE_CACHE.compile((), config))

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`: what is missing is compiled besides."""
        try:
            cast = self._slots.with_one_more(self._find_archetype(model))
        except EngineRefused:
            return True
        return cast == self._slots.counts or _COMPILE_CACHE.is_ready(cast, self._config)

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`."""
        make = self._find_archetype(model)
        casting = self._compile_with_one_more(make, model.name)
        number = next(self._numbers)
        slot = self._slots.take(make, number)
        if casting is not self._compiled:
            self._switch_model(casting)
            _COMPILE_CACHE.compile_ahead(casting.plan.slot_counts, make, self._config)
        loads = make_link_forces(self._blueprints.find(model), self._config.gravity, self._dt_s)
        seat = casting.plan.address(make, slot)
        body = self._bodies[number] = MujocoBody(
            model, make, slot, seat, make_actuation(model), loads
        )
        self._owners[seat.geometries] = number
        self._activate(body)
        zeros = np.zeros(len(model.joints))
        self.set_state(number, base, zeros, zeros)
        return number

    def remove(self, body: int) -> None:
        """See `Engine.remove`; its slot is empty then."""
        gone = self._bodies.pop(body)
        self._broken.discard(body)
        self._hidden.pop(body, None)
        self._deactivate(gone.address)
        self._owners[gone.address.geometries] = NO_INDEX
        self._slots.release(gone.archetype, gone.slot)

    def hide(self, body: int) -> None:
        """See `Engine.hide`."""
        seat = self._bodies[body].address
        self._hidden[body] = self._data.qpos[seat.positions]
        freeze_slot(self._model, self._data, seat)
        self._targets.clear(seat.velocities)
        self._is_changed = True

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        for number in bodies:
            body = self._bodies[number]
            # To the bit: what hangs drifts by what gravity and its compensation are rounded by.
            self._data.qpos[body.address.positions] = self._hidden.pop(number)
            self._data.qvel[body.address.velocities] = 0.0
            self._activate(body)

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._slots = SlotAllocator()
        for number, body in self._bodies.items():
            body.slot = self._slots.take(body.archetype, number)
        self._switch_model(_COMPILE_CACHE.compile(self._slots.counts, self._config))

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`."""
        model, data, owners = self._model, self._data, self._owners
        mujoco.mj_kinematics(model, data)
        own = self._bodies[body].address.geometries
        near = find_near_geometries(data.geom_xpos, model.geom_rbound, own)
        found: set[int] = set()
        for other in near[(owners[near] != NO_INDEX) & (owners[near] != body)].tolist():
            for mine in own.tolist():
                if mujoco.mj_geomDistance(model, data, mine, other, 1.0, None) < -OVERLAP_M:
                    found.add(int(owners[other]))
        return sorted(found - self._broken)

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`; what is broken reads as NaN where it is not what broke it."""
        chosen, data = self._selection(bodies), self._data
        base = chosen.read_bases(data.qpos, data.qvel)
        for body in self._broken.intersection(bodies):
            base[bodies.index(body)] = self._bodies[body].fixed_state
        return BodyStates(
            base,
            chosen.gather.gather_joints(data.qpos, chosen.gather.positions),
            chosen.gather.gather_joints(data.qvel, chosen.gather.velocities),
        )

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`."""
        placed = self._bodies[body]
        if placed.archetype.is_static:
            self._place_static(placed, base)
            return
        if not is_within_limits(base):
            self._mark_broken(body, base)
            return
        if body in self._broken:
            self._broken.discard(body)
            self._activate(placed)
        first, rate = placed.address.start.positions, placed.address.start.velocities
        self._data.qpos[first + QPOS_POSE_ORDER] = base[:7]
        self._data.qvel[rate : rate + 3] = base[7:10]
        self._data.qvel[rate + 3 : rate + 6] = rotate(conjugate(base[3:7]), base[10:])
        if body in self._hidden:
            self.hide(body)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        self.set_base_state(body, base)
        moving, place, rate = self._bodies[body].address.joints
        if body not in self._broken:
            self._data.qpos[place] = positions[moving]
            self._data.qvel[rate] = velocities[moving]

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
            self._is_changed = True

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`."""
        seat = self._bodies[body].address
        self._data.xfrc_applied[seat.start.bodies + seat.layout.bodies[link]] += wrench
        self._is_pushed = True

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`."""
        if (place := self._bodies[body].address.joint_velocity(joint)) != NO_INDEX:
            self._data.qfrc_applied[place] += effort
            self._is_pushed = True

    def step(self) -> bool:
        """See `Engine.step`; lets other threads run meanwhile."""
        model, data = self._model, self._data
        if self._is_changed:
            self._update_step_inputs()
        stock = self._step_inputs
        if len(stock.twisted_roots.free):
            stock.impose_twists(self._targets, data.qpos, data.qvel)
        mujoco.mj_step1(model, data)
        if len(stock.link_forces):
            stock.link_forces.apply(data, model.body_rootid)
        if len(stock.motors):
            self._apply_motor_speeds()
        if data.ncon:
            correct_contact_rows(
                data.efc_aref, data.contact, data.efc_KBIP, self._dt_s, self._weight
            )
        self._solve()
        if self._is_pushed or len(stock.link_forces):
            data.xfrc_applied[:] = 0.0
            data.qfrc_applied[:] = 0.0
            self._is_pushed = False
        if not math.isfinite(data.qvel.sum()):
            self._find_broken()
        return not self._broken

    def close(self) -> None:
        """See `Engine.close`."""
        self._bodies.clear()
        self._start_with(_COMPILE_CACHE.compile((), self._config))

    def _compile_with_one_more(self, make: Archetype, name: str) -> CompiledModel:
        cast = self._slots.with_one_more(make)
        if cast == self._slots.counts:
            return self._compiled
        try:
            return _COMPILE_CACHE.compile(cast, self._config)
        except ValueError as error:
            raise EngineRefused(f"model '{name}' was refused by MuJoCo: {error}") from error

    def _is_active(self, body: int) -> bool:
        return body not in self._broken and body not in self._hidden

    def _find_archetype(self, model: Model) -> Archetype:
        blueprint = self._blueprints.find(model)
        make = self._archetypes.find(blueprint)
        if make not in self._compiled.plan.start:
            check_mesh_files(blueprint.name, blueprint.parts, self._config.mesh_folder)
        return make

    def _start_with(self, casting: CompiledModel) -> None:
        """Begin with a cast of which every slot is empty."""
        self._compiled = casting
        self._model = copy(casting.model)
        self._data = mujoco.MjData(self._model)
        self._targets = make_zero_targets(self._model.nv)
        self._owners = np.full(len(self._model.geom_contype), NO_INDEX, np.intp)
        self._is_changed = True
        self._selections: dict[tuple[int, ...], BodySelection] = {}
        deactivate_all_slots(self._model, self._data, casting.plan)

    def _switch_model(self, casting: CompiledModel) -> None:
        """Go on with a cast that has other slots; what is in them stays as it is."""
        model, data, wishes, plan = self._model, self._data, self._targets, casting.plan
        old = [body.address for body in self._bodies.values()]
        self._start_with(casting)
        for number, body in self._bodies.items():
            body.address = plan.address(body.archetype, body.slot)
            self._owners[body.address.geometries] = number
            if self._is_active(number):
                self._activate(body)
        new = [body.address for body in self._bodies.values()]
        self._targets = copy_slot_states(
            (model, data, old), (self._model, self._data, new), (wishes, self._model.nv)
        )

    def _activate(self, body: MujocoBody) -> None:
        """Let what is in a slot touch, fall and be driven."""
        activate_slot(self._model, self._data, self._compiled.model, body.address)
        activate_motors(self._model, self._targets, body.address, body.actuation)
        self._is_changed = True

    def _deactivate(self, address: SlotAddress) -> None:
        """Let what is in a slot touch nothing, hang still, and wish for nothing."""
        deactivate_slot(self._model, self._data, address)
        self._targets.clear(address.velocities)
        self._is_changed = True

    def _place_static(self, body: MujocoBody, base: FloatArray) -> None:
        body.fixed_state = np.concatenate([base[:7], np.zeros(6)])
        if is_within_limits(base):
            root = body.address.start.bodies
            self._model.body_pos[root] = base[:3]
            self._model.body_quat[root] = base[[6, 3, 4, 5]]

    def _mark_broken(self, number: int, base: FloatArray) -> None:
        """Take a body out of reach of the others: MuJoCo cannot bear its numbers."""
        body = self._bodies[number]
        body.fixed_state = np.where(np.abs(base) <= MAX_STATE_VALUE, base, np.nan)
        self._deactivate(body.address)
        self._broken.add(number)

    def _find_broken(self) -> None:
        for number, body in self._bodies.items():
            state = (
                self._data.qpos[body.address.positions],
                self._data.qvel[body.address.velocities],
            )
            if not np.isfinite(np.concatenate(state)).all():
                self._mark_broken(number, np.full(13, np.nan))

    def _update_step_inputs(self) -> None:
        """Work out anew what a step has to do beside MuJoCo."""
        model = self._model
        self._is_changed = False
        self._step_inputs = make_step_inputs(
            (body for number, body in self._bodies.items() if self._is_active(number)),
            self._targets,
            model.dof_frictionloss,
            model.jnt_qposadr[model.dof_jntid].astype(np.intp),
        )

    def _solve(self) -> None:
        """End a step; once more by conjugate gradients where Newton's method lost its way.

        It does so, rarely, among many contacts that contradict each other.
        """
        model, data = self._model, self._data
        positions, velocities = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step2(model, data)
        gained = data.qvel - velocities
        # What all gained together is told faster than what each did.
        if gained.dot(gained) <= MAX_SPEED_CHANGE**2 or np.abs(gained).max() <= MAX_SPEED_CHANGE:
            return
        data.qpos[:], data.qvel[:] = positions, velocities
        solver, iterations = model.opt.solver, model.opt.iterations
        model.opt.solver, model.opt.iterations = FALLBACK_SOLVER
        mujoco.mj_step2(model, data)
        model.opt.solver, model.opt.iterations = solver, iterations

    def _apply_motor_speeds(self) -> None:
        """Give each motor the speed that it is to reach in this step.

        A motor is a friction about a speed, which is shifted here from 0: rows of constraints are
        ready, and not yet solved.
        """
        data = self._data
        speeds = self._step_inputs.speeds(self._targets, data.qpos, self._dt_s)
        speeds /= self._dt_s
        data.efc_aref[data.ne : data.ne + data.nf] += speeds

    def _selection(self, bodies: Sequence[int]) -> BodySelection:
        key = tuple(bodies)
        if (known := self._selections.get(key)) is None:
            if len(self._selections) >= MAX_CACHED_SELECTIONS:
                self._selections.clear()
            known = self._selections[key] = make_body_selection(
                [self._bodies[body] for body in bodies]
            )
        return known


def _compile_model(cast: SlotCounts, config: EngineConfig) -> CompiledModel:
    cut = partial(load_convex_pieces, config.mesh_folder)
    plan = make_model_layout(cast, config, cut)
    model = mujoco.MjModel.from_xml_string(write_mjcf(cast, config, cut))
    if lopsided := list(plan.invalid_inertias()):
        for body, moments in lopsided:
            model.body_inertia[body] = moments
        mujoco.mj_setConst(model, mujoco.MjData(model))
    for geometry, part in plan.soft_geometries():
        lightness = float(model.body_invweight0[model.geom_bodyid[geometry], 0])
        how = make_soft_parameters(part, config.step_ns * 1e-9, lightness or 1.0 / part.mass_kg)
        model.geom_solref[geometry] = how.stiffness, how.damping
        model.geom_solimp[geometry, :2] = how.impedance
    return CompiledModel(model, plan)


_COMPILE_CACHE = CompileCache(_compile_model)
