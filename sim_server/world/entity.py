"""Entities, validation of their info, and the index of their rows in the state arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

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
from zensim.sim_server.physics.engine import FloatArray, IntArray


class InfoRefused(SimError):
    """A category, description or tags that are not valid."""

    slug = "info.refused"


def check_entity_info(info: EntityInfo) -> EntityInfo:
    """Validate info and remove repeated tags.

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


@dataclass(frozen=True)
class Entity:
    """Anything spawned.

    Attributes:
        initial: State row (13,) that a reset restores.
        description: URDF or SDF text, published by its agent.
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
    """Whether it is part of the world file: a reset restores it instead of deleting it."""
    info: EntityInfo = field(default_factory=EntityInfo)

    @cached_property
    def target_count(self) -> int:
        """Number of targets in a drive command of its model."""
        return self.model.target_count


def default_info(model: Model) -> EntityInfo:
    """Derive info from a model: a robot if it has a drive."""
    category = Category.STATIC_OBJECT if model.is_static else Category.OBJECT
    if model.drive is not None:
        category = Category.ROBOT
    return EntityInfo(EntityCategory(category), model.name)


@dataclass(frozen=True)
class EntityIndex:
    """Rows of the entities in the state arrays, in the order of spawning, and of their joints."""

    names: tuple[str, ...]
    bodies: tuple[int, ...]
    row: dict[str, int]
    joint_start: IntArray
    joint_count: IntArray

    def joints_of(self, name: str) -> slice:
        """Find the rows of the joints of an entity."""
        start = int(self.joint_start[self.row[name]])
        return slice(start, start + int(self.joint_count[self.row[name]]))


def make_entity_index(entities: Sequence[Entity]) -> EntityIndex:
    """Index entities in this order."""
    counts = np.array([len(entity.model.joints) for entity in entities], dtype=np.intp)
    return EntityIndex(
        names=tuple(entity.name for entity in entities),
        bodies=tuple(entity.body for entity in entities),
        row={entity.name: i for i, entity in enumerate(entities)},
        joint_start=np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)[:-1],
        joint_count=counts,
    )


def append_to_index(index: EntityIndex, entities: Sequence[Entity]) -> EntityIndex:
    """Index entities that follow those of an index, whose rows stay."""
    added, count = make_entity_index(entities), len(index.names)
    end = int(index.joint_start[-1] + index.joint_count[-1]) if count else 0
    rows = {name: count + row for name, row in added.row.items()}
    return EntityIndex(
        names=index.names + added.names,
        bodies=index.bodies + added.bodies,
        row=index.row | rows,
        joint_start=np.concatenate([index.joint_start, end + added.joint_start]),
        joint_count=np.concatenate([index.joint_count, added.joint_count]),
    )
