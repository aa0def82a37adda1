"""Blueprints: the rigid parts of a Model, split and checked for an engine."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import (
    IDENTITY,
    ZERO,
    Contact,
    Inertial,
    Joint,
    Link,
    Model,
    Origin,
    Quat,
    Shape,
    Vec3,
)
from zensim.proto.rigid_transforms import conjugate, from_directions, normalize, rotate
from zensim.proto.se3 import from_matrix
from zensim.proto.stl import read_corners
from zensim.sim_server.description.model_geometry import NO_MESHES, FindCorners
from zensim.sim_server.description.wheel_contacts import align_friction_to_axle, links_in_contact
from zensim.sim_server.physics.driven_wheels import find_driven_wheels
from zensim.sim_server.physics.engine import MIN_INERTIA, EngineRefused

DEFAULT_FRICTION = 1.0
X_AXIS: Vec3 = (1.0, 0.0, 0.0)
MIN_ALIGNMENT_COS = 0.9999
"""Cosine of the angle between a friction direction and a principal axis."""
NO_CORNERS: npt.NDArray[np.float64] = np.zeros((0, 3))
MAX_SHAPES_PER_PART = 16
"""Bullet ignores further shapes of a part without an error."""
ShapeKey = tuple[tuple[str, Vec3, Origin, str, bool], ...]
MAX_MESHES_PER_PART = 8
"""Meshes per part of a static blueprint: a part is built in one go, and each further part takes
time in each step."""
MIN_DAMPING_STEPS = 4.0
"""Least damping, in units of stiffness times step: corrects a fifth of a penetration in a step.

This is Bullet's share for rigid contacts. With less, a stiff body spawned 2 cm deep in the ground
jumps 1.2 m high.
"""


@dataclass(frozen=True)
class RigidPart:
    """A link, or further shapes that are fixed to one.

    Attributes:
        principal: Orientation of the principal axes in the link frame.
        contact: Of its shapes; a friction direction is along a principal axis.
        parent: Index of the parent part; -1 for the root.
        link: Index of its link.
        joint: To its parent; None when fixed at the parent's frame.
        reflected_inertia: Least moment about the joint's axis [kg m^2] of a driven wheel, which its
            geared motor reflects; 0 if not driven.
        is_twin: Whether it repeats the shapes of another part; see `pair_friction`.
    """

    mass_kg: float
    com: Vec3
    principal: Quat
    inertia: Vec3
    shapes: tuple[Shape, ...]
    friction: float
    contact: Contact
    parent: int
    link: int
    joint: Joint | None = None
    reflected_inertia: float = 0.0
    is_twin: bool = False

    @property
    def moments(self) -> Vec3:
        """Principal moments [kg m^2] as engines use them: those of 0 are the least."""
        x, y, z = (max(moment, MIN_INERTIA) for moment in self.inertia)
        return (x, y, z)

    @property
    def joint_kind(self) -> str:
        """Joint type in URDF."""
        return self.joint.kind if self.joint else "fixed"

    @property
    def origin(self) -> Origin:
        """Pose in the parent, with the joint at zero."""
        return self.joint.origin if self.joint else Origin()


@dataclass(frozen=True)
class Blueprint:
    """Parts of a model; parents precede children.

    Those of links as in `Model.links`, then further surfaces of links; see also
    `order_depth_first`.

    Attributes:
        drags: See `Model.drags`.
    """

    name: str
    is_static: bool
    parts: tuple[RigidPart, ...]
    links: tuple[Link, ...]
    drags: bool = False

    @cached_property
    def link_parts(self) -> tuple[int, ...]:
        """Index of the part of each link, in the order of `Model.links`."""
        parts = enumerate(self.parts)
        found = {part.link: i for i, part in parts if part.joint is not None or part.parent < 0}
        return tuple(found[link] for link in range(len(self.links)))

    @cached_property
    def has_driven_wheels(self) -> bool:
        """Whether a part reflects the inertia of a motor."""
        return any(part.reflected_inertia > 0.0 for part in self.parts)

    @property
    def mass_kg(self) -> float:
        """Mass of all parts."""
        return sum(part.mass_kg for part in self.parts)


def make_blueprint(model: Model, corners: FindCorners = NO_MESHES) -> Blueprint:
    """Make the parts of a model.

    Args:
        model: To build.
        corners: Needed for driven wheels with meshes.
    """
    links = links_in_contact(model, corners)
    wheels = {wheel.link: wheel for wheel in find_driven_wheels(model, links, corners)}
    index = {link.name: i for i, link in enumerate(model.links)}
    joints: list[Joint | None] = [None, *model.joints]
    parts: list[RigidPart] = []
    surfaces: list[RigidPart] = []
    for i, (link, joint) in enumerate(zip(links, joints, strict=True)):
        shapes, *others = _group_by_surface(align_friction_to_axle(link, joint))
        parent = -1 if joint is None else index[joint.parent]
        part = _make_part(link.inertial, shapes, parent, link=i, joint=joint)
        inertia = wheels[i].reflected_inertia if i in wheels else 0.0
        parts.append(replace(part, reflected_inertia=inertia))
        surfaces.extend(_make_surface_part(group, i) for group in others)
    return Blueprint(model.name, model.is_static, (*parts, *surfaces), model.links, model.drags)


def _group_by_surface(link: Link) -> list[tuple[Shape, ...]]:
    groups: dict[tuple[float, Contact], list[Shape]] = {}
    for shape in link.collisions:
        groups.setdefault((shape.friction, shape.contact), []).append(shape)
    found = [part for group in groups.values() for part in _limit_shapes_per_part(group)]
    # The shapes of a part share its principal axes, along one of which a friction direction is.
    if not found or not _fits_principal_axes(link.inertial, found[0][0].contact.direction):
        found.insert(0, ())
    return found


def _fits_principal_axes(inertial: Inertial, direction: Vec3) -> bool:
    part = _make_part(inertial, (), -1, link=0, joint=None)
    return direction == ZERO or find_nearest_principal_axis(part, direction)[1] > MIN_ALIGNMENT_COS


def _limit_shapes_per_part(group: list[Shape]) -> list[tuple[Shape, ...]]:
    return [
        tuple(group[at : at + MAX_SHAPES_PER_PART])
        for at in range(0, len(group), MAX_SHAPES_PER_PART)
    ]


def _make_part(
    inertial: Inertial, shapes: tuple[Shape, ...], parent: int, *, link: int, joint: Joint | None
) -> RigidPart:
    diagonal, principal = find_principal_axes(inertial.inertia)
    friction = shapes[0].friction if shapes else DEFAULT_FRICTION
    contact = shapes[0].contact if shapes else Contact()
    return RigidPart(
        mass_kg=inertial.mass_kg,
        com=inertial.com_in_link,
        principal=principal,
        inertia=diagonal,
        shapes=shapes,
        friction=friction,
        contact=contact,
        parent=parent,
        link=link,
        joint=joint,
    )


def _make_surface_part(shapes: tuple[Shape, ...], link: int) -> RigidPart:
    part = _make_part(Inertial(), shapes, link, link=link, joint=None)
    direction = part.contact.direction
    if direction == ZERO:
        return part
    return replace(part, principal=from_directions(X_AXIS, direction))


def find_principal_axes(inertia: tuple[float, ...]) -> tuple[Vec3, Quat]:
    """Find principal moments and axes of (ixx, ixy, ixz, iyy, iyz, izz)."""
    ixx, ixy, ixz, iyy, iyz, izz = inertia
    if ixy == ixz == iyz == 0.0:
        return (ixx, iyy, izz), IDENTITY
    moments, axes = np.linalg.eigh(np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]))
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    mx, my, mz = moments.tolist()
    x, y, z, w = from_matrix(axes).tolist()
    return (mx, my, mz), (x, y, z, w)


def order_depth_first(blueprint: Blueprint) -> Blueprint:
    """Order the parts depth first, as Bullet numbers them; siblings stay in their order."""
    children: dict[int, list[int]] = {}
    for i, part in enumerate(blueprint.parts):
        children.setdefault(part.parent, []).append(i)
    order: list[int] = []
    pending = children[-1][::-1]
    while pending:
        order.append(at := pending.pop())
        pending.extend(children.get(at, [])[::-1])
    place = {old: new for new, old in enumerate(order)} | {-1: -1}
    parts = (blueprint.parts[old] for old in order)
    return replace(
        blueprint, parts=tuple(replace(part, parent=place[part.parent]) for part in parts)
    )


def find_nearest_principal_axis(part: RigidPart, direction: Vec3) -> tuple[int, float]:
    """Find the principal axis of a part next to a direction, and the cosine of the angle to it."""
    in_principal = rotate(conjugate(part.principal), normalize(direction))
    cosines = [abs(share) for share in in_principal]
    return cosines.index(max(cosines)), max(cosines)


def check_blueprint(
    blueprint: Blueprint,
    engine: str,
    *,
    max_parts: int,
    joint_kinds: Collection[str],
    shape_kinds: Collection[str],
) -> None:
    """Check that an engine supports a blueprint.

    Raises:
        EngineRefused: It has too many parts, or an unsupported joint or shape.
    """
    if (count := len(blueprint.parts)) > max_parts:
        raise EngineRefused(
            f"model '{blueprint.name}' has {count} parts (links, and further surfaces of links); "
            f"use at most {max_parts}"
        )
    for part in blueprint.parts:
        _check_kind_supported(blueprint, engine, "joint", part.joint_kind, joint_kinds)
        for shape in part.shapes:
            _check_kind_supported(blueprint, engine, "collision shape", shape.kind, shape_kinds)


def _check_kind_supported(
    blueprint: Blueprint, engine: str, what: str, kind: str, known: Collection[str]
) -> None:
    if kind not in known:
        raise EngineRefused(
            f"model '{blueprint.name}': {what} '{kind}' is not supported by {engine}; "
            f"use {', '.join(known)}"
        )


def check_mesh_files(name: str, parts: Iterable[RigidPart], folder: str) -> None:
    """Check that the mesh files of a model are in the folder.

    Raises:
        EngineRefused: One is missing.
    """
    # Many shapes of a world share a mesh.
    shapes = {shape.mesh: shape for part in parts for shape in part.shapes if shape.mesh}
    for shape in shapes.values():
        if not Path(folder, f"{shape.mesh}.stl").is_file():
            raise EngineRefused(
                f"model '{name}': collision shape '{shape.kind}' {shape.mesh[:80]!r} is "
                "missing; send it again, or use box, sphere, cylinder or capsule"
            )


def load_corners(folder: str, mesh: str) -> npt.NDArray[np.float64]:
    """Load the corners (n, 3) of a `Shape.mesh` from a folder; none if its file is missing."""
    path = Path(folder, f"{mesh}.stl")
    return _read_corners(path) if path.is_file() else NO_CORNERS


@lru_cache(maxsize=64)
def _read_corners(path: Path) -> npt.NDArray[np.float64]:
    # Files are named by their content, so that they never change.
    return read_corners(path.read_bytes()).astype(np.float64)


def make_shape_key(shapes: tuple[Shape, ...], *, is_static: bool) -> ShapeKey:
    """Make the cache key of the collision shape that an engine builds of shapes."""
    return tuple((s.kind, s.size, s.origin, s.mesh, is_static and bool(s.mesh)) for s in shapes)


def split_static_meshes(blueprint: Blueprint, *, max_parts: int) -> Blueprint:
    """Give the meshes of a static blueprint parts of their own if they are many."""
    meshes = sum(len(_mesh_shapes(part)) for part in blueprint.parts)
    room = max_parts - len(blueprint.parts)
    if not blueprint.is_static or meshes <= MAX_MESHES_PER_PART or room <= 0:
        return blueprint
    # Rounding up may add one group for each part.
    group_size = max(MAX_MESHES_PER_PART, -(-meshes // max(1, room - len(blueprint.parts))))
    parts = [
        replace(part, shapes=tuple(shape for shape in part.shapes if not shape.mesh))
        for part in blueprint.parts
    ]
    mesh_parts = [
        _make_mesh_part(part, number, meshes)
        for number, part in enumerate(blueprint.parts)
        for meshes in _group_meshes(_mesh_shapes(part), group_size)
    ]
    return replace(blueprint, parts=(*parts, *mesh_parts))


def _mesh_shapes(part: RigidPart) -> tuple[Shape, ...]:
    return tuple(shape for shape in part.shapes if shape.mesh)


def _group_meshes(shapes: tuple[Shape, ...], size: int) -> list[tuple[Shape, ...]]:
    return [shapes[at : at + size] for at in range(0, len(shapes), size)]


def _make_mesh_part(part: RigidPart, number: int, meshes: tuple[Shape, ...]) -> RigidPart:
    is_surface = part.joint is None and part.parent >= 0
    return replace(
        part, mass_kg=0.0, shapes=meshes, parent=part.parent if is_surface else number, joint=None
    )


class BlueprintCache:
    """Blueprints for one engine; caches the last."""

    def __init__(
        self,
        engine: str,
        *,
        max_parts: int,
        joint_kinds: Collection[str],
        shape_kinds: Collection[str],
        mesh_folder: str = "",
        arrange: Callable[[Blueprint], Blueprint] | None = None,
    ) -> None:
        """Make an empty cache.

        Args:
            engine: Its name.
            max_parts: Of a blueprint.
            joint_kinds: That the engine supports.
            shape_kinds: That the engine supports.
            mesh_folder: With `<Shape.mesh>.stl`.
            arrange: Orders the parts; None = they stay as they are.
        """
        self._arrange = arrange
        self._mesh_folder = mesh_folder
        self._engine = engine
        self._max_parts = max_parts
        self._joint_kinds = joint_kinds
        self._shape_kinds = shape_kinds
        self._last: tuple[Model, Blueprint] | None = None

    def find(self, model: Model) -> Blueprint:
        """Find the blueprint of a model; cached while the model is the same object.

        Raises:
            EngineRefused: The engine cannot build it.
        """
        if self._last is None or self._last[0] is not model:
            self._last = (model, self._make(model))
        return self._last[1]

    def _make(self, model: Model) -> Blueprint:
        found = make_blueprint(model, partial(load_corners, self._mesh_folder))
        blueprint = split_static_meshes(found, max_parts=self._max_parts)
        if self._arrange is not None:
            blueprint = self._arrange(blueprint)
        check_blueprint(
            blueprint,
            self._engine,
            max_parts=self._max_parts,
            joint_kinds=self._joint_kinds,
            shape_kinds=self._shape_kinds,
        )
        return blueprint
