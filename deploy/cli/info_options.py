"""Options on category, tags and description of entities: filters, and new values."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import typer

from zensim.proto.messages.entity_messages import (
    Category,
    EntityCategory,
    EntityFilters,
    EntityInfo,
    TagsFilter,
)
from zensim.proto.options.command_options import flag
from zensim.proto.printable_text import print_lines, printable
from zensim.spawner.client.sim_client import SimClient

CATEGORIES = ", ".join(known.name.lower() for known in Category)


def parse_category(word: str) -> EntityCategory:
    """Parse the name of a category.

    Raises:
        ValueError: There is no such category.
    """
    name = word.strip().upper().replace("-", "_")
    for known in Category:
        if known.name == name:
            return EntityCategory(known)
    raise ValueError(f"category must be one of {CATEGORIES}; got {word[:40]!r}")


def format_category(category: EntityCategory) -> str:
    """Format a category as its name, or as its number if that is unknown."""
    number = category.category
    return Category(number).name.lower() if number in set(Category) else str(number)


def make_filters(pattern: str, categories: Sequence[str], tags: Sequence[str]) -> EntityFilters:
    """Make a filter: a name that matches, one of the categories, and one of the tags.

    Raises:
        ValueError: A category is unknown.
    """
    return EntityFilters(pattern, tuple(map(parse_category, categories)), TagsFilter(tuple(tags)))


_new_value = partial(typer.Option, show_default="unchanged")


@dataclass(frozen=True, kw_only=True)
class NewInfoOptions:
    """Category, tags and description to set."""

    category: Annotated[
        str, _new_value("--category", metavar="CATEGORY", help=f"New category: {CATEGORIES}.")
    ] = ""
    tag: Annotated[
        list[str] | None,
        _new_value("--tag", metavar="TAG", help="New tag; repeatable. Replaces all present tags."),
    ] = None
    no_tags: Annotated[bool, flag("--no-tags", help="Remove all tags.")] = False
    description: Annotated[
        str | None, _new_value("--description", metavar="TEXT", help="New description.")
    ] = None

    @property
    def is_given(self) -> bool:
        """Whether there is something to set."""
        return bool(self.category or self.tag or self.no_tags) or self.description is not None

    def check(self) -> None:
        """Check the options.

        Raises:
            ValueError: They contradict each other, or the category is unknown.
        """
        if self.tag and self.no_tags:
            raise ValueError("--tag and --no-tags exclude each other; give one of them")
        if self.category:
            parse_category(self.category)


def change_info(client: SimClient, name: str, new: NewInfoOptions) -> EntityInfo:
    """Set what is given of category, tags and description, and keep the rest."""
    old = client.entity_info(name)
    info = EntityInfo(
        parse_category(new.category) if new.category else old.category,
        old.description if new.description is None else new.description,
        tuple(new.tag) if new.tag else () if new.no_tags else old.tags,
    )
    client.set_entity_info(name, info)
    return info


def print_info(name: str, info: EntityInfo) -> None:
    """Print category, tags and description of an entity."""
    print_lines(f"{name}: {format_category(info.category)}")
    print_lines(f"  tags         {printable(', '.join(info.tags)) or '-'}")
    print_lines(f"  description  {printable(info.description) or '-'}")
