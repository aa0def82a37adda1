"""Blueprints: a Model as the rigid parts that engines build, split, checked against what the engine supports, and cached."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

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
from zensim.proto.rigid_transforms import from_directions
from zensim.proto.se3 import from_matrix
from zensim.sim_server.description.model_geometry import links_in_contact
from zensim.sim_server.physics.engine import EngineRefused

DEFAULT_FRICTION = 1.0
X_AXIS: Vec3 = (1.0, 0.0, 0.0)
MAX_SHAPES_PER_PART = 16
"""Of one part: Bullet passes over all further ones without a word."""


@dataclass(frozen=True)
class RigidPart:
    """One rigid part.

    Attributes:
        principal: Orientation of the principal axes in the link frame.
        contact: Of its shapes; its direction, if any, is the first principal axis.
        parent: Index of the parent part; -1 for the root.
        link: Index of the link that it belongs to.
        joint: How it moves; None when fixed at its parent's frame.
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

    @property
    def joint_kind(self) -> str:
        """How it moves, as URDF calls it."""
        return self.joint.kind if self.joint else "fixed"

    @property
    def origin(self) -> Origin:
        """Where it is in its parent, its joint at zero."""
        return self.joint.origin if self.joint else Origin()


@dataclass(frozen=True)
class Blueprint:
    """Parts in building order: root, links as in `Model.joints`, then skins."""

    name: str
    is_static: bool
    parts: tuple[RigidPart, ...]
    links: tuple[Link, ...]


def make_blueprint(model: Model) -> Blueprint:
    """Plan the parts of a model."""
    index = {link.name: i for i, link in enumerate(model.links)}
    joints: list[Joint | None] = [None, *model.joints]
    parts: list[RigidPart] = []
    skins: list[RigidPart] = []
    for i, (link, joint) in enumerate(zip(links_in_contact(model), joints, strict=True)):
        bone, *others = _group_by_surface(link)
        parent = -1 if joint is None else index[joint.parent]
        parts.append(_make_part(link.inertial, bone, parent, link=i, joint=joint))
        skins.extend(_make_surface_part(surface, i) for surface in others)
    return Blueprint(model.name, model.is_static, (*parts, *skins), model.links)


def _group_by_surface(link: Link) -> list[tuple[Shape, ...]]:
    groups: dict[tuple[float, Contact], list[Shape]] = {}
    for shape in link.collisions:
        groups.setdefault((shape.friction, shape.contact), []).append(shape)
    alike = [part for group in groups.values() for part in _limit_shapes_per_part(group)]
    # A direction needs axes of its own, which the link's inertia has not.
    if not alike or alike[0][0].contact.direction != ZERO:
        alike.insert(0, ())
    return alike


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
    skin = _make_part(Inertial(), shapes, link, link=link, joint=None)
    direction = skin.contact.direction
    return (
        skin if direction == ZERO else replace(skin, principal=from_directions(X_AXIS, direction))
    )


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


def check_blueprint(
    blueprint: Blueprint,
    engine: str,
    *,
    max_parts: int,
    joint_kinds: Collection[str],
    shape_kinds: Collection[str],
) -> None:
    """Compare a blueprint with what an engine has.

    Raises:
        EngineRefused: It has too many parts, or a joint or a shape that the engine has not.
    """
    if (count := len(blueprint.parts)) > max_parts:
        raise EngineRefused(
            f"model '{blueprint.name}' has {count} parts: links, and further frictions on one; "
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
            f"model '{blueprint.name}': {what} '{kind}' is not supported by {engine} here; "
            f"use {', '.join(known)}"
        )


def check_mesh_files(name: str, parts: Iterable[RigidPart], folder: str) -> None:
    """Refuse a mesh of the model of this name whose file is not in the folder.

    Raises:
        EngineRefused: One is not.
    """
    for shape in (shape for part in parts for shape in part.shapes):
        if shape.mesh and not Path(folder, f"{shape.mesh}.stl").is_file():
            raise EngineRefused(
                f"model '{name}': collision shape '{shape.kind}' {shape.mesh[:80]!r} is "
                "not here; send it again, or use box, sphere, cylinder or capsule"
            )


ShapeKey = tuple[tuple[str, Vec3, Origin, str, bool], ...]


def make_shape_key(shapes: tuple[Shape, ...], *, is_static: bool) -> ShapeKey:
    """Say what an engine makes of shapes: parts of one key share it."""
    return tuple((s.kind, s.size, s.origin, s.mesh, is_static and bool(s.mesh)) for s in shapes)


def split_static_meshes(blueprint: Blueprint, *, max_parts: int) -> Blueprint:
    """Give each mesh of a static blueprint a part of its own, or a few when there are too many."""
    meshes = sum(len(_mesh_shapes(part)) for part in blueprint.parts)
    room = max_parts - len(blueprint.parts)
    if not blueprint.is_static or not meshes or room <= 0:
        return blueprint
    # Each part may have a remainder.
    few = -(-meshes // max(1, room - len(blueprint.parts)))
    parts = [replace(part, shapes=_non_mesh_shapes(part)) for part in blueprint.parts]
    skins = [
        _make_mesh_part(part, number, meshes)
        for number, part in enumerate(blueprint.parts)
        for meshes in _group_meshes(_mesh_shapes(part), few)
    ]
    return replace(blueprint, parts=(*parts, *skins))


def _mesh_shapes(part: RigidPart) -> tuple[Shape, ...]:
    return tuple(shape for shape in part.shapes if shape.mesh)


def _non_mesh_shapes(part: RigidPart) -> tuple[Shape, ...]:
    return tuple(shape for shape in part.shapes if not shape.mesh)


def _group_meshes(shapes: tuple[Shape, ...], few: int) -> list[tuple[Shape, ...]]:
    return [shapes[at : at + few] for at in range(0, len(shapes), few)]


def _make_mesh_part(part: RigidPart, number: int, meshes: tuple[Shape, ...]) -> RigidPart:
    is_skin = part.joint is None and part.parent >= 0
    return replace(
        part, mass_kg=0.0, shapes=meshes, parent=part.parent if is_skin else number, joint=None
    )


MIN_DAMPING_STEPS = 4.0
"""Damping in units of stiffness times step that pushes out a fifth of a depth in each step.

It is Bullet's own share for rigid contacts. With less damping a body that was put 2 cm into the
ground would jump out of it, by 1.2 m where stiff.
"""


class BlueprintCache:
    """Plans models for one engine."""

    def __init__(
        self,
        engine: str,
        *,
        max_parts: int,
        joint_kinds: Collection[str],
        shape_kinds: Collection[str],
    ) -> None:
        self._engine = engine
        self._max_parts = max_parts
        self._joint_kinds = joint_kinds
        self._shape_kinds = shape_kinds
        self._last: tuple[Model, Blueprint] | None = None

    def find(self, model: Model) -> Blueprint:
        """Plan a model, or find the plan again when it is the same object as the last.

        Raises:
            EngineRefused: The engine cannot build it.
        """
        if self._last is None or self._last[0] is not model:
            self._last = (model, self._make(model))
        return self._last[1]

    def _make(self, model: Model) -> Blueprint:
        plan = split_static_meshes(make_blueprint(model), max_parts=self._max_parts)
        check_blueprint(
            plan,
            self._engine,
            max_parts=self._max_parts,
            joint_kinds=self._joint_kinds,
            shape_kinds=self._shape_kinds,
        )
        return plan
