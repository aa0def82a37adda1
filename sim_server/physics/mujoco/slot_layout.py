"""Archetypes (blueprints without a name), and indexes of their slots in a compiled model."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Shape
from zensim.sim_server.physics.blueprint import Blueprint, RigidPart

ROOT_QPOS_COUNT, ROOT_QVEL_COUNT = 7, 6
"""Numbers of a free root: position, quaternion wxyz; linear in the world, angular in the root."""
NO_INDEX = -1
IndexArray = npt.NDArray[np.intp]
FREE_SLOT = None
MAX_UNUSED_ARCHETYPES = 16
"""Archetypes without bodies whose slots are kept; compiling takes longer with each."""


@dataclass(frozen=True)
class Archetype:
    """A blueprint without its name; robots of one archetype may differ in motors and loads.

    Attributes:
        parts: In building order; the first are those of the links.
        self_collides: Of each link.
    """

    parts: tuple[RigidPart, ...]
    self_collides: tuple[bool, ...]
    is_static: bool

    def __hash__(self) -> int:
        """Hash once: archetypes are keys of compiled models."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.parts, self.self_collides, self.is_static))

    @property
    def link_parts(self) -> tuple[RigidPart, ...]:
        """The part of each link; the others are further shapes of a link."""
        return self.parts[: len(self.self_collides)]

    @cached_property
    def mass_kg(self) -> float:
        """Mass of all links."""
        return sum(part.mass_kg for part in self.link_parts)

    def children(self, link: int) -> Iterator[int]:
        """List the child links of a link."""
        return (i for i, part in enumerate(self.link_parts) if part.parent == link and i)

    def shapes(self, link: int) -> Iterator[tuple[RigidPart, Shape]]:
        """List the collision shapes of a link."""
        for part in self.parts:
            if part.link == link:
                for shape in part.shapes:
                    yield part, shape


def make_archetype(blueprint: Blueprint) -> Archetype:
    """Make the archetype of a blueprint."""
    self_collides = tuple(link.self_collides for link in blueprint.links)
    return Archetype(blueprint.parts, self_collides, blueprint.is_static)


class ArchetypeCache:
    """Finds archetypes; caches the last, as comparing them takes long."""

    def __init__(self) -> None:
        self._last: tuple[Blueprint, Archetype] | None = None

    def find(self, blueprint: Blueprint) -> Archetype:
        """Find the archetype of a blueprint; cached while it is the same object."""
        if self._last is None or self._last[0] is not blueprint:
            self._last = (blueprint, make_archetype(blueprint))
        return self._last[1]


@dataclass(frozen=True)
class SlotLayout:
    """Indexes of one slot, relative to its start; MuJoCo orders links depth first.

    Attributes:
        order: Links in MuJoCo's order.
        bodies: Body of each link.
        positions: Index of each joint in qpos; NO_INDEX if fixed.
        velocities: Likewise in qvel.
        sizes: Of the slot.
    """

    order: tuple[int, ...]
    bodies: tuple[int, ...]
    positions: tuple[int, ...]
    velocities: tuple[int, ...]
    sizes: "SlotSizes"


@dataclass(frozen=True)
class SlotSizes:
    """Number of entries of a slot in each of MuJoCo's arrays, or the index of its first."""

    bodies: int = 0
    positions: int = 0
    velocities: int = 0
    geometries: int = 0
    equalities: int = 0

    def __add__(self, other: "SlotSizes") -> "SlotSizes":
        """Add entry by entry."""
        return SlotSizes(
            self.bodies + other.bodies,
            self.positions + other.positions,
            self.velocities + other.velocities,
            self.geometries + other.geometries,
            self.equalities + other.equalities,
        )

    def times(self, count: int) -> "SlotSizes":
        """Multiply each entry."""
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


def make_slot_layout(archetype: Archetype, geometries: int) -> SlotLayout:
    """Find the layout of a slot.

    Args:
        archetype: Of the slot.
        geometries: Their number; a mesh may be several.
    """
    is_free = not archetype.is_static
    at = _LayoutCursor(ROOT_QPOS_COUNT * is_free, ROOT_QVEL_COUNT * is_free)
    positions, velocities = {0: NO_INDEX}, {0: NO_INDEX}

    def visit(link: int) -> None:
        at.order.append(link)
        moves = link > 0 and archetype.link_parts[link].joint_kind != "fixed"
        if link:
            positions[link] = at.positions if moves else NO_INDEX
            velocities[link] = at.velocities if moves else NO_INDEX
        at.positions += moves
        at.velocities += moves
        for child in archetype.children(link):
            visit(child)

    visit(0)
    links = range(len(archetype.link_parts))
    return SlotLayout(
        tuple(at.order),
        tuple(at.order.index(link) for link in links),
        tuple(positions[link] for link in links[1:]),
        tuple(velocities[link] for link in links[1:]),
        SlotSizes(
            len(links), at.positions, at.velocities, geometries, len(list_mimic_links(archetype))
        ),
    )


def list_mimic_links(archetype: Archetype) -> list[int]:
    """List the links whose joint mimics another that moves."""
    moving = {
        part.joint.name
        for part in archetype.link_parts
        if part.joint and part.joint.kind != "fixed"
    }
    return [
        link
        for link, part in enumerate(archetype.link_parts)
        if (joint := part.joint) is not None
        and joint.kind != "fixed"
        and joint.mimic is not None
        and joint.mimic.joint in moving
    ]


@dataclass(frozen=True)
class SlotAddress:
    """Indexes of a slot in a compiled model."""

    start: SlotSizes
    layout: SlotLayout
    is_free: bool
    """Whether its root moves."""

    @cached_property
    def positions(self) -> IndexArray:
        """Indexes in qpos."""
        first = self.start.positions
        return np.arange(first, first + self.layout.sizes.positions)

    @cached_property
    def velocities(self) -> IndexArray:
        """Indexes in qvel."""
        first = self.start.velocities
        return np.arange(first, first + self.layout.sizes.velocities)

    @cached_property
    def bodies(self) -> IndexArray:
        """Indexes of its bodies."""
        first = self.start.bodies
        return np.arange(first, first + self.layout.sizes.bodies)

    @cached_property
    def geometries(self) -> IndexArray:
        """Indexes of its geometries."""
        first = self.start.geometries
        return np.arange(first, first + self.layout.sizes.geometries)

    @cached_property
    def equalities(self) -> IndexArray:
        """Indexes of its equalities."""
        first = self.start.equalities
        return np.arange(first, first + self.layout.sizes.equalities)

    def joint_velocity(self, joint: int) -> int:
        """Find the index of a joint in qvel; NO_INDEX if fixed."""
        offset = self.layout.velocities[joint]
        return NO_INDEX if offset == NO_INDEX else self.start.velocities + offset

    @cached_property
    def joints(self) -> tuple[IndexArray, IndexArray, IndexArray]:
        """Find the joints that move: indexes in `Model.joints`, in qpos and in qvel."""
        moving = np.array(
            [i for i, at in enumerate(self.layout.velocities) if at != NO_INDEX], np.intp
        )
        positions = np.array(self.layout.positions, np.intp)[moving]
        velocities = np.array(self.layout.velocities, np.intp)[moving]
        return moving, self.start.positions + positions, self.start.velocities + velocities


SlotCounts = tuple[tuple[Archetype, int], ...]
"""Archetypes in the order of their first body, each with its number of slots."""


def round_up_slots(count: int) -> int:
    """Round up to the next power of 2."""
    return 1 << (count - 1).bit_length()


def _is_taken(slot: int | None) -> bool:
    return slot is not FREE_SLOT


class SlotAllocator:
    """Assigns slots to bodies, the lowest free one first, so that results repeat."""

    def __init__(self) -> None:
        self._owners: dict[Archetype, list[int | None]] = {}
        self._expected: Counter[Archetype] = Counter()

    @property
    def counts(self) -> SlotCounts:
        """Slots of each archetype."""
        return tuple((archetype, len(owners)) for archetype, owners in self._owners.items())

    @property
    def expects_more(self) -> bool:
        """Whether bodies are expected."""
        return any(self._expected.values())

    def forget_expected(self) -> None:
        """Expect no body."""
        self._expected.clear()

    def expect_one_more(self, archetype: Archetype) -> None:
        """Expect a body of an archetype: when slots are added, there will be one for it."""
        self._expected[archetype] += 1

    def with_one_more(self, archetype: Archetype) -> SlotCounts:
        """Find the slot counts after one more body of an archetype."""
        if FREE_SLOT in self._owners.get(archetype, []):
            return self.counts
        return tuple(self._find_new_sizes(archetype).items())

    def take(self, archetype: Archetype, body: int) -> int:
        """Assign a slot to a body; add slots if none is free."""
        if FREE_SLOT not in self._owners.get(archetype, []):
            self._owners = {
                one: owners + [FREE_SLOT] * (size - len(owners))
                for one, size in self._find_new_sizes(archetype).items()
                for owners in [self._owners.get(one, [])]
            }
        owners = self._owners[archetype]
        slot = owners.index(FREE_SLOT)
        owners[slot] = body
        self._expected[archetype] = max(0, self._expected[archetype] - 1)
        return slot

    def _find_new_sizes(self, archetype: Archetype) -> dict[Archetype, int]:
        """Find how many slots each archetype gets, when one has no free slot for a body."""
        sizes = {one: len(slots) for one, slots in self._find_kept().items()}
        bodies = Counter(self._expected)
        bodies[archetype] = max(1, bodies[archetype])
        for one, count in bodies.items():
            if count:
                wanted = count + sum(map(_is_taken, self._owners.get(one, [])))
                # Scenery may have a thousand geometries and seldom grows.
                is_complete = one.is_static and self._expected[one] > 0
                size = wanted if is_complete else round_up_slots(wanted)
                sizes[one] = max(sizes.get(one, 0), size)
        return sizes

    def _find_kept(self) -> dict[Archetype, list[int | None]]:
        """Find the archetypes to keep: all, or those with bodies if too many have none."""
        used = {one: slots for one, slots in self._owners.items() if any(map(_is_taken, slots))}
        too_many = len(self._owners) - len(used) > MAX_UNUSED_ARCHETYPES
        return used if too_many else self._owners

    def release(self, archetype: Archetype, slot: int) -> None:
        """Free a slot."""
        self._owners[archetype][slot] = FREE_SLOT
