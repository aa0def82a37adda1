"""Collisions that a contact sensor names, in each of the ways in which Gazebo names them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zensim.proto.messages.model_messages import Model

LUMP = "_fixed_joint_lump__"
"""Gazebo writes it between the link that is left and the collision of the link that was merged."""
_NUMBER = re.compile(r"_\d+$")
_OLD_NAME = re.compile(r"^.+?_(?:collision|geom)_(.+)$")
"""Collision names of Gazebo 1: `base_footprint_collision_base_link`."""
CollisionIndex = tuple[int, int]


def name_collision(link: str, number: int) -> str:
    """Name a collision of a URDF link as Gazebo does, by its place among those of the link."""
    return f"{link}_collision_{number}" if number else f"{link}_collision"


def name_merged(parent: str, link: str, name: str) -> str:
    """Name a collision of a link that is merged into another."""
    own = name if name.startswith(link) else f"{link}_{name}" if name else link
    return f"{parent}{LUMP}{own}"


def find_collisions(model: Model, wanted: str) -> tuple[CollisionIndex, ...]:
    """Find the collisions that a name means, by index of link and of collision.

    It is the name of a collision or of a link, merged or not, also with `link::` before it, with
    the prefix of merged links, with a number, or as Gazebo 1 named it.
    """
    for name in _list_readings(wanted.rpartition("::")[2]):
        if found := _find_named(model, name) or find_collisions_of_link(model, name):
            return found
    return ()


def find_collisions_of_link(model: Model, link: str) -> tuple[CollisionIndex, ...]:
    """Find the collisions of a link of the description."""
    for number, one in enumerate(model.links):
        if one.name == link:
            own = [at for at, shape in enumerate(one.collisions) if LUMP not in shape.name]
            return tuple((number, at) for at in own)
    parents = {frame.name: frame.parent for frame in model.frames}
    if link not in parents:
        return ()
    begin = f"{parents[link]}{LUMP}{link}"
    longer = [
        f"{parents[link]}{LUMP}{name}"
        for name in parents
        if name != link and name.startswith(f"{link}_")
    ]
    return tuple(
        index
        for index, name in _list_collisions(model)
        if (name == begin or name.startswith(f"{begin}_"))
        and not any(name.startswith(f"{other}_") for other in longer)
    )


def _find_named(model: Model, name: str) -> tuple[CollisionIndex, ...]:
    # Gazebo leaves the link out where the collision has a name.
    merged = {f"{one.parent}{LUMP}{one.name}_{name}" for one in model.frames}
    return tuple(
        index
        for index, known in _list_collisions(model)
        if name
        and (known == name or known.endswith((f"{LUMP}{name}", f"::{name}")) or known in merged)
    )


def _list_collisions(model: Model) -> Iterator[tuple[CollisionIndex, str]]:
    for number, link in enumerate(model.links):
        for at, shape in enumerate(link.collisions):
            yield (number, at), shape.name


def _list_readings(name: str) -> Iterator[str]:
    """List what a name may mean, the most literal first."""
    bare = name.rpartition(LUMP)[2]
    for one in dict.fromkeys((name, bare)):
        yield one
        unnumbered = _NUMBER.sub("", one)
        if unnumbered != one:
            yield unnumbered
        yield unnumbered.removesuffix("_collision").removesuffix("_geom")
    if old := _OLD_NAME.match(bare):
        yield old[1]
        yield _NUMBER.sub("", old[1])
