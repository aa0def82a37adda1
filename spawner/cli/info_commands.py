"""`zensim info get` and `set`, and entity categories and filters as words."""

from collections.abc import Sequence
from functools import partial
from typing import Annotated

import typer

from zensim.proto.cli_options import ClientOptions, JsonOption, expand_options, flag, make_app
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.entity_messages import (
    Category,
    EntityCategory,
    EntityFilters,
    EntityInfo,
    TagsFilter,
)
from zensim.spawner.cli.command_session import EntityName, open_client, print_json

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


app = make_app("info")
_new_value = partial(typer.Option, show_default="unchanged")


@app.command("get")
@expand_options
def get_info(name: EntityName, *, as_json: JsonOption = False, server: ClientOptions) -> None:
    """Print the category, tags and description of an entity."""
    with open_client("info get", server) as client:
        _print_info(name, client.entity_info(name), as_json=as_json)


@app.command(
    "set",
    epilog="""Examples:
  zensim info set r1 --category robot --tag red --tag fast
  zensim info set r1 --no-tags --description 'spare robot'""",
)
@expand_options
def set_info(
    name: EntityName,
    *,
    category: Annotated[
        str, _new_value(metavar="CATEGORY", help=f"New category: {CATEGORIES}.")
    ] = "",
    tag: Annotated[
        list[str] | None,
        _new_value("--tag", metavar="TAG", help="New tag; repeatable. Replaces all present tags."),
    ] = None,
    no_tags: Annotated[bool, flag("--no-tags", help="Remove all tags.")] = False,
    description: Annotated[str | None, _new_value(metavar="TEXT", help="New description.")] = None,
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Set the category, tags or description of an entity."""
    with exit_on_failure("info set"):
        if tag and no_tags:
            raise ValueError("--tag and --no-tags exclude each other; give one of them")
        if not (category or tag or no_tags) and description is None:
            raise ValueError("nothing to set; give --category, --tag, --no-tags or --description")
        new_category = parse_category(category) if category else None
    with open_client("info set", server) as client:
        old = client.entity_info(name)
        new = EntityInfo(
            new_category or old.category,
            old.description if description is None else description,
            tuple(tag) if tag else () if no_tags else old.tags,
        )
        client.set_entity_info(name, new)
        _print_info(name, new, as_json=as_json)


def _print_info(name: str, info: EntityInfo, *, as_json: bool) -> None:
    facts = {
        "entity": name,
        "category": format_category(info.category),
        "tags": info.tags,
        "description": info.description,
    }
    if as_json:
        print_json(facts)
        return
    typer.echo(f"{name}: {facts['category']}")
    typer.echo(f"  tags         {', '.join(info.tags) or '-'}")
    typer.echo(f"  description  {info.description or '-'}")
