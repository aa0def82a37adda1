"""MJCF text of a world with slots, and the layout of its compiled model (ADR 38)."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import LIMITED_KINDS, TURNING_KINDS, Origin, Shape, Vec3
from zensim.proto.se3 import conjugate, rotate
from zensim.sim_server.physics.blueprint import RigidPart
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.convex_pieces import HullPoints
from zensim.sim_server.physics.mujoco.mujoco_contact import (
    MAX_IMPEDANCE,
    GeomFriction,
    SolverParameters,
    find_geom_friction,
    make_geom_friction,
    make_motor_parameters,
    make_rigid_parameters,
)
from zensim.sim_server.physics.mujoco.slot_layout import (
    NO_INDEX,
    Archetype,
    SlotAddress,
    SlotCounts,
    SlotLayout,
    SlotSizes,
    list_mimic_links,
    make_slot_layout,
)

LoadPieces = Callable[[Shape, bool], Sequence[HullPoints]]
"""Finds the convex pieces of a mesh, scaled; the flag is whether it is static."""
IMPRATIO = 30.0
"""Ratio of frictional to normal constraint impedance: friction yields by a thousandth."""
MIN_JOINT_RANGE = 1e-6
"""Least range of a joint with equal limits [rad or m]."""
STOP_IMPEDANCE = 0.999
"""d of limits of joints: 200 N m push a link of 0.03 kg m^2 by 1 mrad beyond, at 240 Hz."""
SLOT_PLACEHOLDER = "@"
"""Placeholder of the slot number in the text of a slot."""
SUPPORTED_JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed")
SUPPORTED_SHAPE_KINDS = ("box", "sphere", "cylinder", "capsule", "mesh")
MAX_PARTS = 256
CARRIED_MOMENT_SHARE = 0.03
"""Least moment of a link about its joint, over the greatest moment of the links that it carries."""
BALANCED_MOMENT_SHARE = 0.3
"""The same where all that it carries has its centre of mass at the joint, as casters have."""
BALANCED_ARM_SHARE = 0.1
"""Greatest distance of such a centre from the joint, over the radius of gyration."""
FEATHER_DAMPING_HZ = 1.0
"""Damping of the joint of a link below that share, over the same greatest moment."""
WHEEL_STIFFNESS_PER_KG = 98100.0
"""Least contact stiffness [N/m] of a driven wheel per mass of its robot: 0.1 mm under its weight.

Softer wheels beside rigid casters carry nothing, and have no grip.
"""
SCENERY_GEOMETRIES = 64
"""Geometries from which a static archetype is a model of its own, which is attached to the world.

MuJoCo's reader needs time with the square of the geometries of a model.
"""
COMPILER = '<compiler angle="radian" balanceinertia="true" boundmass="0"/>'
CYLINDRICAL_KINDS = ("cylinder", "capsule")


class MjcfText(NamedTuple):
    """A model, and the models that it refers to, by the names of their files."""

    text: str
    files: dict[str, bytes]


def write_mjcf(
    slots: Iterable[tuple[Archetype, int]], config: EngineConfig, pieces: LoadPieces
) -> MjcfText:
    """Write a world with its ground and a number of slots of each archetype."""
    slots = list(slots)
    is_large = [is_large_scenery(archetype, pieces) for archetype, _ in slots]
    small = [slot[0] for slot, one in zip(slots, is_large, strict=True) if not one]
    assets, names = _write_meshes(small, pieces)
    world, exclusions, equalities = [_write_ground(config)], [""], [""]
    files: dict[str, bytes] = {}
    number = 0
    for (archetype, count), is_file in zip(slots, is_large, strict=True):
        if is_file:
            name = f"s{number}.xml"
            files[name] = _write_scenery(archetype, count, config, pieces).encode()
            assets.append(f'<model name="{name}" file="{name}"/>')
            world.append(f'<attach model="{name}" prefix="s{number}-"/>')
            number += count
            continue
        texts = (
            _write_body(archetype, 0, names, config.step_ns * 1e-9),
            "".join(_write_exclusions(archetype)),
            "".join(_write_mimic_equalities(archetype, config.step_ns * 1e-9)),
        )
        for _ in range(count):
            for section, text in zip((world, exclusions, equalities), texts, strict=True):
                section.append(text.replace(SLOT_PLACEHOLDER, str(number)))
            number += 1
    integrator = _choose_integrator(archetype for archetype, count in slots if count)
    text = (
        f"<mujoco>{COMPILER}"
        f'<option timestep="{config.step_ns * 1e-9!r}" gravity="{_join_numbers(config.gravity)}" '
        f'integrator="{integrator}" cone="elliptic" jacobian="sparse" impratio="{IMPRATIO}">'
        # Warm starts are accepted for all islands or for none, so robots would affect each other.
        '<flag autoreset="disable" warmstart="disable"/></option>'
        f"<asset>{''.join(assets)}</asset><worldbody>{''.join(world)}</worldbody>"
        f"<contact>{''.join(exclusions)}</contact>"
        f"<equality>{''.join(equalities)}</equality></mujoco>"
    )
    return MjcfText(text, files)


def is_large_scenery(archetype: Archetype, pieces: LoadPieces) -> bool:
    """Whether an archetype has many geometries, and nothing that moves."""
    if not archetype.is_static or any(
        part.joint_kind != "fixed" for part in archetype.link_parts[1:]
    ):
        return False
    shapes = (shape for part in archetype.parts for shape in part.shapes)
    count = sum(len(pieces(shape, archetype.is_static)) if shape.mesh else 1 for shape in shapes)
    return count >= SCENERY_GEOMETRIES


def _write_scenery(
    archetype: Archetype, count: int, config: EngineConfig, pieces: LoadPieces
) -> str:
    """Write a model of the slots of one archetype; its bodies need no names."""
    assets, names = _write_meshes([archetype], pieces)
    body = _write_body(archetype, 0, names, config.step_ns * 1e-9)
    return (
        f"<mujoco>{COMPILER}<asset>{''.join(assets)}</asset><worldbody>"
        f'<replicate count="{count}" sep="-">{body}</replicate></worldbody></mujoco>'
    )


MeshKey = tuple[str, Vec3, bool]
"""Name and scale of a mesh, and whether its body is static."""
MeshPieceNames = dict[MeshKey, list[str]]


def _make_mesh_key(shape: Shape, archetype: Archetype) -> MeshKey:
    return shape.mesh, shape.size, archetype.is_static


def _write_meshes(
    archetypes: Iterable[Archetype], pieces: LoadPieces
) -> tuple[list[str], MeshPieceNames]:
    """Write each mesh once; return the text and the names of the pieces of each."""
    texts: list[str] = []
    names: MeshPieceNames = {}
    for archetype in archetypes:
        for shape in (shape for part in archetype.parts for shape in part.shapes if shape.mesh):
            key = _make_mesh_key(shape, archetype)
            if key in names:
                continue
            names[key] = []
            for points in pieces(shape, archetype.is_static):
                names[key].append(name := f"m{len(texts)}")
                texts.append(
                    f'<mesh name="{name}" inertia="convex" '
                    f'vertex="{_join_numbers(points.ravel().tolist())}"/>'
                )
    return texts, names


def list_geometry_parts(archetype: Archetype, pieces: LoadPieces) -> list[RigidPart]:
    """List the part of each geometry of a slot, in MuJoCo's order."""
    parts: list[RigidPart] = []

    def visit(link: int) -> None:
        for part, shape in archetype.shapes(link):
            parts.extend([part] * (len(pieces(shape, archetype.is_static)) if shape.mesh else 1))
        for child in archetype.children(link):
            visit(child)

    visit(0)
    return parts


def _write_ground(config: EngineConfig) -> str:
    if not config.has_ground:
        return ""
    friction = make_geom_friction(config.ground_friction, is_static=True)
    contact = _contact_attributes(friction, make_rigid_parameters(config.step_ns * 1e-9))
    return f'<geom type="plane" size="0 0 1" {contact}/>'


def _write_body(archetype: Archetype, link: int, names: MeshPieceNames, dt_s: float) -> str:
    part = archetype.link_parts[link]
    children = [_write_inertial(part)]
    if link:
        children.append(_write_joint(archetype, link, dt_s))
    elif not archetype.is_static:
        children.append("<freejoint/>")
    children.extend(_write_geometries(archetype, link, names, dt_s))
    children.extend(
        _write_body(archetype, child, names, dt_s) for child in archetype.children(link)
    )
    # MuJoCo ignores body_gravcomp set later if no body has it when compiled.
    return (
        f'<body name="b{SLOT_PLACEHOLDER}.{link}" gravcomp="1" {_pose_attributes(part.origin)}>'
        f"{''.join(children)}</body>"
    )


def _write_inertial(part: RigidPart) -> str:
    pose = _pose_attributes(Origin(part.com, part.principal))
    mass = max(part.mass_kg, MIN_MASS_KG)
    return f'<inertial {pose} mass="{mass!r}" diaginertia="{_join_numbers(part.moments)}"/>'


def _write_joint(archetype: Archetype, link: int, dt_s: float) -> str:
    joint = archetype.link_parts[link].joint
    if joint is None or joint.kind == "fixed":
        return ""
    kind = "slide" if joint.kind == "prismatic" else "hinge"
    armature, least_damping = (
        (0.0, 0.0) if kind == "slide" else find_joint_inertia(archetype, link, joint.axis)
    )
    rigid, limits = make_rigid_parameters(dt_s, STOP_IMPEDANCE), ""
    if joint.kind != "continuous" and joint.lower <= joint.upper:
        upper = max(joint.upper, joint.lower + MIN_JOINT_RANGE)
        limits = (
            f'limited="true" range="{joint.lower!r} {upper!r}" '
            f"{_solver_attributes('limit', rigid)} "
        )
    return (
        f'<joint name="j{SLOT_PLACEHOLDER}.{link}" type="{kind}" '
        f'axis="{_join_numbers(joint.axis)}" {limits}'
        f'stiffness="{joint.spring_stiffness!r}" springref="{joint.spring_reference!r}" '
        f'armature="{armature!r}" '
        f'damping="{max(joint.damping, least_damping)!r}" frictionloss="{joint.friction!r}" '
        f"{_solver_attributes('friction', make_motor_parameters(dt_s))}/>"
    )


def find_joint_inertia(archetype: Archetype, link: int, axis: Vec3) -> tuple[float, float]:
    """Find the armature [kg m^2] and the least damping [N m s] of a turning joint.

    The armature is what the link's moment about the joint lacks of the least one. That of a driven
    wheel is what its motor reflects. That of a link without weight, as in a ball caster of three
    joints, is a share of what turns beyond it: without it, and some damping, the joints diverge
    where two of their axes meet. A caster that rolls needs a greater share than a pendulum, whose
    period it would change.
    """
    part = archetype.link_parts[link]
    carried = max((_find_moment(archetype, child) for child in archetype.children(link)), default=0)
    own = _find_moment_about(part, axis)
    is_feather = own < CARRIED_MOMENT_SHARE * carried
    is_rolling = is_feather and _carries_balanced(archetype, link)
    share = BALANCED_MOMENT_SHARE if is_rolling else CARRIED_MOMENT_SHARE
    least = max(part.reflected_inertia, share * carried)
    return max(0.0, least - own), FEATHER_DAMPING_HZ * carried * is_feather


def _choose_integrator(archetypes: Iterable[Archetype]) -> str:
    """Choose the faster integrator, or the other one, with which light rods do not spin up."""
    return "implicit" if any(map(_swings_lightly, archetypes)) else "implicitfast"


def _swings_lightly(archetype: Archetype) -> bool:
    """Whether a ball joint, which is three hinges at one place, carries what is not balanced."""
    light = {
        link
        for link, part in enumerate(archetype.link_parts)
        if part.joint is not None
        and part.joint.kind in TURNING_KINDS
        and find_joint_inertia(archetype, link, part.joint.axis)[1] > 0.0
    }
    return any(
        child in light and not any(archetype.link_parts[child].origin.position)
        for link in light
        for child in archetype.children(link)
        if not _carries_balanced(archetype, child)
    )


def _carries_balanced(archetype: Archetype, link: int) -> bool:
    return all(_is_balanced(archetype, one) for one in archetype.children(link))


def _is_balanced(archetype: Archetype, link: int) -> bool:
    """Find whether a link and those that turn beyond it have their centres of mass at its joint."""
    part = archetype.link_parts[link]
    reach = BALANCED_ARM_SHARE * math.sqrt(
        max(*part.inertia, MIN_INERTIA) / max(part.mass_kg, MIN_MASS_KG)
    )
    return math.hypot(*part.com) <= reach and all(
        not any(archetype.link_parts[one].origin.position) and _is_balanced(archetype, one)
        for one in archetype.children(link)
    )


def _find_moment_about(part: RigidPart, axis: Vec3) -> float:
    """Find the moment [kg m^2] of a part about a joint through its origin."""
    axle = np.array(axis) / np.linalg.norm(axis)
    moments = np.maximum(part.inertia, MIN_INERTIA)
    arm = np.cross(axle, part.com)
    turned = rotate(conjugate(np.array(part.principal)), axle)
    return float(turned**2 @ moments + part.mass_kg * arm @ arm)


def _find_moment(archetype: Archetype, link: int) -> float:
    """Find the greatest principal moment of a link and of those that turn beyond it."""
    beyond = (_find_moment(archetype, child) for child in archetype.children(link))
    return max(*archetype.link_parts[link].inertia, *beyond)


def _write_geometries(
    archetype: Archetype, link: int, names: MeshPieceNames, dt_s: float
) -> Iterator[str]:
    for part, shape in archetype.shapes(link):
        friction = find_geom_friction(part, is_static=archetype.is_static)
        contact = _contact_attributes(friction, make_rigid_parameters(dt_s))
        rest = f"{_pose_attributes(shape.origin)} {contact}/>"
        if shape.mesh:
            for name in names[_make_mesh_key(shape, archetype)]:
                yield f'<geom type="mesh" mesh="{name}" {rest}'
        else:
            yield f'<geom type="{shape.kind}" size="{_join_numbers(_geom_size(shape))}" {rest}'


def _geom_size(shape: Shape) -> tuple[float, ...]:
    if shape.kind == "box":
        return tuple(extent / 2.0 for extent in shape.size)
    radius, length, _ = shape.size
    return (radius, length / 2.0) if shape.kind in CYLINDRICAL_KINDS else (radius,)


def _contact_attributes(found: GeomFriction, solver: SolverParameters) -> str:
    return (
        f'friction="{found.friction!r} 0 0" priority="{found.priority}" condim="{found.rows}" '
        f'mass="0" {_solver_attributes("", solver)}'
    )


def _solver_attributes(suffix: str, solver: SolverParameters) -> str:
    d = solver.impedance
    return (
        f'solref{suffix}="{solver.stiffness!r} {solver.damping!r}" '
        f'solimp{suffix}="{d!r} {d!r} 0.001 0.5 2"'
    )


def _pose_attributes(origin: Origin) -> str:
    x, y, z, w = origin.orientation
    return f'pos="{_join_numbers(origin.position)}" quat="{_join_numbers((w, x, y, z))}"'


def _join_numbers(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _write_exclusions(archetype: Archetype) -> Iterator[str]:
    """Exclude contacts between links of a slot that do not collide."""
    solid = [
        link
        for link in range(len(archetype.link_parts))
        if any(True for _ in archetype.shapes(link))
    ]
    for i, one in enumerate(solid):
        for other in solid[i + 1 :]:
            is_enabled = archetype.self_collides[one] or archetype.self_collides[other]
            if (
                not is_enabled
                or one == archetype.link_parts[other].parent
                or other == archetype.link_parts[one].parent
            ):
                yield (
                    f'<exclude body1="b{SLOT_PLACEHOLDER}.{one}" '
                    f'body2="b{SLOT_PLACEHOLDER}.{other}"/>'
                )


def _write_mimic_equalities(archetype: Archetype, dt_s: float) -> Iterator[str]:
    index = {part.joint.name: link for link, part in enumerate(archetype.link_parts) if part.joint}
    # As compliant as contacts, a follower would sag by millimetres under the load of a mast.
    coupling = make_rigid_parameters(dt_s, MAX_IMPEDANCE)
    for link in list_mimic_links(archetype):
        joint = archetype.link_parts[link].joint
        if joint is not None and joint.mimic is not None:
            leader = index[joint.mimic.joint]
            yield (
                f'<joint joint1="j{SLOT_PLACEHOLDER}.{link}" joint2="j{SLOT_PLACEHOLDER}.{leader}" '
                f'polycoef="{joint.mimic.offset!r} {joint.mimic.multiplier!r} 0 0 0" '
                f"{_solver_attributes('', coupling)}/>"
            )


@dataclass(frozen=True)
class ModelLayout:
    """Where the slots of a compiled model are.

    Attributes:
        first_slot: Start of the first slot.
        start: Start of the first slot of each archetype.
        layouts: Layout of a slot of each archetype.
        parts: Part of each geometry of a slot of each archetype.
    """

    slot_counts: SlotCounts
    first_slot: SlotSizes
    start: Mapping[Archetype, SlotSizes]
    layouts: Mapping[Archetype, SlotLayout]
    parts: Mapping[Archetype, tuple[RigidPart, ...]]

    def address(self, archetype: Archetype, slot: int) -> SlotAddress:
        """Find the indexes of a slot."""
        layout = self.layouts[archetype]
        return SlotAddress(
            self.start[archetype] + layout.sizes.times(slot), layout, not archetype.is_static
        )

    def addresses(self) -> Iterator[tuple[Archetype, SlotAddress]]:
        """List all slots."""
        for archetype, count in self.slot_counts:
            for slot in range(count):
                yield archetype, self.address(archetype, slot)

    def invalid_inertias(self) -> Iterator[tuple[int, FloatArray]]:
        """List bodies with principal moments that no solid can have: MuJoCo changes them."""
        for archetype, address in self.addresses():
            for link, part in enumerate(archetype.link_parts):
                moments = np.maximum(part.inertia, MIN_INERTIA)
                if 2.0 * moments.max() > moments.sum():
                    yield address.start.bodies + address.layout.bodies[link], moments

    def limited_joints(self) -> Iterator[int]:
        """List the degrees of freedom of joints with limits: those of arms, lifts and grippers."""
        for archetype, address in self.addresses():
            for joint, part in enumerate(archetype.link_parts[1:]):
                index = address.joint_velocity(joint)
                if index != NO_INDEX and part.joint_kind in LIMITED_KINDS:
                    yield index

    def sprung_joints(self) -> Iterator[int]:
        """List the degrees of freedom with a spring."""
        for archetype, address in self.addresses():
            for joint, part in enumerate(archetype.link_parts[1:]):
                index = address.joint_velocity(joint)
                if index != NO_INDEX and part.joint and part.joint.spring_stiffness:
                    yield index

    def geometries(self) -> Iterator[tuple[int, RigidPart, float]]:
        """List the geometries of all slots, each with its part and the mass [kg] of its body."""
        for archetype, address in self.addresses():
            mass_kg = max(archetype.mass_kg, MIN_MASS_KG)
            for offset, part in enumerate(self.parts[archetype]):
                yield address.start.geometries + offset, part, mass_kg


def stiffen_wheel(part: RigidPart, archetype: Archetype) -> RigidPart:
    """Give the compliant contact of a driven wheel at least a stiffness that carries the robot."""
    if not (part.contact.stiffness and archetype.link_parts[part.link].reflected_inertia):
        return part
    stiffness = max(part.contact.stiffness, archetype.mass_kg * WHEEL_STIFFNESS_PER_KG)
    return replace(part, contact=msgspec.structs.replace(part.contact, stiffness=stiffness))


def make_model_layout(counts: SlotCounts, config: EngineConfig, pieces: LoadPieces) -> ModelLayout:
    """Find where MuJoCo puts slots, from the order of the MJCF text."""
    at = first_slot = SlotSizes(bodies=1, geometries=int(config.has_ground))
    start, layouts, parts = {}, {}, {}
    for archetype, count in counts:
        parts[archetype] = tuple(
            stiffen_wheel(part, archetype) for part in list_geometry_parts(archetype, pieces)
        )
        layouts[archetype] = make_slot_layout(archetype, len(parts[archetype]))
        start[archetype] = at
        at += layouts[archetype].sizes.times(count)
    return ModelLayout(counts, first_slot, start, layouts, parts)
