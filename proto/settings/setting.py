"""A setting: a field of a group, with all that its forms are made from.

Options of commands, keys of scenario files, keywords of the Python API, arguments of child
processes and documents are made from the groups. A group may have groups as fields; the settings
of all of them are named as if they were its own.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from numbers import Integral, Real
from types import UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeGuard,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec

Group = TypeVar("Group", bound=msgspec.Struct)
NUMBERS = (int, float)


class Setting(msgspec.Struct, frozen=True, kw_only=True):
    """What is known about a field that users can set, besides name, type and default."""

    help: str
    """One sentence; other settings in it are in backticks."""
    panel: str = ""
    """Title of its part of a command's help; empty = the first part."""
    metavar: str = ""
    """Form of the value; empty = the words of its type."""
    unit: str = ""
    """SI unit; `1` = a number without dimension."""
    clock: str = ""
    """Time that the unit counts, where that is not obvious."""
    least: float | None = None
    most: float | None = None
    usual: str = ""
    """Words for the default, where the value does not say it."""
    variables: tuple[str, ...] = ()
    """Environment variables that hold for all commands."""
    key: str = ""
    """Key in scenario files, `section.name`; empty = such files cannot set it."""
    pattern: str = ""
    """Regular expression of the texts that such files may have."""
    spelling: str = ""
    """Option of commands, where it is not made from the name; `--on/--off` of a switch."""
    complete: Callable[[str], list[str]] | None = None
    """Finds the values that begin with a text, while a command is typed."""
    key_words: tuple[str, str] | None = None
    """Words of such files for false and true."""
    key_default: object = msgspec.UNSET
    """Default in such files, where it differs."""


class SettingField(NamedTuple):
    """A setting with its name, type and default."""

    name: str
    kind: Any
    """Type of the values, without None."""
    is_optional: bool
    """Whether the value may be None."""
    default: Any
    setting: Setting

    @property
    def choices(self) -> tuple[str, ...]:
        """The words that the value may have; empty = others, too."""
        return get_args(self.kind) if get_origin(self.kind) is Literal else ()

    @property
    def is_path(self) -> bool:
        """Whether the value is the path of a file or folder."""
        return hasattr(self.kind, "__fspath__")

    @property
    def flag(self) -> str:
        """Spelling on a command line."""
        return self.spelling.partition("/")[0]

    @property
    def spelling(self) -> str:
        """Spelling on a command line, with that which turns a switch off."""
        return self.setting.spelling or f"--{self.name.replace('_', '-')}"


def list_settings(group: type[msgspec.Struct]) -> tuple[SettingField, ...]:
    """List the settings of a group and of the groups in it; fields that are none are left out."""
    return tuple(_index_settings(group).values())


def find_setting(group: type[msgspec.Struct], name: str) -> SettingField:
    """Find a setting of a group, or of the groups in it, by name."""
    return _index_settings(group)[name]


@cache
def _index_settings(group: type[msgspec.Struct]) -> Mapping[str, SettingField]:
    return {one.name: one for one in _find_settings(group)}


def _find_settings(group: type[msgspec.Struct]) -> Iterator[SettingField]:
    hints = get_type_hints(group, include_extras=True)
    for field in msgspec.structs.fields(group):
        hint = hints[field.name]
        kind, *metadata = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        if is_settings(kind):
            yield from _find_settings(kind)
        for one in metadata:
            if isinstance(one, Setting):
                plain, is_optional = _split_optional(kind)
                yield SettingField(field.name, plain, is_optional, field.default, one)


def _split_optional(kind: Any) -> tuple[Any, bool]:  # noqa: ANN401
    if get_origin(kind) not in (Union, UnionType):
        return kind, False
    (plain,) = (one for one in get_args(kind) if one is not type(None))
    return plain, True


def is_settings(kind: object) -> TypeGuard[type[msgspec.Struct]]:
    """Whether a type is a group of settings, or of groups."""
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def make_settings(group: type[Group], values: Mapping[str, object]) -> Group:
    """Make a group from values by name; those that are missing have their defaults.

    Raises:
        ValueError: A value is out of range, or no word of its setting.
    """
    return change_settings(group(), values)


def change_settings(settings: Group, values: Mapping[str, object]) -> Group:
    """Change settings of a group, and of the groups in it, by name; other names are ignored.

    Raises:
        ValueError: A value is out of range, or no word of its setting.
    """
    changes: dict[str, object] = {}
    own = {one.name for one in list_settings(type(settings))}
    for name in settings.__struct_fields__:
        before = getattr(settings, name)
        if isinstance(before, msgspec.Struct):
            changes[name] = change_settings(before, values)
        elif name in own and name in values:
            changes[name] = _read_value(_index_settings(type(settings))[name], values[name])
    return msgspec.structs.replace(settings, **changes) if changes else settings


def read_settings(settings: msgspec.Struct) -> dict[str, object]:
    """Read the values of a group, and of the groups in it, by name."""
    found: dict[str, object] = {}
    own = _index_settings(type(settings))
    for name in settings.__struct_fields__:
        value = getattr(settings, name)
        if isinstance(value, msgspec.Struct):
            found |= read_settings(value)
        elif name in own:
            found[name] = value
    return found


def check_settings(settings: msgspec.Struct) -> None:
    """Check all values of a group, and of the groups in it.

    Raises:
        ValueError: A value is out of range, or no word of its setting.
    """
    known = _index_settings(type(settings))
    for name, value in read_settings(settings).items():
        _read_value(known[name], value)


def _read_value(field: SettingField, value: Any) -> object:  # noqa: ANN401
    if value is None or (value == "" and (field.choices or field.is_path)):
        return field.default
    if field.is_path:
        return field.kind(value)
    if get_origin(field.kind) is tuple:
        return tuple(map(str, value))
    if field.choices:
        if value not in field.choices:
            raise ValueError(
                f"`{field.name}` must be one of {', '.join(field.choices)}; got {str(value)[:40]!r}"
            )
    elif field.kind in NUMBERS:
        _check_range(field, value)
    return value


def _check_range(field: SettingField, value: Any) -> None:  # noqa: ANN401
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not (is_whole or (field.kind is float and isinstance(value, Real))):
        what = "no number" if field.kind is float else "no whole number"
        raise ValueError(f"`{field.name}` {str(value)[:40]!r} is {what}")
    least, most = field.setting.least, field.setting.most
    if least is None and most is None:
        return
    if not (least is None or value >= least) or not (most is None or value <= most):
        raise ValueError(f"`{field.name}` {value:g} is out of range; use {describe_range(field)}")


def describe_range(field: SettingField) -> str:
    """Describe the range of a number in words."""
    least, most, unit = field.setting.least, field.setting.most, field.setting.unit
    unit = "" if unit in ("", "1") else f" {unit}"
    if least is None:
        return "" if most is None else f"at most {most:g}{unit}"
    return (
        f"{least:g} or more{unit}" if most is None else f"{least:g} to {_write_limit(most)}{unit}"
    )


def read_key_value(field: SettingField, value: object) -> object:
    """Read a value of a scenario file, which may have words for false and true."""
    words = field.setting.key_words
    return value if words is None else value == words[1]


def _write_limit(most: float) -> str:
    whole = int(most) + 1
    is_of_words = most > 1 << 53 and whole.bit_count() == 1
    return f"2^{whole.bit_length() - 1} - 1" if is_of_words else f"{most:g}"


def write_help(field: SettingField) -> str:
    """Write the help of a setting with its unit in brackets."""
    setting = field.setting
    if setting.unit in ("", "1"):
        return setting.help
    unit = ", ".join(filter(None, (setting.unit, setting.clock)))
    return re.sub(r"(?=[;.])", f" [{unit}]", setting.help, count=1)


def spell_flags(text: str) -> str:
    """Write the settings that a text names in backticks as a command line spells them."""
    return re.sub(r"`(\w+)`", lambda found: f"--{found[1].replace('_', '-')}", text)


def write_words(
    settings: msgspec.Struct, group: type[msgspec.Struct] | None = None
) -> tuple[str, ...]:
    """Write settings as words of a command line.

    Defaults are left out, but for names that a variable of the other program could replace.

    Args:
        settings: Values.
        group: The settings that the command has; all if it is not given.
    """
    values = read_settings(settings)
    words: list[str] = []
    for field in list_settings(group or type(settings)):
        value = values[field.name]
        is_needed = bool(field.setting.variables and field.kind is str and value)
        if is_needed or value != field.default:
            words += _write_option(field, value)
    return tuple(words)


def _write_option(field: SettingField, value: object) -> list[str]:
    on, _, off = field.spelling.partition("/")
    if isinstance(value, bool):
        return [word for word in (on if value else off,) if word]
    if isinstance(value, tuple):
        return [word for one in value for word in (on, str(one))]
    return [on, "" if value is None else str(value)]
