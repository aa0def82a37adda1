"""The list of entities: categories, status and search. NumPy only."""

from collections.abc import Mapping, Sequence
from typing import Final, Literal, get_args

import msgspec
import numpy as np

from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.spawner.page.model_visuals import Array
from zensim.spawner.page.render_state import LastCommand, RenderedFleet, RenderedFrame

Category = Literal["Robots", "Objects", "World"]
"""Entities with a drive; those without; those of the world file."""
CATEGORIES: Final[tuple[Category, ...]] = get_args(Category)
EntityStatus = Literal["moving", "standing", "asleep", "no agent", "blocked", "static"]
Choice = Literal["All", "Moving", "Standing", "Asleep", "No agent", "Blocked"]
"""Which entities are listed."""
CHOICES: Final[tuple[Choice, ...]] = get_args(Choice)
MOVING_MPS: Final = 0.01
MOVING_RADPS: Final = 0.02
"""Speeds from which an entity moves; engines leave slower residues."""
FRESH_S: Final = 1.0
"""A command of this age [s] or older drives nothing."""
BLOCKED_SHARE: Final = 0.1
"""A robot that reaches less of its command is blocked."""


class ListedEntities(msgspec.Struct, frozen=True, eq=False):
    """What a search found."""

    names: Mapping[Category, tuple[str, ...]]
    """Names by category, in the order of the world."""

    @property
    def count(self) -> int:
        """Number of entities."""
        return sum(map(len, self.names.values()))


def find_category(fleet: RenderedFleet, name: str) -> Category:
    """Find the category of an entity."""
    if fleet.members[name].belongs_to_world:
        return "World"
    return "Robots" if name in fleet.driven else "Objects"


def find_statuses(
    fleet: RenderedFleet, frame: RenderedFrame, commands: Mapping[str, LastCommand]
) -> list[EntityStatus]:
    """Find the status of each entity, in the order of `RenderedFleet.names`.

    Only an entity with a known command can be "blocked".

    Args:
        fleet: All entities.
        frame: Of the fleet.
        commands: Last commands by entity.
    """
    speeds = np.linalg.norm(frame.base[:, 7:10], axis=1)
    turns = np.linalg.norm(frame.base[:, 10:13], axis=1)
    is_moving = ((speeds >= MOVING_MPS) | (turns >= MOVING_RADPS)).tolist()
    is_still = (np.abs(frame.base[:, 7:13]).max(axis=1, initial=0.0) == 0.0).tolist()
    statuses = [
        _choose_status(fleet, name, is_moving=moving, is_still=still)
        for name, moving, still in zip(fleet.names, is_moving, is_still, strict=True)
    ]
    for name, command in commands.items():
        row = fleet.rows.get(name)
        if row is not None and is_blocked(frame.base[row], command):
            statuses[row] = "blocked"
    return statuses


def _choose_status(
    fleet: RenderedFleet, name: str, *, is_moving: bool, is_still: bool
) -> EntityStatus:
    if is_moving:
        return "moving"
    if name in fleet.driven:
        return "standing" if fleet.members[name].agent else "no agent"
    if fleet.model_of(name).is_static:
        return "static"
    return "asleep" if is_still else "standing"


def is_blocked(state: Array, command: LastCommand) -> bool:
    """Whether a robot has a fresh command and does not move as commanded.

    Args:
        state: Of its base (STATE_COLUMNS,).
        command: Last velocity command.
    """
    if command.age_s >= FRESH_S:
        return False
    speed, turn = abs(command.forward_mps), abs(command.turn_radps)
    if speed < MOVING_MPS and turn < MOVING_RADPS:
        return False
    reaches_speed = np.linalg.norm(state[7:10]) >= BLOCKED_SHARE * speed
    return not (reaches_speed if speed >= MOVING_MPS else abs(state[12]) >= BLOCKED_SHARE * turn)


def search_entities(
    fleet: RenderedFleet, statuses: Sequence[EntityStatus], text: str, choice: Choice = "All"
) -> ListedEntities:
    """List the entities whose name, namespace or model has all words of a text.

    Args:
        fleet: All entities.
        statuses: Of `find_statuses`.
        text: Words in any case; empty = all.
        choice: Status that they must have.
    """
    words, wanted = text.casefold().split(), choice.casefold()
    found: dict[Category, list[str]] = {category: [] for category in CATEGORIES}
    for name, status in zip(fleet.names, statuses, strict=True):
        if wanted not in ("all", status):
            continue
        if words and not _has_words(fleet.members[name], fleet.model_of(name).name, words):
            continue
        found[find_category(fleet, name)].append(name)
    return ListedEntities({category: tuple(names) for category, names in found.items()})


def _has_words(member: EntityModel, model: str, words: Sequence[str]) -> bool:
    text = f"{member.entity} {member.namespace} {model}".casefold()
    return all(word in text for word in words)
