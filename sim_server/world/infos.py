"""What may be said of an entity, checked."""

from zensim.proto.messages.entity_messages import (
    MAX_DESCRIPTION_LENGTH,
    MAX_TAG_LENGTH,
    MAX_TAGS,
    Category,
    EntityInfo,
)
from zensim.sim_server.errors import SimError


class InfoRefused(SimError):
    """A category, a description or tags that no entity can have."""

    slug = "info.refused"


def checked(info: EntityInfo) -> EntityInfo:
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
