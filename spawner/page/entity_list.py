"""The list of entities: categories, status and what a search finds. NumPy only."""

from collections.abc import Mapping, Sequence
from typing import Final, Literal, get_args

import msgspec
import numpy as np

from zensim.spawner.page.model_visuals import Array
from zensim.spawner.page.render_state import (
    MOVING_MPS,
    MOVING_RADPS,
    LastCommand,
    RenderedFleet,
    RenderedFrame,
)
from zensim.spawner.page.robot_colours import find_robot_colour

Category = Literal["Robots", "Objects", "World"]
"""Entities with a drive; those without; those of the world file."""
CATEGORIES: Final[tuple[Category, ...]] = get_args(Category)
EntityStatus = Literal["moving", "standing", "asleep", "no agent", "blocked", "static"]
LETTERS: Final[dict[EntityStatus, str]] = {
    "moving": "m",
    "standing": "s",
    "asleep": "z",
    "no agent": "n",
    "blocked": "b",
    "static": "t",
}
"""Letter of each status in messages to the page's script."""
BLOCKED_SHARE: Final = 0.1
"""A robot that reaches less of its command is blocked."""


def find_category(fleet: RenderedFleet, name: str) -> Category:
    """Find the category of an entity."""
    if fleet.members[name].belongs_to_world:
        return "World"
    return "Robots" if fleet.model_of(name).is_robot else "Objects"


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
    if fleet.model_of(name).is_robot:
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
    if not command.is_fresh:
        return False
    speed, turn = abs(command.forward_mps), abs(command.turn_radps)
    if speed < MOVING_MPS and turn < MOVING_RADPS:
        return False
    reaches_speed = np.linalg.norm(state[7:10]) >= BLOCKED_SHARE * speed
    return not (reaches_speed if speed >= MOVING_MPS else abs(state[12]) >= BLOCKED_SHARE * turn)


class PageEntity(msgspec.Struct, frozen=True, array_like=True):
    """What the list of the page needs of an entity, but for what changes often."""

    name: str
    category: int
    """Index into `CATEGORIES`."""
    words: str
    """What a search finds beside the name: namespace and model."""
    colour: str
    """Colour of a robot, `#rrggbb`; empty without a drive."""


def list_entities(fleet: RenderedFleet) -> list[PageEntity]:
    """List all entities in the order of `RenderedFleet.names`."""
    return [
        PageEntity(
            name,
            CATEGORIES.index(find_category(fleet, name)),
            f"{fleet.members[name].namespace} {fleet.model_of(name).name}",
            "#{:02x}{:02x}{:02x}".format(*find_robot_colour(name)) if name in fleet.driven else "",
        )
        for name in fleet.names
    ]


def encode_statuses(statuses: Sequence[EntityStatus], frame: RenderedFrame) -> tuple[str, str]:
    """Encode what changes often as JSON: a letter for each status, and speeds [cm/s].

    Args:
        statuses: Of `find_statuses`.
        frame: Of the same entities.
    """
    letters = "".join(LETTERS[status] for status in statuses)
    speeds = np.round(100.0 * np.linalg.norm(frame.base[:, 7:10], axis=1)).astype(int)
    return msgspec.json.encode(letters).decode(), msgspec.json.encode(speeds.tolist()).decode()
