"""The Engine over MuJoCo. The only file that imports mujoco."""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from itertools import count

import mujoco
import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.proto.rotation import conjugate, rotate
from zensim.sim_server.physics.acceptance import check_meshes
from zensim.sim_server.physics.actuation import actuation_of
from zensim.sim_server.physics.casting.contact import correct, soft
from zensim.sim_server.physics.casting.foundry import Foundry
from zensim.sim_server.physics.casting.gathering import XYZ_XYZW
from zensim.sim_server.physics.casting.make import NONE, Make, Makes
from zensim.sim_server.physics.casting.meshes import pieces
from zensim.sim_server.physics.casting.mjcf import JOINTS, MAX_PARTS, SHAPES, mjcf_of
from zensim.sim_server.physics.casting.nearness import nearby
from zensim.sim_server.physics.casting.plan import Plan, plan_of
from zensim.sim_server.physics.casting.seat import Seat
from zensim.sim_server.physics.casting.selection import Body, Selection, selection_of
from zensim.sim_server.physics.casting.slots import Cast, Slots
from zensim.sim_server.physics.casting.stock import stock_of
from zensim.sim_server.physics.casting.switching import (
    FARTHEST,
    carry,
    empty,
    empty_all,
    fill,
    is_bearable,
    man,
    still,
)
from zensim.sim_server.physics.casting.wishes import no_wishes
from zensim.sim_server.physics.engine import EngineConfig, EngineRefused, FloatArray, Reading
from zensim.sim_server.physics.loads import loads_of
from zensim.sim_server.physics.planning import Planner

# They would be said on the terminal, and in a file of the working directory.
mujoco.set_mju_user_warning(lambda _: None)

OVERLAP_M = 0.001
"""Bodies that only touch do not overlap."""
WILD = 20.0
"""A change of a speed in one step [m/s or rad/s] that is solved again to be sure of it."""
CONJUGATE = int(mujoco.mjtSolver.mjSOL_CG), 1000
"""Method and most iterations of what is solved again."""
KEPT_SELECTIONS = 4096


@dataclass(frozen=True)
class Casting:
    """A compiled cast; each engine works on a copy of its model, where slots may be empty."""

    model: mujoco.MjModel
    plan: Plan


class MujocoEngine:
    """MuJoCo's constraints solved by Newton's method, one MjData."""

    name = "mujoco"

    def __init__(self, config: EngineConfig) -> None:
        self._config = config
        self._dt_s = config.step_ns * 1e-9
        self._weight = math.hypot(*config.gravity)
        self._planner = Planner(
            self.name, max_parts=MAX_PARTS, joint_kinds=JOINTS, shape_kinds=SHAPES
        )
        self._bodies: dict[int, Body] = {}
        self._broken: set[int] = set()
        self._concealed: dict[int, FloatArray] = {}
        self._numbers = count(1)
        self._makes, self._slots = Makes(), Slots()
        self._is_pushed = False
        self._use(_FOUNDRY.cast((), config))

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`: what is missing is compiled besides."""
        try:
            cast = self._slots.with_one_more(self._make(model))
        except EngineRefused:
            return True
        return cast == self._slots.cast or _FOUNDRY.is_ready(cast, self._config)

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`."""
        make = self._make(model)
        casting = self._casting_with_one_more(make, model.name)
        number = next(self._numbers)
        slot = self._slots.take(make, number)
        if casting is not self._casting:
            self._recast(casting)
            _FOUNDRY.make_ahead(casting.plan.cast, make, self._config)
        loads = loads_of(self._planner.blueprint(model), self._config.gravity, self._dt_s)
        seat = casting.plan.seat(make, slot)
        body = self._bodies[number] = Body(model, make, slot, seat, actuation_of(model), loads)
        self._owners[seat.geometries] = number
        self._fill(body)
        zeros = np.zeros(len(model.joints))
        self.put(number, base, zeros, zeros)
        return number

    def remove(self, body: int) -> None:
        """See `Engine.remove`; its slot is empty then."""
        gone = self._bodies.pop(body)
        self._broken.discard(body)
        self._concealed.pop(body, None)
        self._empty(gone.seat)
        self._owners[gone.seat.geometries] = NONE
        self._slots.release(gone.make, gone.slot)

    def conceal(self, body: int) -> None:
        """See `Concealing.conceal`."""
        seat = self._bodies[body].seat
        self._concealed[body] = self._data.qpos[seat.positions]
        still(self._model, self._data, seat)
        self._wishes.forget(seat.velocities)
        self._is_changed = True

    def reveal(self, bodies: Sequence[int]) -> None:
        """See `Concealing.reveal`."""
        for number in bodies:
            body = self._bodies[number]
            # To the bit: what hangs drifts by what gravity and its compensation are rounded by.
            self._data.qpos[body.seat.positions] = self._concealed.pop(number)
            self._data.qvel[body.seat.velocities] = 0.0
            self._fill(body)

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._slots = Slots()
        for number, body in self._bodies.items():
            body.slot = self._slots.take(body.make, number)
        self._recast(_FOUNDRY.cast(self._slots.cast, self._config))

    def overlapping(self, body: int) -> Sequence[int]:
        """See `Engine.overlapping`."""
        model, data, owners = self._model, self._data, self._owners
        mujoco.mj_kinematics(model, data)
        own = self._bodies[body].seat.geometries
        near = nearby(data.geom_xpos, model.geom_rbound, own)
        found: set[int] = set()
        for other in near[(owners[near] != NONE) & (owners[near] != body)].tolist():
            for mine in own.tolist():
                if mujoco.mj_geomDistance(model, data, mine, other, 1.0, None) < -OVERLAP_M:
                    found.add(int(owners[other]))
        return sorted(found - self._broken)

    def read(self, bodies: Sequence[int]) -> Reading:
        """See `Engine.read`; what is broken reads as NaN where it is not what broke it."""
        chosen, data = self._selection(bodies), self._data
        base = chosen.bases(data.qpos, data.qvel)
        for body in self._broken.intersection(bodies):
            base[bodies.index(body)] = self._bodies[body].stand
        return Reading(
            base,
            chosen.gathering.of_joints(data.qpos, chosen.gathering.positions),
            chosen.gathering.of_joints(data.qvel, chosen.gathering.velocities),
        )

    def place(self, body: int, base: FloatArray) -> None:
        """See `Engine.place`."""
        placed = self._bodies[body]
        if placed.make.is_static:
            self._nail(placed, base)
            return
        if not is_bearable(base):
            self._break(body, base)
            return
        if body in self._broken:
            self._broken.discard(body)
            self._fill(placed)
        first, rate = placed.seat.begins.positions, placed.seat.begins.velocities
        self._data.qpos[first + XYZ_XYZW] = base[:7]
        self._data.qvel[rate : rate + 3] = base[7:10]
        self._data.qvel[rate + 3 : rate + 6] = rotate(conjugate(base[3:7]), base[10:])
        if body in self._concealed:
            self.conceal(body)

    def put(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.put`."""
        self.place(body, base)
        moving, place, rate = self._bodies[body].seat.joints
        if body not in self._broken:
            self._data.qpos[place] = positions[moving]
            self._data.qvel[rate] = velocities[moving]

    def rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.rest`."""
        zeros = np.zeros(len(self._bodies[body].model.joints))
        self.put(body, base, zeros if positions is None else positions, zeros)
        self.command([body], np.zeros(self._bodies[body].actuation.width))
        self._wishes.is_moved[self._bodies[body].seat.velocities] = False
        self._is_changed = True

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        if self._selection(bodies).telling.tell(self._wishes, targets):
            self._is_changed = True

    def push_link(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.push_link`."""
        seat = self._bodies[body].seat
        self._data.xfrc_applied[seat.begins.bodies + seat.layout.bodies[link]] += wrench
        self._is_pushed = True

    def push_joint(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.push_joint`."""
        if (place := self._bodies[body].seat.joint_velocity(joint)) != NONE:
            self._data.qfrc_applied[place] += effort
            self._is_pushed = True

    def step(self) -> bool:
        """See `Engine.step`; lets other threads run meanwhile."""
        model, data = self._model, self._data
        if self._is_changed:
            self._take_stock()
        stock = self._stock
        if len(stock.moved.free):
            stock.impose(self._wishes, data.qpos, data.qvel)
        mujoco.mj_step1(model, data)
        if len(stock.pulls):
            stock.pulls.act(data, model.body_rootid)
        if len(stock.motors):
            self._drive()
        if data.ncon:
            correct(data.efc_aref, data.contact, data.efc_KBIP, self._dt_s, self._weight)
        self._solve()
        if self._is_pushed or len(stock.pulls):
            data.xfrc_applied[:] = 0.0
            data.qfrc_applied[:] = 0.0
            self._is_pushed = False
        if not math.isfinite(data.qvel.sum()):
            self._find_broken()
        return not self._broken

    def close(self) -> None:
        """See `Engine.close`."""
        self._bodies.clear()
        self._use(_FOUNDRY.cast((), self._config))

    def _casting_with_one_more(self, make: Make, name: str) -> Casting:
        cast = self._slots.with_one_more(make)
        if cast == self._slots.cast:
            return self._casting
        try:
            return _FOUNDRY.cast(cast, self._config)
        except ValueError as error:
            raise EngineRefused(f"model '{name}' was refused by MuJoCo: {error}") from error

    def _takes_part(self, body: int) -> bool:
        return body not in self._broken and body not in self._concealed

    def _make(self, model: Model) -> Make:
        blueprint = self._planner.blueprint(model)
        make = self._makes.of(blueprint)
        if make not in self._casting.plan.begins:
            check_meshes(blueprint.name, blueprint.parts, self._config.mesh_folder)
        return make

    def _use(self, casting: Casting) -> None:
        """Begin with a cast of which every slot is empty."""
        self._casting = casting
        self._model = copy(casting.model)
        self._data = mujoco.MjData(self._model)
        self._wishes = no_wishes(self._model.nv)
        self._owners = np.full(len(self._model.geom_contype), NONE, np.intp)
        self._is_changed = True
        self._selections: dict[tuple[int, ...], Selection] = {}
        empty_all(self._model, self._data, casting.plan)

    def _recast(self, casting: Casting) -> None:
        """Go on with a cast that has other slots; what is in them stays as it is."""
        model, data, wishes, plan = self._model, self._data, self._wishes, casting.plan
        old = [body.seat for body in self._bodies.values()]
        self._use(casting)
        for number, body in self._bodies.items():
            body.seat = plan.seat(body.make, body.slot)
            self._owners[body.seat.geometries] = number
            if self._takes_part(number):
                self._fill(body)
        new = [body.seat for body in self._bodies.values()]
        self._wishes = carry(
            (model, data, old), (self._model, self._data, new), (wishes, self._model.nv)
        )

    def _fill(self, body: Body) -> None:
        """Let what is in a slot touch, fall and be driven."""
        fill(self._model, self._data, self._casting.model, body.seat)
        man(self._model, self._wishes, body.seat, body.actuation)
        self._is_changed = True

    def _empty(self, seat: Seat) -> None:
        """Let what is in a slot touch nothing, hang still, and wish for nothing."""
        empty(self._model, self._data, seat)
        self._wishes.forget(seat.velocities)
        self._is_changed = True

    def _nail(self, body: Body, base: FloatArray) -> None:
        body.stand = np.concatenate([base[:7], np.zeros(6)])
        if is_bearable(base):
            root = body.seat.begins.bodies
            self._model.body_pos[root] = base[:3]
            self._model.body_quat[root] = base[[6, 3, 4, 5]]

    def _break(self, number: int, base: FloatArray) -> None:
        """Take a body out of reach of the others: MuJoCo cannot bear its numbers."""
        body = self._bodies[number]
        body.stand = np.where(np.abs(base) <= FARTHEST, base, np.nan)
        self._empty(body.seat)
        self._broken.add(number)

    def _find_broken(self) -> None:
        for number, body in self._bodies.items():
            state = self._data.qpos[body.seat.positions], self._data.qvel[body.seat.velocities]
            if not np.isfinite(np.concatenate(state)).all():
                self._break(number, np.full(13, np.nan))

    def _take_stock(self) -> None:
        """Work out anew what a step has to do beside MuJoCo."""
        model = self._model
        self._is_changed = False
        self._stock = stock_of(
            (body for number, body in self._bodies.items() if self._takes_part(number)),
            self._wishes,
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
        if gained.dot(gained) <= WILD**2 or np.abs(gained).max() <= WILD:
            return
        data.qpos[:], data.qvel[:] = positions, velocities
        solver, iterations = model.opt.solver, model.opt.iterations
        model.opt.solver, model.opt.iterations = CONJUGATE
        mujoco.mj_step2(model, data)
        model.opt.solver, model.opt.iterations = solver, iterations

    def _drive(self) -> None:
        """Give each motor the speed that it is to reach in this step.

        A motor is a friction about a speed, which is shifted here from 0: rows of constraints are
        ready, and not yet solved.
        """
        data = self._data
        speeds = self._stock.speeds(self._wishes, data.qpos, self._dt_s)
        speeds /= self._dt_s
        data.efc_aref[data.ne : data.ne + data.nf] += speeds

    def _selection(self, bodies: Sequence[int]) -> Selection:
        key = tuple(bodies)
        if (known := self._selections.get(key)) is None:
            if len(self._selections) >= KEPT_SELECTIONS:
                self._selections.clear()
            known = self._selections[key] = selection_of([self._bodies[body] for body in bodies])
        return known


def _compiled(cast: Cast, config: EngineConfig) -> Casting:
    cut = partial(pieces, config.mesh_folder)
    plan = plan_of(cast, config, cut)
    model = mujoco.MjModel.from_xml_string(mjcf_of(cast, config, cut))
    if lopsided := list(plan.lopsided()):
        for body, moments in lopsided:
            model.body_inertia[body] = moments
        mujoco.mj_setConst(model, mujoco.MjData(model))
    for geometry, part in plan.yielding():
        lightness = float(model.body_invweight0[model.geom_bodyid[geometry], 0])
        how = soft(part, config.step_ns * 1e-9, lightness or 1.0 / part.mass_kg)
        model.geom_solref[geometry] = how.stiffness, how.damping
        model.geom_solimp[geometry, :2] = how.impedance
    return Casting(model, plan)


_FOUNDRY = Foundry(_compiled)
