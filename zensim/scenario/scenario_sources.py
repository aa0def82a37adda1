"""Files of a scenario: included files, merged values, and values that the command line sets."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

from zensim.proto.bounded_files import read_text_file
from zensim.scenario.scenario_nodes import (
    Issue,
    Place,
    ScenarioInvalid,
    ScenarioNode,
    fail_at,
    name_of,
    read_nodes,
    resolve_scalar,
)

MAX_INCLUDES = 100
_PLAIN_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9_./-]*")
_WORD = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


def read_merged_nodes(file: str, settings: Sequence[str] = ()) -> ScenarioNode:
    """Read a file with all that it includes, and set values.

    Args:
        file: Path of the file.
        settings: `KEY.PATH=VALUE`, as of `--set`.

    Raises:
        ScenarioInvalid: A file is missing, includes itself or is not YAML; a setting has no place.
    """
    return apply_settings(_read_with_includes(Path(file), (), Place(file), [0]), settings)


def apply_settings(node: ScenarioNode, settings: Sequence[str]) -> ScenarioNode:
    """Set values of a scenario.

    Args:
        node: The whole scenario.
        settings: `KEY.PATH=VALUE`, as of `--set`.

    Raises:
        ScenarioInvalid: A setting has no place.
    """
    for setting in settings:
        node = _apply_setting(node, setting)
    return node


def write_setting(path: str, value: object) -> str:
    """Write a setting that sets a plain value: SI numbers, texts, lists and maps."""
    if isinstance(value, str) and _is_plain(value):
        return f"{path}={value}"
    return f"{path}={json.dumps(value, ensure_ascii=False)}"


def _is_plain(text: str) -> bool:
    """Whether YAML reads a text without quotes as that text."""
    return _PLAIN_TEXT.fullmatch(text) is not None and resolve_scalar(text) == text


def _read_with_includes(
    file: Path, above: tuple[Path, ...], place: Place, count: list[int]
) -> ScenarioNode:
    count[0] += 1
    if count[0] > MAX_INCLUDES:
        raise fail_at(place, "include", f"more than {MAX_INCLUDES} files are included")
    text = _read_text(file, place)
    resolved = file.resolve()
    if resolved in above:
        loop = " -> ".join(one.name for one in (*above[above.index(resolved) :], resolved))
        raise fail_at(place, "include", f"`{file}` includes itself: {loop}")
    node = read_nodes(text, str(file))
    if not node.is_map:
        raise fail_at(node.place, "", "a scenario is a map of keys and values, such as `zensim: 1`")
    base: ScenarioNode | None = None
    issues: list[Issue] = []
    for index, one in enumerate(_list_includes(node)):
        path = f"include[{index}]"
        try:
            if not isinstance(one.value, str):
                raise fail_at(one.place, path, "is not a path")
            part = _read_with_includes(
                file.parent / one.value, (*above, resolved), one.place, count
            )
            base = part if base is None else merge_nodes(base, part)
        except ScenarioInvalid as error:
            issues += error.issues
    if issues:
        raise ScenarioInvalid(tuple(issues))
    return node if base is None else merge_nodes(base, node)


def _list_includes(node: ScenarioNode) -> list[ScenarioNode]:
    listed = node.items.get("include")
    if listed is None:
        return []
    return listed.elements if isinstance(listed.value, list) else []


def _read_text(file: Path, place: Place) -> str:
    path = "include" if place.line else ""
    try:
        return read_text_file(file)
    except UnicodeDecodeError as error:
        raise fail_at(Place(str(file)), path, "is not text in UTF-8") from error
    except OSError as error:
        reason = (error.strerror or "cannot be read").lower()
        raise fail_at(place, path, f"`{file}`: {reason}") from error
    except ValueError as error:
        raise fail_at(place, path, "is not a path") from error


def merge_nodes(base: ScenarioNode, over: ScenarioNode) -> ScenarioNode:
    """Merge two values: maps key by key, named entries by name; else the second replaces."""
    if base.is_map and over.is_map:
        values = dict(base.items)
        for key, one in over.items.items():
            values[key] = merge_nodes(values[key], one) if key in values else one
        places = {**base.key_places, **over.key_places}
        return ScenarioNode(over.place, values, places)
    if _is_named_list(base) and _is_named_list(over):
        entries = {name_of(one): one for one in base.elements}
        for one in over.elements:
            name = name_of(one)
            entries[name] = merge_nodes(entries[name], one) if name in entries else one
        return ScenarioNode(over.place, [*entries.values()])
    return over


def _is_named_list(node: ScenarioNode) -> bool:
    names = [name_of(one) for one in node.elements]
    return bool(names) and all(names) and len(set(names)) == len(names)


def _apply_setting(node: ScenarioNode, setting: str) -> ScenarioNode:
    place = Place(f"--set {setting}")
    path, equals, text = setting.partition("=")
    words = split_path(path.strip())
    if not equals or not words:
        raise fail_at(place, "", "is not KEY.PATH=VALUE, such as robots.cart.count=8")
    value = _replace_places(read_nodes(text, place.file), place)
    return _set_value(node, words, value, path)


def split_path(path: str) -> list[str]:
    """Split a key path, `a.b[0].c`, into its words; empty if it is none."""
    words = [key or index for key, index in _WORD.findall(path)]
    return words if _WORD.sub("", path).strip(".") == "" else []


def _replace_places(node: ScenarioNode, place: Place) -> ScenarioNode:
    if node.is_map:
        values = {key: _replace_places(one, place) for key, one in node.items.items()}
        return ScenarioNode(place, values, dict.fromkeys(values, place))
    if isinstance(node.value, list):
        return ScenarioNode(place, [_replace_places(one, place) for one in node.value])
    return ScenarioNode(place, node.value)


def _set_value(
    node: ScenarioNode, words: Sequence[str], value: ScenarioNode, path: str
) -> ScenarioNode:
    if not words:
        return value
    word, *rest = words
    if isinstance(node.value, list):
        index = find_entry(node, word)
        if index is None:
            known = ", ".join(filter(None, map(name_of, node.elements))) or f"{len(node.value)}"
            raise fail_at(value.place, path, f"there is no entry `{word}`; entries: {known}")
        entries = list(node.value)
        entries[index] = _set_value(entries[index], rest, value, path)
        return ScenarioNode(node.place, entries)
    if not node.is_map and node.value is not None:
        raise fail_at(value.place, path, f"there is no key `{word}`: that value has no keys")
    inner = node.items.get(word, ScenarioNode(value.place, None))
    values = {**node.items, word: _set_value(inner, rest, value, path)}
    return ScenarioNode(node.place, values, {word: value.place, **node.key_places})


def find_entry(node: ScenarioNode, word: str) -> int | None:
    """Find an entry of a list by its name or index."""
    for index, one in enumerate(node.elements):
        if name_of(one) == word:
            return index
    return int(word) if word.isdecimal() and int(word) < len(node.elements) else None
