"""Archetypes (blueprints without a name), the slots of each in a compiled model, and the array indexes of a slot."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Shape
from zensim.sim_server.physics.blueprint import Blueprint, RigidPart

ROOT_QPOS_COUNT, ROOT_QVEL_COUNT = 7, 6
"""Of a free root: place and quaternion w x y z; linear in the world, angular in the root."""
NO_INDEX = -1


@dataclass(frozen=True)
class Archetype:
    """A blueprint without its name; what its motors and loads are is of each robot.

    Attributes:
        parts: In building order; the first are those of the links.
        self_collides: Of each link.
    """

    parts: tuple[RigidPart, ...]
    self_collides: tuple[bool, ...]
    is_static: bool

    def __hash__(self) -> int:
        """Hash it once: it is what casts are known by."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.parts, self.self_collides, self.is_static))

    @property
    def link_parts(self) -> tuple[RigidPart, ...]:
        """The part of each link; further parts are only more shapes of a link."""
        return self.parts[: len(self.self_collides)]

    def children(self, link: int) -> Iterator[int]:
        """List the links that a link carries."""
        return (i for i, part in enumerate(self.link_parts) if part.parent == link and i)

    def shapes(self, link: int) -> Iterator[tuple[RigidPart, Shape]]:
        """List what a link touches with."""
        for part in self.parts:
            if part.link == link:
                for shape in part.shapes:
                    yield part, shape


def make_archetype(blueprint: Blueprint) -> Archetype:
    """Leave out what robots of one make may differ in."""
    self_collides = tuple(link.self_collides for link in blueprint.links)
    return Archetype(blueprint.parts, self_collides, blueprint.is_static)


class ArchetypeCache:
    """Finds makes; the last one is kept, as it is compared by all that it has."""

    def __init__(self) -> None:
        self._last: tuple[Blueprint, Archetype] | None = None

    def find(self, blueprint: Blueprint) -> Archetype:
        """Find the make of a blueprint, or find it again when it is the same object."""
        if self._last is None or self._last[0] is not blueprint:
            self._last = (blueprint, make_archetype(blueprint))
        return self._last[1]


@dataclass(frozen=True)
class SlotLayout:
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
    sizes: "SlotSizes"


@dataclass(frozen=True)
class SlotSizes:
    """Sizes of one slot, or where one begins."""

    bodies: int = 0
    positions: int = 0
    velocities: int = 0
    geometries: int = 0
    equalities: int = 0

    def __add__(self, other: "SlotSizes") -> "SlotSizes":
        """Add each."""
        return SlotSizes(
            self.bodies + other.bodies,
            self.positions + other.positions,
            self.velocities + other.velocities,
            self.geometries + other.geometries,
            self.equalities + other.equalities,
        )

    def times(self, count: int) -> "SlotSizes":
        """Multiply each."""
        return SlotSizes(
            self.bodies * count,
            self.positions * count,
            self.velocities * count,
            self.geometries * count,
            self.equalities * count,
        )


@dataclass
class _LayoutCursor:
    positions: int
    velocities: int
    order: list[int] = field(default_factory=list)


def make_slot_layout(make: Archetype, geometries: int) -> SlotLayout:
    """Find where MuJoCo puts what a slot of a make has.

    Args:
        make: What is in the slot.
        geometries: How many it has; a mesh may be several.
    """
    is_free = not make.is_static
    at = _LayoutCursor(ROOT_QPOS_COUNT * is_free, ROOT_QVEL_COUNT * is_free)
    positions, velocities = {0: NO_INDEX}, {0: NO_INDEX}

    def visit(link: int) -> None:
        at.order.append(link)
        moves = link > 0 and make.link_parts[link].joint_kind != "fixed"
        if link:
            positions[link] = at.positions if moves else NO_INDEX
            velocities[link] = at.velocities if moves else NO_INDEX
        at.positions += moves
        at.velocities += moves
        for child in make.children(link):
            visit(child)

    visit(0)
    links = range(len(make.link_parts))
    return SlotLayout(
        tuple(at.order),
        tuple(at.order.index(link) for link in links),
        tuple(positions[link] for link in links[1:]),
        tuple(velocities[link] for link in links[1:]),
        SlotSizes(len(links), at.positions, at.velocities, geometries, len(list_mimic_links(make))),
    )


def list_mimic_links(make: Archetype) -> list[int]:
    """List the links whose joint follows another that moves."""
    moving = {
        part.joint.name for part in make.link_parts if part.joint and part.joint.kind != "fixed"
    }
    return [
        link
        for link, part in enumerate(make.link_parts)
        if (joint := part.joint) is not None
        and joint.kind != "fixed"
        and joint.mimic is not None
        and joint.mimic.joint in moving
    ]


IndexArray = npt.NDArray[np.intp]


@dataclass(frozen=True)
class SlotAddress:
    """A slot of a cast."""

    start: SlotSizes
    layout: SlotLayout
    is_free: bool
    """It has a root that moves."""

    @cached_property
    def positions(self) -> IndexArray:
        """All places in qpos."""
        first = self.start.positions
        return np.arange(first, first + self.layout.sizes.positions)

    @cached_property
    def velocities(self) -> IndexArray:
        """All places in qvel."""
        first = self.start.velocities
        return np.arange(first, first + self.layout.sizes.velocities)

    @cached_property
    def bodies(self) -> IndexArray:
        """All of its bodies."""
        first = self.start.bodies
        return np.arange(first, first + self.layout.sizes.bodies)

    @cached_property
    def geometries(self) -> IndexArray:
        """All of its geometries."""
        first = self.start.geometries
        return np.arange(first, first + self.layout.sizes.geometries)

    @cached_property
    def equalities(self) -> IndexArray:
        """All of its equalities."""
        first = self.start.equalities
        return np.arange(first, first + self.layout.sizes.equalities)

    def joint_velocity(self, joint: int) -> int:
        """Find a joint's place in qvel; NONE where it does not move."""
        offset = self.layout.velocities[joint]
        return NO_INDEX if offset == NO_INDEX else self.start.velocities + offset

    @cached_property
    def joints(self) -> tuple[IndexArray, IndexArray, IndexArray]:
        """Find the joints that move, by their places in the model, in qpos and in qvel."""
        moving = np.array(
            [i for i, at in enumerate(self.layout.velocities) if at != NO_INDEX], np.intp
        )
        positions = np.array(self.layout.positions, np.intp)[moving]
        velocities = np.array(self.layout.velocities, np.intp)[moving]
        return moving, self.start.positions + positions, self.start.velocities + velocities


SlotCounts = tuple[tuple[Archetype, int], ...]
"""Makes in the order of their first body, each with its number of slots."""
FREE_SLOT = None


def round_up_slots(count: int) -> int:
    """Find how many slots to have for so many bodies: the next power of 2."""
    return 1 << (count - 1).bit_length()


class SlotAllocator:
    """Gives slots to bodies, the lowest that is free first: what was before leaves no trace."""

    def __init__(self) -> None:
        self._owners: dict[Archetype, list[int | None]] = {}

    @property
    def counts(self) -> SlotCounts:
        """What is to be compiled for these slots."""
        return tuple((make, len(owners)) for make, owners in self._owners.items())

    def with_one_more(self, make: Archetype) -> SlotCounts:
        """Say what the cast is once one more body of a make has a slot."""
        owners = self._owners.get(make, [])
        count = len(owners) if FREE_SLOT in owners else round_up_slots(len(owners) + 1)
        return tuple({**dict(self.counts), make: count}.items())

    def take(self, make: Archetype, body: int) -> int:
        """Give a body a slot of its make, of which there are more from now on if it needs be."""
        owners = self._owners.setdefault(make, [])
        if FREE_SLOT not in owners:
            owners.extend([FREE_SLOT] * (round_up_slots(len(owners) + 1) - len(owners)))
        slot = owners.index(FREE_SLOT)
        owners[slot] = body
        return slot

    def release(self, make: Archetype, slot: int) -> None:
        """Take a slot back."""
        self._owners[make][slot] = FREE_SLOT
