"""Compiled models, which the engines of a process share, and the arrays that engines give up."""

from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import mujoco
import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.compile_cache import CompileCache
from zensim.sim_server.physics.mujoco.convex_pieces import load_convex_pieces
from zensim.sim_server.physics.mujoco.mjcf import ModelLayout, make_model_layout, write_mjcf
from zensim.sim_server.physics.mujoco.mujoco_contact import (
    FrictionAxes,
    Rebounds,
    make_contact_parameters,
    make_friction_axes,
    make_rebounds,
)
from zensim.sim_server.physics.mujoco.slot_layout import SlotCounts

SLOT_ARRAYS = (
    *("body_pos", "body_quat", "body_gravcomp", "body_contype", "body_conaffinity"),
    *("geom_contype", "geom_conaffinity", "dof_frictionloss", "jnt_stiffness"),
)
"""Arrays of a model that differ between engines: see `MjModelArrays`."""
MAX_SPARES, MAX_SPARE_BYTES = 8, 1 << 22
"""A world that gets ten robots one by one grows through five sizes, which the next one uses."""
JOINT_YIELD_SHARE = 0.3
"""Yield of joints with limits, over MuJoCo's least, at which long arms sag at 100 Hz."""
MAX_UNDAMPED_SPRING = 0.25
"""Stiffness of a spring times step squared over mass, up to which it may oscillate undamped."""

# Warnings would go to the terminal and to a file in the working directory.
mujoco.set_mju_user_warning(lambda _: None)


@dataclass(frozen=True)
class CompiledModel:
    """A compiled model; each engine uses a copy, in which slots may be inactive."""

    model: mujoco.MjModel
    layout: ModelLayout
    dt_s: float
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
    return CompiledModel(model, layout, dt_s, axes, make_rebounds(surfaces, is_fixed, dt_s))


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


COMPILE_CACHE = CompileCache(_compile_model)
SPARES = SpareArrays()
