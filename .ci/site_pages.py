"""Pages of the site that are made when it is built: those of the root, and generated reference.

Hooks of mkdocs; see `.mkdocs.yml`.
"""

from __future__ import annotations

import inspect
import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from mkdocs.structure.files import File
from typer.cli import get_docs_for_click
from typer.main import get_command

import zensim
from zensim.deploy import cli
from zensim.proto import schema
from zensim.proto.topic_catalog import TOPICS, TopicScope, TopicSpec

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
ROOT_PAGES = {
    "README.md": "index.md",
    "README.zh-CN.md": "index.zh-CN.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security_policy.md",
    "CHANGELOG.md": "changelog.md",
}
"""Documents of the root of the repository, by name, and their pages."""
OWNERS = {
    TopicScope.WORLD: ("<world>",),
    TopicScope.AGENT: ("<world>", "<agent>"),
    TopicScope.SENSORS: ("<world>", "<process>"),
    TopicScope.ROBOT: ("<namespace>",),
}
"""Names in the keys of a scope."""
TOPICS_HEAD = """# Topics and keys

Rates are defaults in hertz. A topic without one is published on change, or as the description of
the robot says.

| key | message | published by | rate | format | content |
|---|---|---|---|---|---|
"""
MESSAGES_HEAD = """# Messages

The fields of every message and service, with types as in JSON Schema. MessagePack and JSON use
these names; CDR has the fields in this order.

"""
API_HEAD = """# The API, name by name

Every public name of `zensim`, with its signature. [Python](python.md) shows how to use them, and
[rules and errors](python_rules.md) says what holds for all: units, errors, threads.

"""
SCENARIO_HEAD = """# Keys of scenario files

Every key with its type, unit and default, as the reader checks them. [Scenarios](scenarios.md)
shows how to write and run one; `zensim scenario schema` prints the JSON Schema.

"""
SCENARIO_REFERENCE = "## Reference\n"
"""Heading in docs/scenarios.md; what follows is a page of its own on the site."""
UNITS = ("format", "contentEncoding")
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(((?!https?:|mailto:|#)[^)\s]+)\)")
IMAGE = re.compile(r"!\[([^\]]*)\]\((?:\.\./)*docs/([^)\s]+)\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not files of docs/."""
    pages = {page: (ROOT / name).read_text() for name, page in ROOT_PAGES.items()}
    pages |= {"options.md": write_options_page(), "topics.md": write_topics_page()}
    pages |= {"messages.md": write_messages_page(), "adr/index.md": write_decisions_page()}
    pages |= {"api.md": write_api_page(), "scenario_keys.md": write_scenario_keys_page()}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, *, page: Page, **_: object) -> str:
    """Point links to pages of the site; files of the repository become plain text."""
    folder = ROOT / "docs" / Path(page.file.src_uri).parent
    if page.file.src_uri in ROOT_PAGES.values():
        folder = ROOT
    if page.file.src_uri == "scenarios.md":
        markdown, _, _ = markdown.partition(SCENARIO_REFERENCE)
        markdown += "[Keys of scenario files](scenario_keys.md) lists every key.\n"
    markdown = IMAGE.sub(r"![\1](\2)", markdown)
    return LINK.sub(lambda link: _point(link, folder, page), markdown)


def _point(link: re.Match[str], folder: Path, page: Page) -> str:
    text, target = link.groups()
    path, _, anchor = target.partition("#")
    file = (folder / path).resolve()
    if not file.exists() or not file.is_relative_to(ROOT):
        return link.group()
    name = file.relative_to(ROOT).as_posix()
    uri = ROOT_PAGES.get(name, name.removeprefix("docs/") if name.startswith("docs/") else "")
    if uri == "adr":
        uri = "adr/index.md"
    if not uri:
        return f"{text} (`{name}`)"
    relative = os.path.relpath(uri, Path(page.file.src_uri).parent)
    return f"[{text}]({relative}{'#' + anchor if anchor else ''})"


def write_options_page() -> str:
    """Write the help of every command."""
    parts = [
        "# Options of commands\n\nThe help of each command, as `zensim COMMAND --help` prints it.\n"
    ]
    for verb in cli.VERBS:
        command = get_command(cli.build(verb)).commands[verb]
        context = click.Context(command, info_name=verb)
        parts.append(
            get_docs_for_click(obj=command, ctx=context, name=verb, indent=1, call_prefix="zensim")
        )
    return "\n".join(parts)


def write_topics_page() -> str:
    """Write the topic catalog as a table."""
    rows = [
        f"| `{topic.key(*OWNERS[topic.scope])}` | {_name_messages(topic)} "
        f"| {topic.publisher.value} | {f'{topic.rate_hz:g}' if topic.rate_hz else ''} "
        f"| {topic.format.name.lower()} | {topic.description} |"
        for topic in TOPICS.values()
    ]
    return f"{TOPICS_HEAD}{chr(10).join(rows)}\n"


def _name_messages(topic: TopicSpec) -> str:
    return " or ".join(
        f"[{one.__name__}](messages.md#{one.__name__.lower()})" for one in topic.messages
    )


def write_messages_page() -> str:
    """Write the fields of every message, from its JSON Schema."""
    described = schema.make_message_schemas()["$defs"]
    return MESSAGES_HEAD + "\n".join(
        _describe_message(name, one) for name, one in described.items()
    )


def _describe_message(name: str, described: Mapping[str, Any]) -> str:
    ros_type = described.get("x-ros-type")
    rows = [
        f"| `{field}` | {_name_type(value)} | {_write_default(value)} |"
        for field, value in described.get("properties", {}).items()
    ]
    table = ["| field | type | default |", "|---|---|---|", *rows] if rows else []
    kind = [f"`{ros_type}`", ""] if ros_type else []
    purpose = inspect.cleandoc(described.get("description", ""))
    return "\n".join([f"## {name}", "", *kind, purpose, "", *table, ""])


def _name_type(value: Mapping[str, Any]) -> str:
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in value:
        return " or ".join(_name_type(one) for one in value["anyOf"])
    if value.get("type") == "array":
        return f"array of {_name_type(value['items'])}" if value.get("items") else "array"
    if "enum" in value:
        return ", ".join(f"`{one}`" for one in value["enum"])
    return " ".join(
        [value.get("type", "any"), *(f"({value[key]})" for key in UNITS if key in value)]
    )


def _write_default(value: Mapping[str, Any]) -> str:
    default = value.get("default")
    return "" if default in (None, {}, []) else f"`{json.dumps(default)}`"


def write_api_page() -> str:
    """Write the public names of the API: functions, then classes with their members."""
    surface = json.loads((ROOT / "docs" / "api.json").read_text())
    classes = {name: one for name, one in surface.items() if isinstance(one, dict)}
    parts = [
        f"## {name}\n\n`zensim.{name}{signature}`\n\n{_read_docstring(getattr(zensim, name))}\n"
        for name, signature in surface.items()
        if isinstance(signature, str) and callable(getattr(zensim, name))
    ]
    parts += [_describe_class(name, members) for name, members in classes.items()]
    return API_HEAD + "\n".join(parts)


def _describe_class(name: str, members: Mapping[str, str]) -> str:
    described = getattr(zensim, name)
    rows = []
    for member, kind in members.items():
        call = kind.replace("(self, ", "(").replace("(self)", "()") if kind[0] == "(" else ""
        text = _read_docstring(getattr(described, member)) if call or kind == "property" else ""
        rows.append(f"| `{member}{call}` | {text.partition(chr(10) * 2)[0]} |".replace("\n", " "))
    table = ["| member | |", "|---|---|", *rows] if rows else []
    return "\n".join([f"## {name}", "", _read_docstring(described), "", *table, ""])


def _read_docstring(named: object) -> str:
    """Read a docstring as Markdown; its sections of arguments and errors become lists."""
    lines = []
    for line in inspect.cleandoc(getattr(named, "__doc__", None) or "").splitlines():
        if line in {"Args:", "Returns:", "Raises:", "Yields:"}:
            lines += [f"**{line}**", ""]
        elif line.startswith("    ") and not line.startswith("     "):
            lines.append(f"- {line.strip()}")
        else:
            lines.append(line)
    return "\n".join(lines)


def write_scenario_keys_page() -> str:
    """Write the generated reference of docs/scenarios.md as a page of its own."""
    _, _, reference = (ROOT / "docs" / "scenarios.md").read_text().partition(SCENARIO_REFERENCE)
    return SCENARIO_HEAD + reference.replace("\n### ", "\n## ")


def write_decisions_page() -> str:
    """List the decision records."""
    rows = []
    for path in sorted((ROOT / "docs" / "adr").glob("*.md")):
        title = path.read_text().splitlines()[0].removeprefix("# ")
        rows.append(f"- [{title}]({path.name})")
    return "# Decisions\n\nWhy zensim is as it is.\n\n" + "\n".join(rows) + "\n"
