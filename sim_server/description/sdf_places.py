"""Named poses of an SDF world: its <frame> elements, with words of ours inside.

```xml
<frame name="dock_1" xmlns:zensim="urn:zensim">
  <pose>1 2 0 0 0 1.57</pose>
  <zensim:description>beside the charging station</zensim:description>
  <zensim:tags>parking charging</zensim:tags>
  <zensim:size>0.8 0.6 1</zensim:size>
</frame>
```
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.entity_messages import (
    MAX_DESCRIPTION_LENGTH,
    MAX_TAG_LENGTH,
    MAX_TAGS,
    Bounds,
    BoundsType,
)
from zensim.proto.messages.spawn_messages import NamedPose
from zensim.proto.messages.standard_messages import Point, Pose, Quaternion, Vector3
from zensim.sim_server.description.decimals import read_numbers
from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Origin

PREFIX = "zensim:"
WORDS_OF_WORLDS = ("description", "tags")


class NamedPlace(msgspec.Struct, frozen=True):
    """A named pose in the world, and the room that it has; empty bounds = unbounded."""

    pose: NamedPose
    bounds: Bounds = Bounds()


def read_place(frame: Element, name: str, origin: Origin) -> NamedPlace:
    """Read a <frame> of a world whose place is known.

    Raises:
        ModelError: Its size is not three positive numbers, or its words are too many.
    """
    words = {own_word(child): (child.text or "").strip() for child in frame}
    tags = tuple(dict.fromkeys(words.get("tags", "").replace(",", " ").split()))
    description = words.get("description", "")
    is_long = len(description) > MAX_DESCRIPTION_LENGTH or any(
        len(tag) > MAX_TAG_LENGTH for tag in tags
    )
    if is_long or len(tags) > MAX_TAGS:
        raise ModelError(
            f"frame {shown(name)} has {len(tags)} tags and {len(description)} characters of "
            f"description; use at most {MAX_TAGS} of {MAX_TAG_LENGTH}, and {MAX_DESCRIPTION_LENGTH}",
            slug="sdf.named_pose",
        )
    pose = Pose(Point(*origin.position), Quaternion(*origin.orientation))
    return NamedPlace(NamedPose(name, description, tags, pose), _bounds(words, name))


def _bounds(words: dict[str, str], name: str) -> Bounds:
    if not words.get("size"):
        return Bounds()
    where = f"frame {shown(name)}, size"
    x, y, z = read_numbers(words["size"], counts=(3,), where=where, slug="sdf.named_pose")
    if min(x, y, z) <= 0.0:
        raise ModelError(f"{where}: {x:g} {y:g} {z:g}; use metres > 0", slug="sdf.named_pose")
    upper = Vector3(x / 2.0, y / 2.0, z / 2.0)
    return Bounds(BoundsType.BOX, (upper, Vector3(-upper.x, -upper.y, -upper.z)))


def own_word(child: Element) -> str:
    """Name an element of ours without its prefix; empty for others."""
    tag = str(child.tag)
    if tag.startswith(PREFIX):
        return tag.removeprefix(PREFIX)
    space, separator, name = tag.rpartition("}")
    return name if separator and "zensim" in space else ""
