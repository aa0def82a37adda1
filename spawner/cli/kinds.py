"""Categories of entities as words, and filters made of options."""

from collections.abc import Sequence

from zensim.proto.messages.entity_messages import (
    Category,
    EntityCategory,
    EntityFilters,
    TagsFilter,
)


def category_of(word: str) -> EntityCategory:
    """Read a category.

    Raises:
        ValueError: It is none.
    """
    wanted = word.strip().upper().replace("-", "_")
    for known in Category:
        if known.name == wanted:
            return EntityCategory(known)
    words = ", ".join(known.name.lower() for known in Category)
    raise ValueError(f"category {word[:40]!r} is unknown; use {words}")


def category_word(category: EntityCategory) -> str:
    """Write a category down; one that is not known by its number."""
    number = category.category
    return Category(number).name.lower() if number in set(Category) else str(number)


def filters_of(pattern: str, categories: Sequence[str], tags: Sequence[str]) -> EntityFilters:
    """Make a filter: names that match, of any of the categories, with any of the tags.

    Raises:
        ValueError: A category is none.
    """
    return EntityFilters(pattern, tuple(map(category_of, categories)), TagsFilter(tuple(tags)))
