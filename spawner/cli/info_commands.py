"""`zensim info get` and `set`, and entity categories and filters as words."""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import typer

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.entity_messages import (
    Category,
    EntityCategory,
    EntityFilters,
    EntityInfo,
    TagsFilter,
)
from zensim.spawner.cli.command_session import (
    AsJson,
    Connect,
    EntityName,
    Timeout,
    WorldName,
    open_client,
)


def parse_category(word: str) -> EntityCategory:
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


def format_category(category: EntityCategory) -> str:
    """Write a category down; one that is not known by its number."""
    number = category.category
    return Category(number).name.lower() if number in set(Category) else str(number)


def make_filters(pattern: str, categories: Sequence[str], tags: Sequence[str]) -> EntityFilters:
    """Make a filter: names that match, of any of the categories, with any of the tags.

    Raises:
        ValueError: A category is none.
    """
    return EntityFilters(pattern, tuple(map(parse_category, categories)), TagsFilter(tuple(tags)))


app = typer.Typer(
    name="info", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


@app.command("get")
def get_info(
    name: EntityName,
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Tell the category, the tags and the description of an entity."""
    with open_client("info get", connect, world_name, timeout) as client:
        _print_info(name, client.entity_info(name), as_json=as_json)


@app.command("set")
def set_info(
    name: EntityName,
    *,
    category: Annotated[
        str, typer.Option(help="robot, object, human, dynamic_object or static_object.")
    ] = "",
    tag: Annotated[
        list[str] | None, typer.Option("--tag", help="Instead of all former tags; repeatable.")
    ] = None,
    no_tags: Annotated[bool, typer.Option("--no-tags", help="Take all tags away.")] = False,
    description: Annotated[str | None, typer.Option(help="A word for people.")] = None,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Say what an entity is; what is not given stays as it is."""
    with exit_on_failure("info set"):
        if tag and no_tags:
            raise ValueError("--tag and --no-tags exclude one another; give one")
        if not (category or tag or no_tags) and description is None:
            raise ValueError("nothing to set; give --category, --tag, --no-tags or --description")
        wanted_category = parse_category(category) if category else None
    with open_client("info set", connect, world_name, timeout) as client:
        now = client.entity_info(name)
        wanted = EntityInfo(
            wanted_category or now.category,
            now.description if description is None else description,
            tuple(tag) if tag else () if no_tags else now.tags,
        )
        client.set_entity_info(name, wanted)
        _print_info(name, wanted, as_json=as_json)


def _print_info(name: str, info: EntityInfo, *, as_json: bool) -> None:
    facts = {
        "entity": name,
        "category": format_category(info.category),
        "tags": info.tags,
        "description": info.description,
    }
    if as_json:
        typer.echo(msgspec.json.encode(facts).decode())
        return
    typer.echo(f"{name}: {facts['category']}")
    typer.echo(f"  tags         {', '.join(info.tags) or '-'}")
    typer.echo(f"  description  {info.description or '-'}")
