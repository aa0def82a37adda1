"""Dataclasses as groups of options of a command: a field is an option."""

import dataclasses
import inspect
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, TypeVar

import typer
from typer.models import ArgumentInfo

from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import ADDED_SWITCHES
from zensim.proto.settings.setting import is_settings, list_settings, make_settings
from zensim.proto.settings.setting_options import make_option_parameters
from zensim.proto.verbosity import CURRENT, set_verbosity

Options = TypeVar("Options")
MAX_NUMBER = 1e18
"""Greatest number of an option."""
RUNNING_CONTEXT: Final = inspect.Parameter(
    "running_context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context
)


def make_app(name: str = "", *, has_default: bool = False) -> "CommandApp":
    """Create the app of one module; its commands form a group if it has a name.

    Args:
        name: Of the group.
        has_default: Whether the group does something without a command; else it prints its help.
    """
    return CommandApp(
        name=name or None,
        no_args_is_help=bool(name) and not has_default,
        add_completion=False,
        pretty_exceptions_enable=False,
    )


class CommandApp(typer.Typer):
    """Commands whose parameters that are dataclasses become options."""

    def command(  # type: ignore[override]
        self,
        *words: Any,  # noqa: ANN401
        **settings: Any,  # noqa: ANN401
    ) -> Callable[[Callable[..., None]], Callable[..., None]]:
        """Add a command, after `expand_options` unless that was done."""
        add = super().command(*words, **settings)
        return lambda action: add(
            action if hasattr(action, "__signature__") else expand_options(action)
        )


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
                given[name] = make_group(group, given)
        action(**given)

    expanded = [
        part
        for parameter in parameters
        for part in (
            make_parameters(parameter.annotation) if parameter.name in groups else [parameter]
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
    spellings = [spelling for one in infos for spelling in list_spellings(one)]
    long = [one for one in spellings if one.startswith("--")]
    typed = next(iter((*long, *spellings)), f"--{name.replace('_', '-')}")
    return {name: typed} | {one.lstrip("-").replace("-", "_"): typed for one in spellings}


def name_group(group: type) -> dict[str, str]:
    """Name the settings of the options of a dataclass; see `name_settings`."""
    found: dict[str, str] = {}
    for one in make_parameters(group):
        found |= name_settings(one.name, one.annotation)
    return found


def list_spellings(info: object) -> list[str]:
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


def make_parameters(group: type) -> list[inspect.Parameter]:
    """Make the parameters of a command, one per option of a dataclass."""
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


def make_group(group: type[Options], given: dict[str, object]) -> Options:
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
