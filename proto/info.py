"""What an entity is: its category, a description, tags. Source: simulation_interfaces 2.1."""

from enum import IntEnum
from typing import ClassVar

import msgspec

from zensim.proto.widths import UInt8

MAX_TAGS = 64
MAX_TAG = 128
"""Characters of one tag."""
MAX_DESCRIPTION = 4096


class Category(IntEnum):
    """Kinds of entities. Source: simulation_interfaces/msg/EntityCategory."""

    OBJECT = 0
    ROBOT = 1
    HUMAN = 2
    DYNAMIC_OBJECT = 4
    STATIC_OBJECT = 5


class EntityCategory(msgspec.Struct, frozen=True):
    """What kind of thing. Source: simulation_interfaces/msg/EntityCategory."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityCategory"

    category: UInt8 = Category.OBJECT


class EntityInfo(msgspec.Struct, frozen=True):
    """Category, a word for people, tags for filters. Source: simulation_interfaces/msg/EntityInfo.

    At most `MAX_TAGS` tags of `MAX_TAG` characters, and a description of `MAX_DESCRIPTION`.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityInfo"

    category: EntityCategory = EntityCategory()
    description: str = ""
    tags: tuple[str, ...] = ()
