"""Options that are parsed without typer, whose import takes long."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, get_args

from typer.models import ArgumentInfo, OptionInfo

from zensim.proto.options.option_groups import (
    MAX_NUMBER,
    list_spellings,
    make_group,
    make_parameters,
)

Options = TypeVar("Options")


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
    parameters = make_parameters(group)
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
        return make_group(group, {one.name: one.default for one in parameters} | given)
    return None


def _index_options(
    parameters: Iterable[inspect.Parameter],
) -> dict[str, tuple[inspect.Parameter, OptionInfo]]:
    """Index the options that can be parsed without typer by their spellings."""
    found = {}
    for one in parameters:
        kind, info = get_args(one.annotation)
        if isinstance(info, OptionInfo) and (kind is bool or kind in PLAIN_TYPES):
            spellings = list_spellings(info) or [f"--{one.name.replace('_', '-')}"]
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
