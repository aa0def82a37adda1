"""Entities, their checked info, and the index that locates each entity in the state arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.agent_messages import DriveState, OnRelease
from zensim.proto.messages.entity_messages import (
    MAX_DESCRIPTION_LENGTH,
    MAX_TAG_LENGTH,
    MAX_TAGS,
    Category,
    EntityCategory,
    EntityInfo,
)
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.errors import SimError
from zensim.sim_server.physics.engine import BodyStates, FloatArray


class InfoRefused(SimError):
    """A category, a description or tags that no entity can have."""

    slug = "info.refused"


def check_entity_info(info: EntityInfo) -> EntityInfo:
    """Return what is said of an entity, each tag once.

    Raises:
        InfoRefused: The category is not known, or there is too much text.
    """
    number = info.category.category
    if number not in set(Category):
        known = ", ".join(f"{kind.value} ({kind.name})" for kind in Category)
        raise InfoRefused(f"category {number} is not known; use {known}")
    if len(info.description) > MAX_DESCRIPTION_LENGTH:
        raise InfoRefused(
            f"a description of {len(info.description)} characters is too long; "
            f"use at most {MAX_DESCRIPTION_LENGTH}"
        )
    tags = tuple(dict.fromkeys(info.tags))
    if len(tags) > MAX_TAGS or any(not tag or len(tag) > MAX_TAG_LENGTH for tag in tags):
        raise InfoRefused(
            f"{len(tags)} tags, or one that is empty or long; "
            f"use at most {MAX_TAGS} of 1 to {MAX_TAG_LENGTH} characters"
        )
    return EntityInfo(info.category, info.description, tags)


IntArray = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Entity:
    """Anything spawned.

    Attributes:
        initial: State row (13,) that a reset goes back to.
        description: The text it was made from, as its agent publishes it.
    """

    name: str
    namespace: str
    model: Model
    body: int
    initial: FloatArray
    description: str
    born_ns: int
    """Wall time at spawn, for time-to-ready."""
    belongs_to_world: bool = False
    """Came with the world: a reset puts it back, and does not take it out."""
    info: EntityInfo = field(default_factory=EntityInfo)


def default_info(model: Model) -> EntityInfo:
    """Say what an entity is of which nobody said it: a robot, when it has a drive."""
    category = Category.STATIC_OBJECT if model.is_static else Category.OBJECT
    if model.drive is not None:
        category = Category.ROBOT
    return EntityInfo(EntityCategory(category), model.name)


@dataclass(frozen=True)
class ClaimRecord:
    """Who drives an entity, and under which claim."""

    claim: int
    agent: str
    on_release: OnRelease


@dataclass(frozen=True)
class EntityIndex:
    """All entities in the order of spawning, and where their joints start in the joint arrays."""

    names: tuple[str, ...]
    bodies: tuple[int, ...]
    row: dict[str, int]
    joint_start: IntArray
    joint_count: IntArray

    def joints_of(self, name: str) -> slice:
        """Where the joints of an entity stand."""
        start = int(self.joint_start[self.row[name]])
        return slice(start, start + int(self.joint_count[self.row[name]]))


@dataclass(frozen=True)
class ClaimedEntities:
    """What one agent drives, ready to be cut out of the arrays and to be commanded."""

    claims: bytes
    rows: IntArray
    joints: IntArray
    bodies: tuple[int, ...]
    target_count: int

    def told(self, epoch: int, step: int, time_ns: int, reading: BodyStates) -> DriveState:
        """Tell its agent where all are."""
        return DriveState(
            *(epoch, step, time_ns, self.claims),
            reading.base[self.rows].tobytes(),
            reading.joint_positions[self.joints].tobytes(),
            reading.joint_velocities[self.joints].tobytes(),
        )


def make_entity_index(entities: Sequence[Entity]) -> EntityIndex:
    """Line up entities."""
    counts = np.array([len(entity.model.joints) for entity in entities], dtype=np.intp)
    return EntityIndex(
        names=tuple(entity.name for entity in entities),
        bodies=tuple(entity.body for entity in entities),
        row={entity.name: i for i, entity in enumerate(entities)},
        joint_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)[:-1],
        joint_count=counts,
    )


def select_claimed(
    roster: EntityIndex, members: Sequence[tuple[Entity, ClaimRecord]]
) -> ClaimedEntities:
    """Cut an agent's members out of the roster, in the order of claiming."""
    rows = np.array([roster.row[entity.name] for entity, _ in members], dtype=np.intp)
    joints = [
        np.arange(roster.joint_start[row], roster.joint_start[row] + roster.joint_count[row])
        for row in rows
    ]
    return ClaimedEntities(
        claims=np.array([hold.claim for _, hold in members], dtype="<u4").tobytes(),
        rows=rows,
        joints=np.concatenate(joints).astype(np.intp) if joints else np.zeros(0, dtype=np.intp),
        bodies=tuple(entity.body for entity, _ in members),
        target_count=sum(entity.model.target_count for entity, _ in members),
    )
