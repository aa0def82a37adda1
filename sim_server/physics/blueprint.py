"""A Model as an engine builds it: a part per link, and one per surface with a friction of its own.

Engines keep one friction per part, but lumping may put a frictionless caster and a rubber foot on
one link: each further friction becomes a massless part fixed to the link.
"""

from dataclasses import dataclass

import numpy as np

from proto.model import IDENTITY, Inertial, Joint, Link, Model, Origin, Quat, Shape, Vec3
from proto.rotation import from_matrix
from sim_server.description.rolling import touching_links

DEFAULT_FRICTION = 1.0
MAX_SHAPES = 16
"""Of one part: Bullet passes over all further ones without a word."""


@dataclass(frozen=True)
class Part:
    """One rigid part.

    Attributes:
        principal: Orientation of the principal axes in the link frame.
        parent: Index of the parent part; -1 for the root.
        joint: How it moves; None when fixed at its parent's frame.
    """

    mass_kg: float
    com: Vec3
    principal: Quat
    inertia: Vec3
    shapes: tuple[Shape, ...]
    friction: float
    parent: int
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
    parts: tuple[Part, ...]


def blueprint_of(model: Model) -> Blueprint:
    """Plan the parts of a model."""
    index = {link.name: i for i, link in enumerate(model.links)}
    joints: list[Joint | None] = [None, *model.joints]
    parts: list[Part] = []
    skins: list[Part] = []
    for i, (link, joint) in enumerate(zip(touching_links(model), joints, strict=True)):
        surfaces = _by_friction(link)
        parent = -1 if joint is None else index[joint.parent]
        parts.append(_part(link.inertial, surfaces[0], parent, joint))
        skins.extend(_part(Inertial(), surface, i, None) for surface in surfaces[1:])
    return Blueprint(model.name, model.is_static, (*parts, *skins))


def _by_friction(link: Link) -> list[tuple[Shape, ...]]:
    groups: dict[float, list[Shape]] = {}
    for shape in link.collisions:
        groups.setdefault(shape.friction, []).append(shape)
    return [part for group in groups.values() for part in _of_few_shapes(group)] or [()]


def _of_few_shapes(group: list[Shape]) -> list[tuple[Shape, ...]]:
    return [tuple(group[at : at + MAX_SHAPES]) for at in range(0, len(group), MAX_SHAPES)]


def _part(inertial: Inertial, shapes: tuple[Shape, ...], parent: int, joint: Joint | None) -> Part:
    diagonal, principal = principal_axes(inertial.inertia)
    friction = shapes[0].friction if shapes else DEFAULT_FRICTION
    return Part(
        inertial.mass_kg, inertial.com_in_link, principal, diagonal, shapes, friction, parent, joint
    )


def principal_axes(inertia: tuple[float, ...]) -> tuple[Vec3, Quat]:
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
