"""A world in MuJoCo's arrays, and how one or several of them make a step."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.compiled_model import CompiledModel
from zensim.sim_server.physics.mujoco.contact_solver import StepSolver, find_solved_dofs
from zensim.sim_server.physics.mujoco.slot_layout import NO_INDEX, IndexArray
from zensim.sim_server.physics.mujoco.slot_state import (
    SLEEP_FLAG,
    ActuatorTargets,
    set_joint_motor,
    set_sleeping_trees,
)
from zensim.sim_server.physics.mujoco.step_inputs import StepInputs, make_step_inputs

if TYPE_CHECKING:
    from zensim.sim_server.physics.mujoco.body_selection import MujocoBody

FALLBACK_SOLVER = int(mujoco.mjtSolver.mjSOL_CG), 1000
"""Solver and iterations of the second solve."""


class SteppedWorld:
    """A compiled model, its state, the bodies in it, and their targets.

    `_owners` are the bodies of its geometries.
    """

    _compiled: CompiledModel
    _model: mujoco.MjModel
    _data: mujoco.MjData
    _targets: ActuatorTargets
    _step_inputs: StepInputs
    _owners: IndexArray

    def __init__(self, config: EngineConfig) -> None:
        """Start without bodies; a model comes before the first step."""
        self._config = config
        self._dt_s = config.step_ns * 1e-9
        self._bodies: dict[int, MujocoBody] = {}
        self._diverged: set[int] = set()
        self._hidden: dict[int, FloatArray] = {}
        self._asleep: set[int] = set()
        self._is_sleep_changed = False
        """Whether MuJoCo does not know yet which bodies sleep, or where static ones are."""
        self._has_loads = False
        self._is_changed = True
        """Whether the inputs of a step must be collected again."""
        self._solved_motors: IndexArray | None = None
        """Motors of the last step, in the order of their rows; None before the first."""

    @property
    def data(self) -> mujoco.MjData:
        """State."""
        return self._data

    @property
    def model(self) -> mujoco.MjModel:
        """Model of MuJoCo."""
        return self._model

    @property
    def compiled(self) -> CompiledModel:
        """What `model` is a copy of."""
        return self._compiled

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

    def drive_motors(self, inputs: StepInputs) -> None:
        """Apply the targets of motors to this step."""
        if len(inputs.motors):
            self._apply_motor_speeds()
        if len(inputs.pushed):
            self._data.qfrc_applied[inputs.pushed] += self._targets.efforts[inputs.pushed]
            self._has_loads = True

    def end_step(self, inputs: StepInputs, *, may_be_invalid: bool) -> None:
        """Clear the loads of a step; mark what has diverged."""
        if self._has_loads or len(inputs.link_forces):
            self._data.xfrc_applied[:] = 0.0
            self._data.qfrc_applied[:] = 0.0
            self._has_loads = False
        if may_be_invalid and not math.isfinite(self._data.qvel.sum()):
            self._find_diverged()

    def solve_again(self, start: tuple[FloatArray, FloatArray], change: FloatArray) -> None:
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

    def _find_diverged(self) -> None:
        """Mark the bodies whose state is not finite."""
        raise NotImplementedError

    def _is_active(self, body: int) -> bool:
        return body not in self._diverged and body not in self._hidden

    def _set_joint_motors(self, number: int) -> None:
        """Set the motors of the controlled joints of an active body as their kinds say."""
        body = self._bodies[number]
        if not body.actuation.joint_motors or not self._is_active(number):
            return
        for motor in body.actuation.joint_motors:
            if (index := body.address.joint_velocity(motor.joint)) != NO_INDEX:
                friction = float(self._compiled.model.dof_frictionloss[index])
                set_joint_motor(self._model, self._targets, index, motor, friction)

    def _update_step_inputs(self) -> None:
        """Collect the inputs of a step again."""
        model = self._model
        self._is_changed = False
        self._step_inputs = make_step_inputs(
            [body for number, body in self._bodies.items() if self._is_active(number)],
            self._targets,
            model.dof_frictionloss,
            model.jnt_qposadr[model.dof_jntid].astype(np.intp),
            model.jnt_range[model.dof_jntid],
            model.dof_M0,
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
            rebounds.apply(data)

    def _apply_motor_speeds(self) -> None:
        """Set the target speed of each motor.

        A motor is a friction constraint whose reference speed is shifted from 0 here, between
        `mj_step1`, which makes the rows, and `mj_step2`, which solves them.
        """
        data = self._data
        speeds = self._step_inputs.speeds(self._targets, data.qpos, self._dt_s)
        speeds /= self._dt_s
        data.efc_aref[data.ne : data.ne + data.nf] += speeds


def step_worlds(worlds: Sequence[SteppedWorld], speeds: FloatArray | None = None) -> None:
    """Advance worlds of one model by a step.

    Args:
        worlds: Those that have not diverged.
        speeds: (worlds, degrees of freedom) their `ActuatorTargets.speeds`, if in one array.
    """
    inputs, first = [world.begin_step() for world in worlds], worlds[0]
    if speeds is None or len(inputs[0].position_motors) or len(inputs[0].pushed):
        for world, own in zip(worlds, inputs, strict=True):
            world.drive_motors(own)
    elif len(inputs[0].motors):
        wanted = speeds[:, inputs[0].motors] / first.compiled.dt_s
        for world, row in zip(worlds, wanted, strict=True):
            world.data.efc_aref[world.data.ne : world.data.ne + world.data.nf] += row
    solver = StepSolver(
        first.compiled,
        first.model,
        [world.data for world in worlds],
        lambda at, start, change: worlds[at].solve_again(start, change),
    )
    solver.solve()
    for at, (world, own) in enumerate(zip(worlds, inputs, strict=True)):
        world.end_step(own, may_be_invalid=at in solver.suspects)
