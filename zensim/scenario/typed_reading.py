"""Checks nodes against types: units are applied, and every mistake is found, with its place."""

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

from msgspec import inspect

from zensim.scenario.quantities import (
    DRAW_KINDS,
    LEAST_SHARE,
    PAIRS,
    Draw,
    PlainValue,
    can_draw,
    list_units,
    parse_quantity,
)
from zensim.scenario.scenario_nodes import Issue, Place, ScenarioNode

MAX_LISTED = 24
"""Most words that an error lists."""
PAIR = 2
OUTSIDE_OF_SCENARIOS = ("net_", "server_")
"""Beginnings of kinds of faults that chaos tests have."""

_Reader = Callable[[ScenarioNode, Any, str, str], PlainValue]


class TypedReader:
    """Reads nodes as a type, to plain values; numbers are SI, draws are `Draw`."""

    def __init__(self) -> None:
        self.issues: list[Issue] = []
        self.places: dict[str, Place] = {}
        """Place of every key path that was read."""
        self.has_draws = False
        """Whether a value is a draw."""
        self._unions: dict[int, tuple[inspect.UnionType, _UnionPlan]] = {}
        """Plans by identity of the type, with the type, which stays as long as this does."""
        self._readers: Mapping[type, _Reader] = {
            inspect.AnyType: self._read_any,
            inspect.NoneType: self._read_none,
            inspect.BoolType: self._read_bool,
            inspect.StrType: self._read_text,
            inspect.IntType: self._read_whole,
            inspect.FloatType: self._read_number,
            inspect.LiteralType: self._read_choice,
            inspect.VarTupleType: self._read_list,
            inspect.ListType: self._read_list,
            inspect.TupleType: self._read_tuple,
            inspect.DictType: self._read_map,
            inspect.StructType: self._read_struct,
            inspect.UnionType: self._read_union,
        }

    def read(self, node: ScenarioNode, kind: inspect.Type, path: str, unit: str = "") -> PlainValue:
        """Read a node; mistakes are added to `issues`, and None stands for what is wrong.

        Args:
            node: The value.
            kind: Its type, of `msgspec.inspect`.
            path: Its key path.
            unit: SI unit of its numbers; empty = without one.
        """
        while type(kind) is inspect.Metadata:
            if kind.extra:
                unit = kind.extra.get("unit", unit)
            kind = kind.type
        self.places[path] = node.place
        return self._readers[type(kind)](node, kind, path, unit)

    def refuse(self, place: Place, path: str, message: str) -> None:
        """Add a mistake."""
        self.issues.append(Issue(place, path, message))

    def _read_any(
        self, node: ScenarioNode, _kind: inspect.Type, path: str, _unit: str
    ) -> PlainValue:
        return to_plain(node, lambda place, message: self.refuse(place, path, message))

    def _read_none(self, node: ScenarioNode, _kind: inspect.Type, path: str, _unit: str) -> None:
        if node.value is not None:
            self.refuse(node.place, path, f"{_show(node)} is not null")

    def _read_bool(
        self, node: ScenarioNode, _kind: inspect.Type, path: str, _unit: str
    ) -> PlainValue:
        if not isinstance(node.value, bool):
            self.refuse(node.place, path, f"{_show(node)} is not true or false")
            return None
        return node.value

    def _read_text(
        self, node: ScenarioNode, kind: inspect.StrType, path: str, _unit: str
    ) -> str | None:
        if not isinstance(node.value, str):
            is_scalar = not isinstance(node.value, dict | list)
            advice = "; write it in quotes" if is_scalar and node.value is not None else ""
            self.refuse(node.place, path, f"{_show(node)} is not text{advice}")
            return None
        if kind.pattern is not None and re.search(kind.pattern, node.value) is None:
            form = "letters, digits and _, a letter first" if "63" not in kind.pattern else ""
            form = (
                "module:Class"
                if ":" in kind.pattern
                else form or ("1 to 63 letters, digits and _, a letter first")
            )
            self.refuse(node.place, path, f"{_show(node)} does not have the form {form}")
            return None
        return node.value

    def _read_whole(
        self, node: ScenarioNode, kind: inspect.IntType, path: str, _unit: str
    ) -> PlainValue:
        if not isinstance(node.value, int) or isinstance(node.value, bool):
            self.refuse(node.place, path, f"{_show(node)} is not a whole number")
            return None
        return self._check_range(node, kind, path, node.value)

    def _read_number(
        self, node: ScenarioNode, kind: inspect.FloatType, path: str, unit: str
    ) -> PlainValue:
        if unit and node.is_map:
            return self._read_draw(node, kind, path, unit)
        number = _find_number(node, unit)
        if number is None:
            self.refuse(node.place, path, f"{_show(node)} is not a number{_tell_units(unit)}")
            return None
        if not math.isfinite(number):
            self.refuse(node.place, path, f"{_show(node)} is not finite")
            return None
        return self._check_range(node, kind, path, number)

    def _check_range(
        self,
        node: ScenarioNode,
        kind: inspect.FloatType | inspect.IntType,
        path: str,
        number: PlainValue,
    ) -> PlainValue:
        if kind.ge is kind.gt is kind.le is None:
            return number
        low, high = _find_limits(kind)
        if low <= number <= high:
            return number
        self.refuse(node.place, path, f"{_show(node)} is out of range; {_tell_range(kind)}")
        return None

    def _read_draw(
        self, node: ScenarioNode, kind: inspect.FloatType, path: str, unit: str
    ) -> Draw | None:
        words = [word for word in node.items if word in DRAW_KINDS]
        if len(node.items) != 1 or not words:
            advice = f"a number{_tell_units(unit)}, or one of {', '.join(DRAW_KINDS)}: [...]"
            self.refuse(node.place, path, f"a map is not a number; use {advice}")
            return None
        word = words[0]
        listed, here = node.items[word], f"{path}.{word}"
        limits = inspect.FloatType() if word == "normal" else kind
        values = [
            self._read_number(one, limits, f"{here}[{index}]", unit)
            for index, one in enumerate(listed.elements)
        ]
        if not values or (word != "choice" and len(values) != PAIR):
            self.refuse(listed.place, here, f"needs {PAIRS.get(word, 'a list of numbers')}")
            return None
        if None in values:
            return None
        if not can_draw(word, values):
            self.refuse(listed.place, here, f"needs two numbers, {PAIRS[word]}")
            return None
        draw = Draw(word, tuple(values), _find_limits(kind))
        if word == "normal" and draw.share < LEAST_SHARE:
            mistake = (
                f"next to no number of it is in the range {_tell_range(kind)}; change the mean"
            )
            self.refuse(listed.place, here, mistake)
            return None
        self.has_draws = True
        return draw

    def _read_choice(
        self, node: ScenarioNode, kind: inspect.LiteralType, path: str, _unit: str
    ) -> PlainValue:
        if isinstance(node.value, dict | list) or not any(
            node.value == one and type(node.value) is type(one) for one in kind.values
        ):
            self.refuse(node.place, path, _tell_choices(_show(node), kind.values, node.value))
            return None
        return node.value

    def _read_list(
        self,
        node: ScenarioNode,
        kind: inspect.VarTupleType | inspect.ListType,
        path: str,
        unit: str,
    ) -> list[Any] | None:
        if not isinstance(node.value, list):
            self.refuse(node.place, path, f"{_show(node)} is not a list; write [...] or `- ...`")
            return None
        if kind.min_length is not None and len(node.value) < kind.min_length:
            self.refuse(node.place, path, f"needs at least {kind.min_length} entries")
        return [
            self.read(one, kind.item_type, f"{path}[{index}]", unit)
            for index, one in enumerate(node.value)
        ]

    def _read_tuple(
        self, node: ScenarioNode, kind: inspect.TupleType, path: str, unit: str
    ) -> list[Any] | None:
        count = len(kind.item_types)
        if not isinstance(node.value, list) or len(node.value) != count:
            self.refuse(node.place, path, f"{_show(node)} is not a list of {count}")
            return None
        return [
            self.read(one, item, f"{path}[{index}]", unit)
            for index, (one, item) in enumerate(zip(node.value, kind.item_types, strict=True))
        ]

    def _read_map(
        self, node: ScenarioNode, kind: inspect.DictType, path: str, unit: str
    ) -> dict[str, Any] | None:
        if not isinstance(node.value, dict):
            self.refuse(node.place, path, f"{_show(node)} is not a map of keys and values")
            return None
        return {
            key: self.read(one, kind.value_type, f"{path}.{key}", unit)
            for key, one in node.value.items()
        }

    def _read_struct(
        self, node: ScenarioNode, kind: inspect.StructType, path: str, _unit: str
    ) -> dict[str, Any] | None:
        if not isinstance(node.value, dict):
            self.refuse(node.place, path, f"{_show(node)} is not a map of keys and values")
            return None
        fields = _index_fields(kind.cls)
        dot = f"{path}." if path else ""
        found: dict[str, Any] = {}
        for key, one in node.value.items():
            if key == kind.tag_field:
                found[key] = one.value
            elif key in fields:
                found[key] = self.read(one, fields[key].type, dot + key)
            else:
                message = _tell_choices(f"unknown key `{key}`", [*fields], key, is_key=True)
                self.refuse(node.key_places[key], dot + key, message)
        for key in _list_required(kind.cls):
            if key not in node.value:
                self.refuse(node.place, dot + key, f"the key `{key}` is missing")
        return found

    def _read_union(
        self, node: ScenarioNode, kind: inspect.UnionType, path: str, unit: str
    ) -> PlainValue:
        if (found := self._unions.get(id(kind))) is None:
            found = self._unions[id(kind)] = kind, _plan_union(kind)
        _, plan = found
        if node.value is None and plan.has_null:
            return None
        if plan.by_tag is not None:
            return self._read_tagged(node, plan.by_tag, plan.tag_field, path)
        return self.read(node, plan.choose(node), path, unit)

    def _read_tagged(
        self, node: ScenarioNode, by_tag: Mapping[str, inspect.StructType], field: str, path: str
    ) -> PlainValue:
        if not isinstance(node.value, dict) or field not in node.value:
            self.refuse(node.place, path, f"the key `{field}` is missing; one of {_join(by_tag)}")
            return None
        tag = node.value[field]
        self.places[f"{path}.{field}"] = tag.place
        if not isinstance(tag.value, str) or tag.value not in by_tag:
            message = _tell_choices(_show(tag), [*by_tag], tag.value)
            if str(tag.value).startswith(OUTSIDE_OF_SCENARIOS):
                message = (
                    f"{_show(tag)} needs root or ends the server, which has no control step then; "
                    "use `make chaos`, or command_loss, command_delay, sensor_delay"
                )
            self.refuse(tag.place, f"{path}.{field}", message)
            return None
        return self.read(node, by_tag[tag.value], path)


class _UnionPlan(NamedTuple):
    """How the values of a union are told apart."""

    has_null: bool
    by_tag: Mapping[str, inspect.StructType] | None
    """Structs by their tag, if they have one."""
    tag_field: str
    of_list: inspect.Type
    of_map: inspect.Type
    of_scalar: inspect.Type

    def choose(self, node: ScenarioNode) -> inspect.Type:
        """Choose the type that has the form of a node, else the first one."""
        if isinstance(node.value, list):
            return self.of_list
        return self.of_map if isinstance(node.value, dict) else self.of_scalar


def _plan_union(kind: inspect.UnionType) -> _UnionPlan:
    parts = [_strip(one) for one in kind.types]
    some = [one for one in parts if not isinstance(one, inspect.NoneType)]
    structs = [one for one in some if isinstance(one, inspect.StructType)]
    is_tagged = len(structs) > 1 and structs[0].tag_field is not None

    def choose(*kinds: type[inspect.Type]) -> inspect.Type:
        return next((one for one in some if isinstance(one, kinds)), some[0])

    return _UnionPlan(
        has_null=len(some) < len(parts),
        by_tag={str(one.tag): one for one in structs} if is_tagged else None,
        tag_field=(structs[0].tag_field or "") if is_tagged else "",
        of_list=choose(inspect.VarTupleType, inspect.ListType, inspect.TupleType),
        of_map=choose(inspect.StructType, inspect.DictType),
        of_scalar=choose(inspect.StrType, inspect.LiteralType),
    )


@cache
def _index_fields(cls: type) -> dict[str, inspect.Field]:
    kind = inspect.type_info(cls)
    return {field.encode_name: field for field in kind.fields}  # type: ignore[attr-defined]


@cache
def _list_required(cls: type) -> tuple[str, ...]:
    return tuple(name for name, field in _index_fields(cls).items() if field.required)


def _strip(kind: inspect.Type) -> inspect.Type:
    """Get a type without its metadata, unless that has a unit."""
    is_plain = isinstance(kind, inspect.Metadata) and not kind.extra
    return kind.type if is_plain else kind  # type: ignore[attr-defined]


def _find_number(node: ScenarioNode, unit: str) -> float | None:
    if type(node.value) is float:
        return node.value
    if isinstance(node.value, str) and unit:
        return parse_quantity(node.value, unit)
    if isinstance(node.value, bool) or not isinstance(node.value, int | float):
        return None
    try:
        return float(node.value)
    except OverflowError:
        return math.inf


def _find_limits(kind: inspect.FloatType | inspect.IntType) -> tuple[float, float]:
    """Find the smallest and the largest number of a type."""
    above = -math.inf if kind.gt is None else math.nextafter(kind.gt, math.inf)
    return above if kind.ge is None else kind.ge, math.inf if kind.le is None else kind.le


def _tell_range(kind: inspect.FloatType | inspect.IntType) -> str:
    words = ((">=", kind.ge), (">", kind.gt), ("<=", kind.le))
    return " and ".join(f"{word} {limit:g}" for word, limit in words if limit is not None)


def _tell_units(unit: str) -> str:
    if unit in ("", "1"):
        return "" if not unit else " or a share in %"
    return f" [{unit}]; units: {list_units(unit)}"


def _tell_choices(
    subject: str, choices: Sequence[Any], given: PlainValue, *, is_key: bool = False
) -> str:
    head = subject if is_key else f"{subject} is not known"
    if any(given == str(one) and not isinstance(one, str) for one in choices):
        return f"{subject} is text, and a number is wanted; write it without quotes"
    words = [str(one) for one in choices if one != ""]
    near = difflib.get_close_matches(given, words, 1) if isinstance(given, str) else []
    if near:
        return f"{head}; did you mean `{near[0]}`?{'' if is_key else f' One of {_join(words)}'}"
    return f"{head}; one of {_join(words)}"


def _join(words: Sequence[str] | Mapping[str, Any]) -> str:
    listed = [*words]
    more = ", …" if len(listed) > MAX_LISTED else ""
    return ", ".join(listed[:MAX_LISTED]) + more


def _show(node: ScenarioNode) -> str:
    if isinstance(node.value, dict):
        return "a map"
    if isinstance(node.value, list):
        return "a list"
    if node.value is None:
        return "nothing (null)"
    text = str(node.value).lower() if isinstance(node.value, bool) else str(node.value)
    return f"`{text if len(text) <= 60 else f'{text[:59]}…'}`"  # noqa: PLR2004


def to_plain(node: ScenarioNode, refuse: Callable[[Place, str], None]) -> PlainValue:
    """Convert nodes to plain values; numbers that are not finite are refused."""
    if isinstance(node.value, dict):
        return {key: to_plain(one, refuse) for key, one in node.value.items()}
    if isinstance(node.value, list):
        return [to_plain(one, refuse) for one in node.value]
    if isinstance(node.value, float) and not math.isfinite(node.value):
        refuse(node.place, f"{_show(node)} is not finite")
    return node.value


def find_type(cls: type, path: Sequence[str], tag: str = "") -> inspect.Type | None:
    """Find the type of a key below a struct; entries of lists are passed by name or index.

    Args:
        cls: The struct.
        path: Words of the key path.
        tag: Kind of the entry, where entries are of several kinds; empty = the first kind that
            has the key.
    """
    kinds: list[inspect.Type] = [inspect.type_info(cls)]
    for word in path:
        kinds = [found for kind in kinds for found in _descend(kind, word, tag)]
    return kinds[0] if kinds else None


def _descend(kind: inspect.Type, word: str, tag: str) -> list[inspect.Type]:
    bare = kind.type if isinstance(kind, inspect.Metadata) else kind
    if isinstance(bare, inspect.UnionType):
        return [found for one in bare.types for found in _descend(one, word, tag)]
    if isinstance(bare, inspect.VarTupleType | inspect.ListType):
        return [bare.item_type]
    if isinstance(bare, inspect.DictType):
        return [bare.value_type]
    if isinstance(bare, inspect.TupleType) and word.isdecimal():
        return list(bare.item_types[int(word) : int(word) + 1])
    if isinstance(bare, inspect.StructType) and (not tag or bare.tag in (None, tag)):
        return [field.type for name, field in _index_fields(bare.cls).items() if name == word]
    return []
