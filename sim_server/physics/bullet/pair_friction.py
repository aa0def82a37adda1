"""Frictions of pairs in Bullet, which multiplies: collision filters that leave the lesser.

A static body with a friction below 1 has a copy for each friction of moving surfaces, with the
quotient as its own friction. A loose body with another friction than 0 and 1 has its shapes twice,
the second time as a twin: with a friction below 1 it meets twins only, by the root of the friction;
with one above 1 it meets what moves, by a friction of 1 (ADR 127).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from zensim.proto.messages.model_messages import ZERO
from zensim.sim_server.physics.blueprint import Blueprint, RigidPart

CollisionFilter = tuple[int, int]
"""Group and mask of Bullet: two surfaces collide if the group of each is in the other's mask."""
COMMON_GROUP, STATIC_GROUP = 1, 2
COLLIDE_WITH_NOTHING: CollisionFilter = (0, 0)
COLLIDE_WITH_ALL: CollisionFilter = (COMMON_GROUP, -1)
STATIC_FILTER: CollisionFilter = (STATIC_GROUP, ~STATIC_GROUP)
OTHER_BITS, PAIRED_BITS = range(2, 15), range(15, 29)
"""Groups of moving surfaces by friction: those without and with a twin."""
PAIRED_GROUP, TWIN_GROUP = 1 << 29, 1 << 30
NOT_PAIRED = ~(PAIRED_GROUP | sum(1 << bit for bit in PAIRED_BITS))
TWIN_FILTER: CollisionFilter = (TWIN_GROUP, TWIN_GROUP)
GRIPPING_TWIN_FILTER: CollisionFilter = (COMMON_GROUP, ~STATIC_GROUP)
NEUTRAL_FRICTIONS = (0.0, 1.0)
"""Coefficients whose products are the lesser one, or the other's own."""


class MovingSurface(NamedTuple):
    """Collisions of a part that moves.

    Attributes:
        part: Bullet's number; the root is -1.
        is_twin: Whether it is one.
        is_paired: Whether it has a twin.
    """

    part: int
    friction: float
    is_twin: bool
    is_paired: bool


def add_twin_surfaces(blueprint: Blueprint) -> Blueprint:
    """Add the twins of a loose body; not of surfaces with two frictions."""
    if not is_loose(blueprint):
        return blueprint
    twins = [
        replace(
            part,
            mass_kg=0.0,
            com=ZERO,
            friction=min(math.sqrt(part.friction), 1.0),
            parent=i if part.joint is None and part.parent < 0 else part.parent,
            joint=None,
            is_twin=True,
        )
        for i, part in enumerate(blueprint.parts)
        if _is_paired(part)
    ]
    return replace(blueprint, parts=(*blueprint.parts, *twins))


def is_loose(blueprint: Blueprint) -> bool:
    """Whether a body is a single link that moves."""
    return not blueprint.is_static and len(blueprint.links) == 1


def _is_paired(part: RigidPart) -> bool:
    is_neutral = part.friction in NEUTRAL_FRICTIONS
    return bool(part.shapes) and not is_neutral and part.contact.direction == ZERO


def find_moving_parts(blueprint: Blueprint) -> tuple[bool, ...]:
    """Find which parts of a body can move."""
    moves: list[bool] = []
    for part in blueprint.parts:
        is_carried = not blueprint.is_static if part.parent < 0 else moves[part.parent]
        moves.append(is_carried or part.joint_kind != "fixed")
    return tuple(moves)


def list_moving_surfaces(blueprint: Blueprint) -> tuple[MovingSurface, ...]:
    """List the surfaces of a body that move."""
    loose = is_loose(blueprint)
    most = 1.0 if blueprint.is_static else math.inf  # see `limit_static_body_friction`
    moving = enumerate(zip(blueprint.parts, find_moving_parts(blueprint), strict=True), start=-1)
    return tuple(
        MovingSurface(
            number,
            min(max(part.friction, part.contact.friction_across), most),
            part.is_twin,
            loose and not part.is_twin and _is_paired(part),
        )
        for number, (part, moves) in moving
        if moves and part.shapes
    )


def list_slippery_surfaces(blueprint: Blueprint) -> tuple[tuple[int, float], ...]:
    """List the surfaces with a friction below 1 of a body that never moves, by Bullet's number."""
    if any(find_moving_parts(blueprint)):
        return ()
    parts = enumerate(blueprint.parts, start=-1)
    return tuple(
        (number, part.friction) for number, part in parts if part.shapes and part.friction < 1.0
    )


def find_copy_friction(friction: float, moving: float) -> float:
    """Find the friction of a static surface whose product with a moving one is the lesser."""
    return min(1.0, friction / moving)


class FrictionGroups:
    """The group of each friction of moving surfaces; surfaces beyond the last are common."""

    def __init__(self) -> None:
        self._groups: dict[tuple[float, bool], int] = {}

    def list_frictions(self) -> dict[int, float]:
        """List the friction of each group in use."""
        return {group: friction for (friction, _), group in self._groups.items()}

    def add(self, surfaces: Iterable[MovingSurface]) -> Mapping[int, float]:
        """Assign groups to surfaces; return the new ones."""
        known = len(self._groups)
        for surface in surfaces:
            self._assign(surface)
        return dict(list(self.list_frictions().items())[known:])

    def find_filter(self, surface: MovingSurface) -> CollisionFilter:
        """Find the filter of a moving surface."""
        if surface.is_twin:
            return TWIN_FILTER if surface.friction < 1.0 else GRIPPING_TWIN_FILTER
        group = self._groups.get((surface.friction, surface.is_paired), 0)
        if surface.is_paired and surface.friction < 1.0:
            return group or PAIRED_GROUP, NOT_PAIRED
        return group or COMMON_GROUP, STATIC_GROUP if surface.is_paired else -1

    def _assign(self, surface: MovingSurface) -> None:
        key = surface.friction, surface.is_paired
        if surface.is_twin or surface.friction in NEUTRAL_FRICTIONS or key in self._groups:
            return
        bits = PAIRED_BITS if surface.is_paired else OTHER_BITS
        used = sum(is_paired == surface.is_paired for _, is_paired in self._groups)
        if used < len(bits):
            self._groups[key] = 1 << bits[used]


@dataclass
class SlipperyBodies:
    """Static bodies with a friction below 1, by number, and their copies.

    Attributes:
        groups: Of the moving surfaces that they may meet.
        surfaces: Their parts and frictions; see `list_slippery_surfaces`.
        copies: Number of each copy, by the group that it carries.
        originals: Body of each copy.
    """

    groups: FrictionGroups = field(default_factory=FrictionGroups)
    surfaces: dict[int, tuple[tuple[int, float], ...]] = field(default_factory=dict)
    copies: dict[int, dict[int, int]] = field(default_factory=dict)
    originals: dict[int, int] = field(default_factory=dict)

    def find_original(self, body: int) -> int:
        """Find the body of a copy; any other body is its own."""
        return self.originals.get(body, body)

    def list_copies(self, body: int) -> list[int]:
        """List the copies of a body."""
        return list(self.copies.get(body, {}).values())

    def forget(self, body: int) -> list[int]:
        """Forget a body; return its copies."""
        self.surfaces.pop(body, None)
        copies = list(self.copies.pop(body, {}).values())
        for copied in copies:
            del self.originals[copied]
        return copies
