"""`zensim config`: the settings of commands, and where each comes from."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
import typer
from typer.main import get_command

from zensim.deploy.cli.command_settings import USAGE_ERROR, add_settings, list_options
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.join_tokens import hide_token
from zensim.proto.options.command_options import JsonOption
from zensim.proto.options.option_groups import make_app
from zensim.proto.options.option_sources import find_source, find_unused_endpoint
from zensim.proto.printable_text import print_lines
from zensim.proto.setting_variables import CONFIG_VARIABLE

app = make_app("config")
WIDTH: Final = 22


class ShownSetting(msgspec.Struct, frozen=True):
    """An option of a command, with its value and where it comes from."""

    option: str
    value: object
    source: str
    """`variable NAME`, `file NAME` or `default`."""
    variables: tuple[str, ...]


@app.callback()
def config() -> None:
    """Show settings of commands."""


@app.command(
    "show",
    epilog="""Examples:
  zensim config show serve
  ZENSIM_SERVE_RTF=2 zensim config show serve
  zensim config show sensors run""",
)
def show(
    words: Annotated[
        list[str], typer.Argument(metavar="COMMAND...", help="Command, such as 'serve'.")
    ],
    *,
    file: Annotated[
        Path | None,
        typer.Option(
            "--config",
            metavar="FILE",
            help="File as of '--config' of the command.",
            envvar=CONFIG_VARIABLE,
            show_default="none",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show each option of a command with its value, and where that comes from."""
    with exit_on_failure("config show"):
        found = list(list_settings(words, file))
    if as_json:
        print_lines(msgspec.json.encode(found).decode())
        return
    for one in found:
        print_lines(f"{'--' + one.option:<{WIDTH}} {format_value(one.value):<{WIDTH}} {one.source}")


def list_settings(words: list[str], file: Path | None) -> Iterator[ShownSetting]:
    """List the settings that a command would have now.

    Raises:
        ValueError: There is no such command, or a value is not valid.
    """
    words = " ".join(words).split()
    command = find_command(words)
    command.no_args_is_help = False
    for parameter in command.params:
        parameter.required = False
    name = " ".join(words)
    try:
        context = command.make_context(name, [] if file is None else ["--config", str(file)])
    except USAGE_ERROR as error:
        raise ValueError(error.format_message()) from error
    unused = find_unused_endpoint(context, name) if name in {"up", "serve"} else ""
    for key, option in list_options(command).items():
        is_used = option.name != unused
        source = find_source(context, option.name) if is_used else "DEFAULT"
        count = 1 if (name, key) == ("up", "connect") else None  # the shared one is for clients
        yield ShownSetting(
            key,
            _to_plain(context.params.get(option.name) if is_used else option.default),
            describe_source(option, source, file),
            tuple(option.envvar[:count]),
        )


def find_command(words: list[str]) -> Any:  # noqa: ANN401
    """Find a command by the words that are typed, with its settings.

    Raises:
        ValueError: There is none.
    """
    from zensim.deploy.cli import VERBS, build

    name = " ".join(words)
    if not words or words[0] not in VERBS:
        raise ValueError(f"{name!r} is no command; 'zensim --help' lists all")
    root: Any = get_command(build(words[0]))
    found = root.commands[words[0]]
    add_settings(found, words[0])
    for word in words[1:]:
        found = getattr(found, "commands", {}).get(word)
    found = getattr(found, "commands", {}).get(getattr(found, "default_command", ""), found)
    if found is None or (hasattr(found, "commands") and not list_options(found)):
        raise ValueError(f"{name!r} is no command; 'zensim {words[0]} --help' lists some")
    return found


def describe_source(option: Any, source: str, file: Path | None) -> str:  # noqa: ANN401
    """Describe where the value of an option comes from."""
    if source == "ENVIRONMENT":
        return f"variable {next((one for one in option.envvar if os.environ.get(one)), '')}"
    if source == "DEFAULT_MAP":
        return f"file {file}"
    return "default"


def format_value(value: object) -> str:
    """Write a value in a table."""
    if value is None or value == "":
        return "-"
    if isinstance(value, bool):
        return "true" if value else "false"
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _to_plain(value: object) -> object:
    """Convert a value to what JSON has; tokens are hidden."""
    if isinstance(value, (list, tuple)):
        return [_to_plain(one) for one in value]
    if value is None or isinstance(value, (bool, int, float)):
        return value
    return hide_token(str(value))
