"""Options of typer, made from settings."""

import inspect
from pathlib import Path
from typing import Annotated, Any, get_origin

import msgspec
import typer

from zensim.proto.settings.setting import SettingField, list_settings, spell_flags, write_help


def make_option_parameters(group: type[msgspec.Struct]) -> list[inspect.Parameter]:
    """Make a parameter of a command for each setting of a group."""
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=_find_default(field),
            annotation=Annotated[_find_kind(field), make_option(field)],
        )
        for field in list_settings(group)
    ]


def make_option(field: SettingField) -> Any:  # noqa: ANN401
    """Make the option of a setting."""
    setting, is_switch = field.setting, field.kind is bool
    return typer.Option(
        field.spelling,
        # typer would show the type of a switch as <bool>.
        metavar="" if is_switch else setting.metavar or "|".join(field.choices),
        # Rich reads a plain [m] as markup and drops it.
        help=spell_flags(write_help(field)).replace("[", r"\["),
        show_default=spell_flags(setting.usual) if setting.usual else True,
        envvar=list(setting.variables) or None,
        autocompletion=setting.complete,
        rich_help_panel=setting.panel or None,
    )


def _find_kind(field: SettingField) -> Any:  # noqa: ANN401
    """Find the type of an option: words are checked with the group, which names the setting."""
    if field.choices:
        return str
    if get_origin(field.kind) is tuple:
        return list[Path] | None
    return field.kind | None if field.is_optional else field.kind


def _find_default(field: SettingField) -> object:
    if field.choices:
        return field.default or ""
    return field.default or None if get_origin(field.kind) is tuple else field.default
