"""Settings of commands: each option also has a variable, and a key of the file of `--config`.

Both derive from the option's spelling, so that no list of them is kept. A flag takes precedence,
then a variable, then the file, then the default.
"""

import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from typer.core import TyperGroup
from typer.main import get_command

from zensim.proto.bounded_files import read_text_file
from zensim.proto.setting_variables import CONFIG_VARIABLE, name_variable

if TYPE_CHECKING:
    from zensim.scenario.scenario_nodes import ScenarioNode

Command = Any
"""A command or group of click, which typer has inside under a name that changed."""
Option = Any
USAGE_ERROR: Any = typer.BadParameter.__mro__[1]
"""The class above it in click, which typer has inside under a name that changed."""
WRITTEN_VALUE: Final = re.compile(r"(?:&\S+ +)?([-+.0-9eE]+|[Tt]\w+|[Ff]\w+)(?!\w)")
"""A decimal number or a truth value, after its anchor."""


@dataclass(frozen=True)
class CommandSettings:
    """The options of one command.

    Attributes:
        name: As it is typed, such as `sensors run`.
        options: By key, which is the spelling without dashes.
        short: The name without a command that may be left out; empty if none may.
    """

    name: str
    options: Mapping[str, Option]
    short: str = ""


def find_key(option: Option) -> str:
    """Find the key of an option: its first long spelling without dashes; empty without one."""
    return next((one[2:] for one in option.opts if one.startswith("--")), "")


def list_options(command: Command) -> dict[str, Option]:
    """List the options of a command by key, without arguments and hidden options."""
    options = (one for one in command.params if one.param_type_name == "option" and not one.hidden)
    return {find_key(one): one for one in options if find_key(one) not in {"", "config", "help"}}


def list_commands(command: Command, name: str) -> Iterator[tuple[str, Command]]:
    """List a command, and those of a group, by the words that are typed."""
    yield name, command
    for word, inner in getattr(command, "commands", {}).items():
        yield from list_commands(inner, f"{name} {word}")


def add_settings(command: Command, name: str) -> None:
    """Give each option of a command, or of those in a group, its variable; add `--config`."""
    short: dict[str, str] = {}
    for words, one in list_commands(command, name):
        if default := getattr(one, "default_command", ""):
            short[f"{words} {default}"] = words
        options = list_options(one.commands[default] if default else one)
        settings = CommandSettings(words, options, short.get(words, ""))
        for key, option in list_options(one).items():
            variables = [name_variable(each, key) for each in (words, settings.short) if each]
            shared = option.envvar or []
            names = [shared] if isinstance(shared, str) else list(shared)
            if variables[0] not in names:
                option.show_envvar = bool(names)
                option.envvar = [*variables, *names]
        if not any("--config" in parameter.opts for parameter in one.params):
            one.params.append(make_config_option(settings))


def make_config_option(settings: CommandSettings) -> Option:
    """Make the option `--config`, which is read before all others."""
    app = typer.Typer()

    def load(context: typer.Context, value: Path | None) -> None:
        if value is not None:
            # The messages of services, which it imports, take longer than help texts.
            from zensim.proto.exit_codes import exit_on_failure

            with exit_on_failure(settings.name):
                context.default_map = read_settings(value, settings)
            context.meta[CONFIG_VARIABLE] = value

    @app.command()
    def dummy(
        *,
        config: Annotated[
            Path | None,
            typer.Option(
                "--config",
                metavar="FILE",
                help="YAML file with a section for each command, and keys as its options.",
                envvar=CONFIG_VARIABLE,
                is_eager=True,
                expose_value=False,
                callback=load,
                show_default="none",
                rich_help_panel="Output",
            ),
        ] = None,
    ) -> None:
        del config

    return next(one for one in get_command(app).params if one.name == "config")


def read_settings(file: Path, settings: CommandSettings) -> dict[str, object]:
    """Read the section of a command; values by the names of parameters.

    Raises:
        OSError: The file cannot be read.
        ValueError: It has an unknown command or key, or a value that is no text, number or list.
    """
    from zensim.scenario.scenario_nodes import read_nodes

    text = read_text_file(file)
    sections = read_nodes(text, str(file))
    _require_known(sections, list_sections(sections.items), "command")
    lines, found = text.splitlines(), dict[str, object]()
    for name in (settings.short, settings.name):
        section = sections.items.get(name)
        if section is None or section.value is None:
            continue
        _require_known(section, tuple(settings.options), f"option of 'zensim {name}'")
        for key, node in section.items.items():
            option = settings.options[key]
            found[option.name] = _read_value_of(option, node, key, lines)
    return found


def list_sections(keys: Iterable[str]) -> tuple[str, ...]:
    """List all commands of one word, and those of several words whose first is in the keys."""
    from zensim.deploy.cli import GROUPS, VERBS, build

    found = [verb for verb in VERBS if verb not in GROUPS]
    named = {key.split(" ")[0] for key in keys if " " in key or key in GROUPS}
    for verb in sorted(named & VERBS.keys()):
        app: Any = get_command(build(verb))
        found += [words for words, _ in list_commands(app.commands[verb], verb) if words != verb]
    return tuple(found)


def _require_known(node: "ScenarioNode", known: Sequence[str], what: str) -> None:
    from zensim.scenario.scenario_nodes import fail_at

    if not node.is_map:
        raise fail_at(node.place, "", f"a map of keys is needed; each is a {what}")
    for key in node.items:
        if key not in known:
            place = node.key_places.get(key, node.place)
            raise fail_at(place, key, f"no {what}; there are {', '.join(known)}")


def _read_value_of(option: Option, node: "ScenarioNode", key: str, lines: Sequence[str]) -> object:
    if isinstance(node.value, bool) and (option.is_flag or option.count):
        return node.value
    value = _read_value(node, key, lines)
    return [value] if option.multiple and not isinstance(value, list) else value


def _read_value(node: "ScenarioNode", key: str, lines: Sequence[str]) -> object:
    """Read a value as its text in the lines of the file: a name may be 1.10, a folder 007."""
    from zensim.scenario.scenario_nodes import fail_at

    if node.is_map:
        raise fail_at(node.place, key, "a text, number, true, false or a list is needed")
    if isinstance(node.value, list):
        return [_read_value(one, key, lines) for one in node.elements]
    if node.value is None or isinstance(node.value, str):
        return node.value
    written = WRITTEN_VALUE.match(lines[node.place.line - 1], node.place.column - 1)
    return written[1] if written is not None else str(node.value)


class SettingsGroup(TyperGroup):
    """A group whose commands have settings."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ANN401
        """Find a command, with its settings."""
        command = super().get_command(ctx, cmd_name)
        if command is not None:
            add_settings(command, cmd_name)
        return command

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401
        """Run a command; a wrong option ends it, with an object where it prints JSON."""
        try:
            return super().invoke(ctx)
        except USAGE_ERROR as error:
            from zensim.proto.exit_codes import ExitCode, print_failure
            from zensim.proto.options.option_sources import find_source
            from zensim.proto.verbosity import CURRENT

            name = getattr(getattr(error, "param", None), "name", "")
            if name and error.ctx and find_source(error.ctx, name) == "DEFAULT_MAP":
                error.message += f"; it is in {error.ctx.meta[CONFIG_VARIABLE]}"
            if "--json" not in sys.argv:
                raise
            CURRENT.is_json = True
            command = (error.ctx or ctx).command_path.partition(" ")[2]
            print_failure(command, ValueError(error.format_message()))
            raise SystemExit(ExitCode.USAGE) from error
