"""`zensim info get` and `set`."""

from typing import Annotated

import msgspec
import typer

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.spawner.cli.completion import Name
from zensim.spawner.cli.kinds import category_of, category_word
from zensim.spawner.cli.session import AsJson, Connect, Timeout, WorldName, client_for

app = typer.Typer(
    name="info", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


@app.command("get")
def get_info(
    name: Name,
    *,
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Tell the category, the tags and the description of an entity."""
    with client_for("info get", connect, world_name, timeout) as client:
        _show(name, client.entity_info(name), as_json=as_json)


@app.command("set")
def set_info(
    name: Name,
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
        wanted_category = category_of(category) if category else None
    with client_for("info set", connect, world_name, timeout) as client:
        now = client.entity_info(name)
        wanted = EntityInfo(
            wanted_category or now.category,
            now.description if description is None else description,
            tuple(tag) if tag else () if no_tags else now.tags,
        )
        client.set_entity_info(name, wanted)
        _show(name, wanted, as_json=as_json)


def _show(name: str, info: EntityInfo, *, as_json: bool) -> None:
    facts = {
        "entity": name,
        "category": category_word(info.category),
        "tags": info.tags,
        "description": info.description,
    }
    if as_json:
        typer.echo(msgspec.json.encode(facts).decode())
        return
    typer.echo(f"{name}: {facts['category']}")
    typer.echo(f"  tags         {', '.join(info.tags) or '-'}")
    typer.echo(f"  description  {info.description or '-'}")
