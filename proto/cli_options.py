"""Command-line options that several programs share, and dataclasses as groups of options."""

import dataclasses
import inspect
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar, get_args

import typer
from typer.models import ArgumentInfo, OptionInfo

from zensim.proto.endpoints import DEFAULT_ENDPOINT
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.join_tokens import TOKEN_VARIABLE
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.settings.engine_settings import EngineChoice
from zensim.proto.settings.network_settings import NetworkSettings
from zensim.proto.settings.ros_choice import USUAL_ROS, USUAL_TF, RosChoice, TfChoice
from zensim.proto.settings.setting import (
    find_setting,
    is_settings,
    list_settings,
    make_settings,
)
from zensim.proto.settings.setting_options import make_option, make_option_parameters
from zensim.proto.topic_catalog import read_ros_settings
from zensim.proto.verbosity import CURRENT, LOG_FORMAT_VARIABLE, set_verbosity
from zensim.proto.web_access import (
    TOKEN_NAME,
    PageAccess,
    check_certificate,
    check_page_exposure,
    keep_token,
    read_page_token,
    split_token,
    split_url,
)

Choice = TypeVar("Choice", bound=str)
Options = TypeVar("Options")

MAX_NUMBER = 1e18
"""Greatest number of an option."""
# In help texts a unit is written r"\[m]": Rich reads a plain [m] as markup and drops it.
flag = partial(typer.Option, metavar="")
"""An option without a value; typer would show the type of its value as <bool>."""


def make_app(name: str = "", *, has_default: bool = False) -> typer.Typer:
    """Create the app of one module; its commands form a group if it has a name.

    Args:
        name: Of the group.
        has_default: Whether the group does something without a command; else it prints its help.
    """
    return typer.Typer(
        name=name or None,
        no_args_is_help=bool(name) and not has_default,
        add_completion=False,
        pretty_exceptions_enable=False,
    )


SOURCES: Final = ("DEFAULT", "DEFAULT_MAP", "ENVIRONMENT", "COMMANDLINE")
"""Sources of values: default, file, variable, flag; later ones take precedence."""


def find_source(context: typer.Context, parameter: str) -> str:
    """Find the source of the value of an option; one of `SOURCES`."""
    source = context.get_parameter_source(parameter)
    return source.name if source is not None and source.name in SOURCES else SOURCES[0]


def takes_precedence(context: typer.Context, parameter: str, *, over: str) -> bool:
    """Whether the value of an option comes from a stronger source than that of another."""
    strength = [SOURCES.index(find_source(context, name)) for name in (parameter, over)]
    return strength[0] > strength[1]


RUNNING_CONTEXT: Final = inspect.Parameter(
    "running_context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context
)


def is_exported_for_clients(context: typer.Context, own_variable: str) -> bool:
    """Whether the endpoint to connect to comes from ZENSIM_CONNECT, which is meant for clients.

    Args:
        context: Of a command that need not connect.
        own_variable: Names the endpoint for that command only.
    """
    is_exported = find_source(context, "connect") == "ENVIRONMENT"
    return is_exported and not os.environ.get(own_variable)


def expand_options(action: Callable[..., None]) -> Callable[..., None]:
    """Replace each parameter that is a dataclass by one option per field.

    A field that is a group of settings becomes one option per setting.

    A command without `--quiet`, `--verbose` or `--log-format` gets them.
    """
    parameters = inspect.signature(action).parameters.values()
    groups = _find_groups(parameters)

    def run(**given: object) -> None:
        context = given[own_context] if own_context else given.pop(RUNNING_CONTEXT.name)
        command = _name_running_command(context) or action.__name__
        _apply_verbosity(command, given, added)
        CURRENT.options = options
        with exit_on_failure(command):
            _require_finite(given)
            for name, group in groups.items():
                given[name] = _make_group(group, given)
        action(**given)

    expanded = [
        part
        for parameter in parameters
        for part in (
            _make_parameters(parameter.annotation) if parameter.name in groups else [parameter]
        )
    ]
    added = _list_missing_switches([one.name for one in expanded])
    own_context = next((one.name for one in expanded if one.annotation is typer.Context), "")
    expanded += [*added] if own_context else [*added, RUNNING_CONTEXT]
    options: dict[str, str] = {}
    for one in expanded:
        options |= name_settings(one.name, one.annotation)
    run.__name__ = action.__name__
    run.__doc__ = action.__doc__
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in expanded]
    )
    return run


def _find_groups(parameters: Iterable[inspect.Parameter]) -> dict[str, type]:
    """Find the parameters that are dataclasses, by name."""
    kinds = {one.name: one.annotation for one in parameters}
    return {
        name: kind
        for name, kind in kinds.items()
        if isinstance(kind, type) and dataclasses.is_dataclass(kind)
    }


def name_settings(name: str, kind: object) -> dict[str, str]:
    """Name the settings of an option, and write each as it is typed.

    Messages name `min_free`, and users type `--min-free`; `-x` where there is no long spelling. An
    argument is written as help does, in capitals.

    Args:
        name: Of the field or parameter.
        kind: Its annotated type.
    """
    infos = getattr(kind, "__metadata__", ())
    if arguments := [one for one in infos if isinstance(one, ArgumentInfo)]:
        return {name: str(arguments[0].metavar or name.upper())}
    spellings = [spelling for one in infos for spelling in _list_spellings(one)]
    long = [one for one in spellings if one.startswith("--")]
    typed = next(iter((*long, *spellings)), f"--{name.replace('_', '-')}")
    return {name: typed} | {one.lstrip("-").replace("-", "_"): typed for one in spellings}


def name_group(group: type) -> dict[str, str]:
    """Name the settings of the options of a dataclass; see `name_settings`."""
    found: dict[str, str] = {}
    for one in _make_parameters(group):
        found |= name_settings(one.name, one.annotation)
    return found


def _list_spellings(info: object) -> list[str]:
    """List the spellings that an option declares; of a switch, those that turn it on."""
    # In an annotation, the first spelling is where the default is elsewhere.
    declared = (getattr(info, "default", None), *(getattr(info, "param_decls", None) or ()))
    return [one.partition("/")[0] for one in declared if isinstance(one, str)]


def _name_running_command(context: Any) -> str:  # noqa: ANN401
    """Name a command as it was typed, without the program."""
    words: list[str] = []
    level = context
    while level.parent is not None:
        words.insert(0, level.info_name or "")
        level = level.parent
    return " ".join(words)


def _require_finite(given: Mapping[str, object]) -> None:
    """Refuse numbers that are none, not finite, or none of nanoseconds: typer accepts them.

    Raises:
        ValueError: One is.
    """
    for name, value in given.items():
        if isinstance(value, float) and not abs(value) <= MAX_NUMBER:
            what = "no number" if math.isnan(value) else f"too large; use at most {MAX_NUMBER:g}"
            raise ValueError(f"`{name}` {value:g} is {what}")


def _list_missing_switches(names: Sequence[str]) -> list[inspect.Parameter]:
    return [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=option)
        for name, option, default in ADDED_SWITCHES
        if name not in names
    ]


def _apply_verbosity(
    command: str, given: dict[str, object], added: Sequence[inspect.Parameter]
) -> None:
    """Apply the switches; those that were added to a command are taken out of its arguments."""
    chosen = {name: bool(given.get(name)) for name in ("quiet", "verbose", "as_json")}
    log_format = str(given.get("log_format") or "")
    for parameter in added:
        del given[parameter.name]
    with exit_on_failure(command):
        set_verbosity(
            is_quiet=chosen["quiet"],
            is_verbose=chosen["verbose"],
            is_json=chosen["as_json"],
            log_format=log_format,
        )


def _make_parameters(group: type) -> list[inspect.Parameter]:
    return [
        parameter
        for field in _list_fields(group)
        for parameter in (
            make_option_parameters(field.type) if is_settings(field.type) else [_copy(field)]
        )
    ]


def _list_fields(group: type) -> tuple["dataclasses.Field[Any]", ...]:
    return dataclasses.fields(group)


def _copy(field: "dataclasses.Field[Any]") -> inspect.Parameter:
    is_needed = field.default is dataclasses.MISSING
    return inspect.Parameter(
        field.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if is_needed else field.default,
        annotation=field.type,
    )


def _make_group(group: type[Options], given: dict[str, object]) -> Options:
    """Make a dataclass from its options, which are taken out.

    Raises:
        ValueError: A setting is out of range, or no word that it may have.
    """
    values: dict[str, object] = {}
    for field in _list_fields(group):
        if is_settings(field.type):
            names = [one.name for one in list_settings(field.type)]
            values[field.name] = make_settings(
                field.type, {name: given.pop(name) for name in names}
            )
        else:
            values[field.name] = given.pop(field.name)
    return group(**values)


def parse_finite(word: str) -> float:
    """Read a number.

    Raises:
        ValueError: It is none, not finite, or greater than those of options.
    """
    if abs(number := float(word)) <= MAX_NUMBER:
        return number
    raise ValueError(word)


PLAIN_TYPES: dict[object, Callable[[str], object]] = {
    str: str,
    float: parse_finite,
    float | None: parse_finite,
    Path | None: Path,
    list[str] | None: str,
    list[Path] | None: Path,
}
"""Types of options with a value that `parse_plain_options` converts, and how."""


def parse_plain_options(
    group: type[Options], words: Sequence[str], environment: Mapping[str, str]
) -> Options | None:
    """Parse switches, texts, paths and numbers of a command without typer.

    typer converts values by pydantic, whose import takes 0.1 s. None where anything else is
    written, such as `--help` or a mistake: typer has to parse it then.

    Args:
        group: Dataclass of the options and arguments of the command.
        words: After the name of the command.
        environment: Variables that may stand for options.
    """
    parameters = _make_parameters(group)
    options = _index_options(parameters)
    left = [one for one in parameters if _is_argument(one)]
    if any(environment.get(name) for _, info in options.values() for name in _list_variables(info)):
        return None
    given: dict[str, Any] = {}
    rest = list(words)
    while rest:
        word = rest.pop(0)
        option, _ = options.get(word, (None, None))
        if option is None and left and not word.startswith("-"):
            _add_argument(given, left, word)
        elif option is not None and get_args(option.annotation)[0] is bool:
            given[option.name] = True
        elif not (
            option is not None
            and rest
            and not rest[0].startswith("-")
            and _add_value(given, option, rest.pop(0))
        ):
            return None
    if any(one.default is inspect.Parameter.empty for one in left):
        return None
    with suppress(ValueError):
        return _make_group(group, {one.name: one.default for one in parameters} | given)
    return None


def _index_options(
    parameters: Iterable[inspect.Parameter],
) -> dict[str, tuple[inspect.Parameter, OptionInfo]]:
    """Index the options that can be parsed without typer by their spellings."""
    found = {}
    for one in parameters:
        kind, info = get_args(one.annotation)
        if isinstance(info, OptionInfo) and (kind is bool or kind in PLAIN_TYPES):
            spellings = _list_spellings(info) or [f"--{one.name.replace('_', '-')}"]
            found.update(dict.fromkeys(spellings, (one, info)))
    return found


def _is_argument(one: inspect.Parameter) -> bool:
    kind, info = get_args(one.annotation)
    return isinstance(info, ArgumentInfo) and kind in {str, list[str] | None}


def _list_variables(info: OptionInfo) -> Sequence[str]:
    names = info.envvar or ()
    return (names,) if isinstance(names, str) else names


def _add_argument(given: dict[str, Any], left: list[inspect.Parameter], word: str) -> None:
    """Give a word to the first argument that is left; a list stays for the words that follow."""
    if get_args(left[0].annotation)[0] is str:
        given[left.pop(0).name] = word
    else:
        given.setdefault(left[0].name, []).append(word)


def _add_value(given: dict[str, Any], option: inspect.Parameter, word: str) -> bool:
    """Convert the value of an option; False if it is not one."""
    kind = get_args(option.annotation)[0]
    try:
        value = PLAIN_TYPES[kind](word)
    except ValueError:
        return False
    if kind in {list[str] | None, list[Path] | None}:
        given.setdefault(option.name, []).append(value)
    else:
        given[option.name] = value
    return True


def parse_choice(option: str, word: str, choices: tuple[Choice, ...]) -> Choice:
    """Find the choice that equals a word.

    Raises:
        ValueError: There is none.
    """
    for choice in choices:
        if choice == word:
            return choice
    known = ", ".join(filter(None, choices))
    raise ValueError(f"{option} must be one of {known}; got {word[:40]!r}")


_connection = partial(typer.Option, rich_help_panel="Connection")
ConnectOption = Annotated[
    str,
    _connection(
        "--connect",
        "--join",
        metavar="ENDPOINT|TOKEN",
        help="Zenoh endpoint of the router or server; or join token of a secured one, or @FILE "
        "with a token.",
        show_default=DEFAULT_ENDPOINT,
        envvar=[TOKEN_VARIABLE, "ZENSIM_CONNECT"],
    ),
]
InsecureOption = Annotated[bool, make_option(find_setting(NetworkSettings, "insecure"))]
WorldNameOption = Annotated[str, make_option(find_setting(NetworkSettings, "world_name"))]
TimeoutOption = Annotated[
    float, _connection("--timeout", metavar="SECONDS", help=r"Timeout of each service call \[s].")
]
JsonOption = Annotated[bool, flag("--json", help="Print JSON to standard output.")]
QuietOption = Annotated[
    bool,
    flag("--quiet", "-q", help="Print no notes; of lists, only names.", rich_help_panel="Output"),
]
VerboseOption = Annotated[
    bool,
    flag(
        "--verbose",
        "-v",
        help="Log at level INFO, and print where a failure came from.",
        rich_help_panel="Output",
    ),
]


LogFormatOption = Annotated[
    str,
    typer.Option(
        "--log-format",
        metavar="text|json",
        help="Log lines of text, or objects of JSON.",
        show_default="text",
        envvar=LOG_FORMAT_VARIABLE,
        rich_help_panel="Output",
    ),
]
ADDED_SWITCHES: Final = (
    ("quiet", QuietOption, False),
    ("verbose", VerboseOption, False),
    ("log_format", LogFormatOption, ""),
)
"""Options that each command has: name, type, default."""


AllowFailedEngineOption = Annotated[
    bool, make_option(find_setting(EngineChoice, "allow_failed_engine"))
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Value that wins over the file; repeatable."),
]
RosDomainOption = Annotated[str, make_option(find_setting(RosChoice, "ros_domain"))]


@dataclass(frozen=True, kw_only=True)
class ConnectionOptions:
    """The server to call, for commands without service calls."""

    connect: ConnectOption = ""
    world_name: WorldNameOption = "default"


_access = partial(typer.Option, rich_help_panel="Access")


@dataclass(frozen=True, kw_only=True)
class AccessOptions:
    """Who may open what a program serves."""

    secure: Annotated[
        bool, _access("--secure", metavar="", help="Serve only clients that have the token.")
    ] = False
    insecure: Annotated[
        bool, _access("--insecure", metavar="", help="Serve every client, also of other hosts.")
    ] = False
    certificate: Annotated[
        Path | None, _access("--certificate", metavar="FILE", help="Certificate and chain, PEM.")
    ] = None
    key: Annotated[
        Path | None, _access("--key", metavar="FILE", help="Private key of the certificate, PEM.")
    ] = None
    page_token: Annotated[
        Path | None,
        _access(
            "--page-token",
            metavar="FILE",
            help="File of the token, made if it is missing, so that the address stays the same.",
        ),
    ] = None

    def make_access(self, command: str, host: str) -> PageAccess:
        """Make the access to what is served.

        Args:
            command: To type, with its verb.
            host: Address to serve.

        Raises:
            Exposed: It would be open to other hosts, and no option permits it.
            ValueError: Options contradict each other.
            OSError: The file of the token cannot be used.
        """
        check_page_exposure(
            command,
            host,
            has_tls=check_certificate(self.certificate, self.key),
            is_secure=self.secure,
            is_insecure=self.insecure,
        )
        token = read_page_token(self.page_token) if self.secure else ""
        return PageAccess(token, str(self.certificate or ""), str(self.key or ""))

    def write_address(self, what: str, url: str) -> str:
        """Write the address of what is served for people, with its token on a terminal only.

        Elsewhere, as in the log of a service, it is followed by the file that has the token.

        Args:
            what: One word.
            url: With the token, if one is needed.

        Raises:
            OSError: The file of the token cannot be written.
        """
        bare, token = split_token(url)
        if not token or sys.stdout.isatty():
            return f"{what} {url}"
        file = self.page_token or keep_token(token, f"{what}-{split_url(url).port}")
        return f"{what} {bare}\nits token is in {file}; add ?{TOKEN_NAME}=TOKEN to the address"


@dataclass(frozen=True, kw_only=True)
class ClientOptions(ConnectionOptions):
    """The server to call, and how long to wait for its replies."""

    timeout: TimeoutOption = 10.0


@dataclass(frozen=True, kw_only=True)
class RosOptions:
    """ROS 2 options of a program that does not publish tf."""

    ros_choice: RosChoice = USUAL_ROS

    @property
    def ros(self) -> RosSettings:
        """Settings made from the options.

        Raises:
            ValueError: See `read_ros_settings`.
        """
        return read_ros_settings(self.ros_choice)


@dataclass(frozen=True, kw_only=True)
class RosTfOptions(RosOptions):
    """ROS 2 options of a program that publishes tf."""

    tf_choice: TfChoice = USUAL_TF

    @property
    def ros(self) -> RosSettings:
        """See `RosOptions`."""
        return read_ros_settings(self.ros_choice, self.tf_choice)
