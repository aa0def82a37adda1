"""MJCF text of a world with slots, and the layout of the compiled model that follows from its order."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zensim.proto.messages.model_messages import Origin, Shape
from zensim.sim_server.physics.blueprint import RigidPart
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.convex_pieces import HullPoints
from zensim.sim_server.physics.mujoco.mujoco_contact import (
    SolverParameters,
    find_geom_friction,
    make_geom_friction,
    make_motor_parameters,
    make_rigid_parameters,
)
from zensim.sim_server.physics.mujoco.slot_layout import (
    Archetype,
    IndexArray,
    SlotAddress,
    SlotCounts,
    SlotLayout,
    SlotSizes,
    list_mimic_links,
    make_slot_layout,
)

LoadPieces = Callable[[Shape, bool], Sequence[HullPoints]]
"""Convex pieces of a mesh, scaled; the flag says that it never moves."""
IMPRATIO = 10.0
"""How much less a contact slips than it sinks."""
MIN_JOINT_RANGE = 1e-6
"""Between the limits of a joint that has both in one place [rad or m]."""
SLOT_PLACEHOLDER = "@"
"""Stands for the number of a slot in its text."""
SUPPORTED_JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed")
SUPPORTED_SHAPE_KINDS = ("box", "sphere", "cylinder", "capsule", "mesh")
MAX_PARTS = 256
CYLINDRICAL_KINDS = ("cylinder", "capsule")


def write_mjcf(
    slots: Iterable[tuple[Archetype, int]], config: EngineConfig, pieces: LoadPieces
) -> str:
    """Write a world with a ground, if it has one, and so many slots of each make."""
    slots = list(slots)
    assets, names = _write_meshes([make for make, _ in slots], pieces)
    world, rules, gears = [_write_ground(config)], [""], [""]
    number = 0
    for make, count in slots:
        texts = (
            _write_body(make, 0, names, config.step_ns * 1e-9),
            "".join(_write_exclusions(make)),
            "".join(_write_mimic_equalities(make, config.step_ns * 1e-9)),
        )
        for _ in range(count):
            for written, text in zip((world, rules, gears), texts, strict=True):
                written.append(text.replace(SLOT_PLACEHOLDER, str(number)))
            number += 1
    return (
        '<mujoco><compiler angle="radian" balanceinertia="true" boundmass="0"/>'
        f'<option timestep="{config.step_ns * 1e-9!r}" gravity="{_join_numbers(config.gravity)}" '
        f'integrator="implicitfast" cone="elliptic" jacobian="sparse" impratio="{IMPRATIO}">'
        # Whether a step begins where the last one ended is chosen for all islands together.
        '<flag autoreset="disable" warmstart="disable"/></option>'
        f"<asset>{''.join(assets)}</asset><worldbody>{''.join(world)}</worldbody>"
        f"<contact>{''.join(rules)}</contact><equality>{''.join(gears)}</equality></mujoco>"
    )


MeshPieceNames = dict[tuple[Shape, bool], list[str]]


def _write_meshes(
    makes: Iterable[Archetype], pieces: LoadPieces
) -> tuple[list[str], MeshPieceNames]:
    """Write each mesh once; name the pieces of each."""
    texts: list[str] = []
    names: MeshPieceNames = {}
    for make in makes:
        for shape in (shape for part in make.parts for shape in part.shapes if shape.mesh):
            key = shape, make.is_static
            if key in names:
                continue
            names[key] = []
            for points in pieces(shape, make.is_static):
                names[key].append(name := f"m{len(texts)}")
                texts.append(
                    f'<mesh name="{name}" inertia="convex" vertex="{_join_numbers(points.ravel())}"/>'
                )
    return texts, names


def list_geometry_parts(make: Archetype, pieces: LoadPieces) -> list[RigidPart]:
    """List the part that each geometry of a slot belongs to, in MuJoCo's order."""
    found: list[RigidPart] = []

    def visit(link: int) -> None:
        for part, shape in make.shapes(link):
            found.extend([part] * (len(pieces(shape, make.is_static)) if shape.mesh else 1))
        for child in make.children(link):
            visit(child)

    visit(0)
    return found


def _write_ground(config: EngineConfig) -> str:
    if not config.has_ground:
        return ""
    found = make_geom_friction(config.ground_friction, is_static=True)
    touch = _contact_attributes(
        found.friction, found.priority, found.rows, make_rigid_parameters(config.step_ns * 1e-9)
    )
    return f'<geom type="plane" size="0 0 1" {touch}/>'


def _write_body(make: Archetype, link: int, names: MeshPieceNames, dt_s: float) -> str:
    part = make.link_parts[link]
    inside = [_write_inertial(part)]
    if link:
        inside.append(_write_joint(part, link, dt_s))
    elif not make.is_static:
        inside.append("<freejoint/>")
    inside.extend(_write_geometries(make, link, names, dt_s))
    inside.extend(_write_body(make, child, names, dt_s) for child in make.children(link))
    # Compiled in, as MuJoCo else passes over what is written into the model later.
    return f'<body name="b{SLOT_PLACEHOLDER}.{link}" gravcomp="1" {_pose_attributes(part.origin)}>{"".join(inside)}</body>'


def _write_inertial(part: RigidPart) -> str:
    moments = [max(moment, MIN_INERTIA) for moment in part.inertia]
    place = _pose_attributes(Origin(part.com, part.principal))
    mass = max(part.mass_kg, MIN_MASS_KG)
    return f'<inertial {place} mass="{mass!r}" diaginertia="{_join_numbers(moments)}"/>'


def _write_joint(part: RigidPart, link: int, dt_s: float) -> str:
    joint = part.joint
    if joint is None or joint.kind == "fixed":
        return ""
    kind = "slide" if joint.kind == "prismatic" else "hinge"
    limits = ""
    if joint.kind != "continuous" and joint.lower <= joint.upper:
        high = max(joint.upper, joint.lower + MIN_JOINT_RANGE)
        limits = f'limited="true" range="{joint.lower!r} {high!r}" {_solver_attributes("limit", make_rigid_parameters(dt_s))} '
    return (
        f'<joint name="j{SLOT_PLACEHOLDER}.{link}" type="{kind}" axis="{_join_numbers(joint.axis)}" {limits}'
        f'damping="{joint.damping!r}" frictionloss="{joint.friction!r}" '
        f"{_solver_attributes('friction', make_motor_parameters(dt_s))}/>"
    )


def _write_geometries(
    make: Archetype, link: int, names: MeshPieceNames, dt_s: float
) -> Iterator[str]:
    for part, shape in make.shapes(link):
        found = find_geom_friction(part, is_static=make.is_static)
        touch = _contact_attributes(
            found.friction, found.priority, found.rows, make_rigid_parameters(dt_s)
        )
        rest = f"{_pose_attributes(shape.origin)} {touch}/>"
        if shape.mesh:
            for name in names[shape, make.is_static]:
                yield f'<geom type="mesh" mesh="{name}" {rest}'
        else:
            yield f'<geom type="{shape.kind}" size="{_join_numbers(_geom_size(shape))}" {rest}'


def _geom_size(shape: Shape) -> tuple[float, ...]:
    if shape.kind == "box":
        return tuple(extent / 2.0 for extent in shape.size)
    radius, length, _ = shape.size
    return (radius, length / 2.0) if shape.kind in CYLINDRICAL_KINDS else (radius,)


def _contact_attributes(friction: float, priority: int, rows: int, how: SolverParameters) -> str:
    return f'friction="{friction!r} 0 0" priority="{priority}" condim="{rows}" mass="0" {_solver_attributes("", how)}'


def _solver_attributes(what: str, how: SolverParameters) -> str:
    d = how.impedance
    return (
        f'solref{what}="{how.stiffness!r} {how.damping!r}" solimp{what}="{d!r} {d!r} 0.001 0.5 2"'
    )


def _pose_attributes(origin: Origin) -> str:
    x, y, z, w = origin.orientation
    return f'pos="{_join_numbers(origin.position)}" quat="{_join_numbers((w, x, y, z))}"'


def _join_numbers(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _write_exclusions(make: Archetype) -> Iterator[str]:
    """Keep the links of a slot apart that do not touch each other."""
    solid = [link for link in range(len(make.link_parts)) if any(True for _ in make.shapes(link))]
    for i, one in enumerate(solid):
        for other in solid[i + 1 :]:
            asks = make.self_collides[one] or make.self_collides[other]
            if (
                not asks
                or one == make.link_parts[other].parent
                or other == make.link_parts[one].parent
            ):
                yield f'<exclude body1="b{SLOT_PLACEHOLDER}.{one}" body2="b{SLOT_PLACEHOLDER}.{other}"/>'


def _write_mimic_equalities(make: Archetype, dt_s: float) -> Iterator[str]:
    index = {part.joint.name: link for link, part in enumerate(make.link_parts) if part.joint}
    for link in list_mimic_links(make):
        joint = make.link_parts[link].joint
        if joint is not None and joint.mimic is not None:
            yield (
                f'<joint joint1="j{SLOT_PLACEHOLDER}.{link}" joint2="j{SLOT_PLACEHOLDER}.{index[joint.mimic.joint]}" '
                f'polycoef="{joint.mimic.offset!r} {joint.mimic.multiplier!r} 0 0 0" '
                f"{_solver_attributes('', make_rigid_parameters(dt_s))}/>"
            )


@dataclass(frozen=True)
class ModelLayout:
    """Where the slots of a cast are.

    Attributes:
        firsts: Where the first slot of all begins.
        begins: Where the first slot of each make begins.
        layouts: What is where in a slot of each make.
        parts: The part of each geometry of a slot.
    """

    slot_counts: SlotCounts
    first_slot: SlotSizes
    start: Mapping[Archetype, SlotSizes]
    layouts: Mapping[Archetype, SlotLayout]
    parts: Mapping[Archetype, tuple[RigidPart, ...]]

    def address(self, make: Archetype, slot: int) -> SlotAddress:
        """Find where a slot is."""
        layout = self.layouts[make]
        return SlotAddress(self.start[make] + layout.sizes.times(slot), layout, not make.is_static)

    def addresses(self) -> Iterator[tuple[Archetype, SlotAddress]]:
        """List all slots."""
        for make, count in self.slot_counts:
            for slot in range(count):
                yield make, self.address(make, slot)

    def heights(self) -> IndexArray:
        """List where in qpos the heights of all roots are that move."""
        found = [
            self.start[make].positions + 2 + self.layouts[make].sizes.positions * np.arange(count)
            for make, count in self.slot_counts
            if not make.is_static
        ]
        return np.concatenate([np.zeros(0, np.intp), *found])

    def invalid_inertias(self) -> Iterator[tuple[int, FloatArray]]:
        """List bodies with moments that no solid could have: MuJoCo makes others of them."""
        for make, seat in self.addresses():
            for link, part in enumerate(make.link_parts):
                moments = np.maximum(part.inertia, MIN_INERTIA)
                if 2.0 * moments.max() > moments.sum():
                    yield seat.start.bodies + seat.layout.bodies[link], moments

    def soft_geometries(self) -> Iterator[tuple[int, RigidPart]]:
        """List geometries that are not rigid."""
        for make, seat in self.addresses():
            for offset, part in enumerate(self.parts[make]):
                if part.contact.stiffness > 0.0:
                    yield seat.start.geometries + offset, part


def make_model_layout(cast: SlotCounts, config: EngineConfig, pieces: LoadPieces) -> ModelLayout:
    """Find where MuJoCo puts the slots of a cast, by the order of its text."""
    at = firsts = SlotSizes(bodies=1, geometries=int(config.has_ground))
    begins, layouts, parts = {}, {}, {}
    for make, count in cast:
        parts[make] = tuple(list_geometry_parts(make, pieces))
        layouts[make] = make_slot_layout(make, len(parts[make]))
        begins[make] = at
        at += layouts[make].sizes.times(count)
    return ModelLayout(cast, firsts, begins, layouts, parts)
