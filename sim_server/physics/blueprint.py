"""A Model as an engine builds it: a part per link, and one for each further surface on it.

Engines keep one surface per part, but lumping may put a frictionless caster and a rubber foot on
one link: each further surface becomes a massless part fixed to the link.
"""

from dataclasses import dataclass, replace

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
from zensim.proto.rotation import from_matrix
from zensim.sim_server.description.model_geometry import links_in_contact

DEFAULT_FRICTION = 1.0
OPPOSITE = 1.0 - 1e-12
MAX_SHAPES = 16
"""Of one part: Bullet passes over all further ones without a word."""


@dataclass(frozen=True)
class Part:
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
    parts: tuple[Part, ...]
    links: tuple[Link, ...]


def blueprint_of(model: Model) -> Blueprint:
    """Plan the parts of a model."""
    index = {link.name: i for i, link in enumerate(model.links)}
    joints: list[Joint | None] = [None, *model.joints]
    parts: list[Part] = []
    skins: list[Part] = []
    for i, (link, joint) in enumerate(zip(links_in_contact(model), joints, strict=True)):
        bone, *others = _by_surface(link)
        parent = -1 if joint is None else index[joint.parent]
        parts.append(_part(link.inertial, bone, parent, link=i, joint=joint))
        skins.extend(_skin(surface, i) for surface in others)
    return Blueprint(model.name, model.is_static, (*parts, *skins), model.links)


def _by_surface(link: Link) -> list[tuple[Shape, ...]]:
    groups: dict[tuple[float, Contact], list[Shape]] = {}
    for shape in link.collisions:
        groups.setdefault((shape.friction, shape.contact), []).append(shape)
    alike = [part for group in groups.values() for part in _of_few_shapes(group)]
    # A direction needs axes of its own, which the link's inertia has not.
    if not alike or alike[0][0].contact.direction != ZERO:
        alike.insert(0, ())
    return alike


def _of_few_shapes(group: list[Shape]) -> list[tuple[Shape, ...]]:
    return [tuple(group[at : at + MAX_SHAPES]) for at in range(0, len(group), MAX_SHAPES)]


def _part(
    inertial: Inertial, shapes: tuple[Shape, ...], parent: int, *, link: int, joint: Joint | None
) -> Part:
    diagonal, principal = principal_axes(inertial.inertia)
    friction = shapes[0].friction if shapes else DEFAULT_FRICTION
    contact = shapes[0].contact if shapes else Contact()
    return Part(
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


def _skin(shapes: tuple[Shape, ...], link: int) -> Part:
    skin = _part(Inertial(), shapes, link, link=link, joint=None)
    direction = skin.contact.direction
    return skin if direction == ZERO else replace(skin, principal=_turn_to(direction))


def _turn_to(direction: Vec3) -> Quat:
    """Find a turn that takes x to a unit vector."""
    x, y, z = direction
    if x < -OPPOSITE:
        return (0.0, 0.0, 1.0, 0.0)
    turn = np.array([0.0, -z, y, 1.0 + x])
    qx, qy, qz, qw = (turn / np.linalg.norm(turn)).tolist()
    return (qx, qy, qz, qw)


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
