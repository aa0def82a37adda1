"""A make: what robots that are built alike share, and where MuJoCo puts its parts."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

from zensim.proto.messages.model_messages import Shape
from zensim.sim_server.physics.blueprint import Blueprint, Part

ROOT_POSITIONS, ROOT_VELOCITIES = 7, 6
"""Of a free root: place and quaternion w x y z; linear in the world, angular in the root."""
NONE = -1


@dataclass(frozen=True)
class Make:
    """A blueprint without its name; what its motors and loads are is of each robot.

    Attributes:
        parts: In building order; the first are those of the links.
        self_collides: Of each link.
    """

    parts: tuple[Part, ...]
    self_collides: tuple[bool, ...]
    is_static: bool

    def __hash__(self) -> int:
        """Hash it once: it is what casts are known by."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.parts, self.self_collides, self.is_static))

    @property
    def bones(self) -> tuple[Part, ...]:
        """The part of each link; further parts are only more shapes of a link."""
        return self.parts[: len(self.self_collides)]

    def children(self, link: int) -> Iterator[int]:
        """List the links that a link carries."""
        return (i for i, part in enumerate(self.bones) if part.parent == link and i)

    def shapes(self, link: int) -> Iterator[tuple[Part, Shape]]:
        """List what a link touches with."""
        for part in self.parts:
            if part.link == link:
                for shape in part.shapes:
                    yield part, shape


def make_of(blueprint: Blueprint) -> Make:
    """Leave out what robots of one make may differ in."""
    self_collides = tuple(link.self_collides for link in blueprint.links)
    return Make(blueprint.parts, self_collides, blueprint.is_static)


class Makes:
    """Finds makes; the last one is kept, as it is compared by all that it has."""

    def __init__(self) -> None:
        self._last: tuple[Blueprint, Make] | None = None

    def of(self, blueprint: Blueprint) -> Make:
        """Find the make of a blueprint, or find it again when it is the same object."""
        if self._last is None or self._last[0] is not blueprint:
            self._last = (blueprint, make_of(blueprint))
        return self._last[1]


@dataclass(frozen=True)
class Layout:
    """Where MuJoCo puts what a slot has, counted from the slot's first; links go depth first.

    Attributes:
        order: Links in MuJoCo's order.
        bodies: Number of each link.
        positions: Place of each joint in qpos; NONE where it does not move.
        velocities: In qvel, likewise.
        widths: How many bodies, positions, velocities, geometries and equalities a slot has.
    """

    order: tuple[int, ...]
    bodies: tuple[int, ...]
    positions: tuple[int, ...]
    velocities: tuple[int, ...]
    widths: "Widths"


@dataclass(frozen=True)
class Widths:
    """Sizes of one slot, or where one begins."""

    bodies: int = 0
    positions: int = 0
    velocities: int = 0
    geometries: int = 0
    equalities: int = 0

    def __add__(self, other: "Widths") -> "Widths":
        """Add each."""
        return Widths(
            self.bodies + other.bodies,
            self.positions + other.positions,
            self.velocities + other.velocities,
            self.geometries + other.geometries,
            self.equalities + other.equalities,
        )

    def times(self, count: int) -> "Widths":
        """Multiply each."""
        return Widths(
            self.bodies * count,
            self.positions * count,
            self.velocities * count,
            self.geometries * count,
            self.equalities * count,
        )


@dataclass
class _Count:
    positions: int
    velocities: int
    order: list[int] = field(default_factory=list)


def layout_of(make: Make, geometries: int) -> Layout:
    """Find where MuJoCo puts what a slot of a make has.

    Args:
        make: What is in the slot.
        geometries: How many it has; a mesh may be several.
    """
    is_free = not make.is_static
    at = _Count(ROOT_POSITIONS * is_free, ROOT_VELOCITIES * is_free)
    positions, velocities = {0: NONE}, {0: NONE}

    def visit(link: int) -> None:
        at.order.append(link)
        moves = link > 0 and make.bones[link].joint_kind != "fixed"
        if link:
            positions[link] = at.positions if moves else NONE
            velocities[link] = at.velocities if moves else NONE
        at.positions += moves
        at.velocities += moves
        for child in make.children(link):
            visit(child)

    visit(0)
    links = range(len(make.bones))
    return Layout(
        tuple(at.order),
        tuple(at.order.index(link) for link in links),
        tuple(positions[link] for link in links[1:]),
        tuple(velocities[link] for link in links[1:]),
        Widths(len(links), at.positions, at.velocities, geometries, len(followers(make))),
    )


def followers(make: Make) -> list[int]:
    """List the links whose joint follows another that moves."""
    moving = {part.joint.name for part in make.bones if part.joint and part.joint.kind != "fixed"}
    return [
        link
        for link, part in enumerate(make.bones)
        if (joint := part.joint) is not None
        and joint.kind != "fixed"
        and joint.mimic is not None
        and joint.mimic.joint in moving
    ]
