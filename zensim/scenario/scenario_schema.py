"""JSON Schema and reference of scenario files, made from the types of the format.

`python -m zensim.scenario.scenario_schema` writes both.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from msgspec import inspect

from zensim.scenario.quantities import DRAW_KINDS, UNITS
from zensim.scenario.scenario_format import FORMAT_VERSION, ScenarioFormat

SCHEMA_FILE = Path(__file__).parent / f"scenario-{FORMAT_VERSION}.schema.json"
REFERENCE_HEAD = "## Reference\n\n"
REFERENCE_PAGE = Path("docs") / "scenarios.md"
_NUMBER = r"^[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
Schema = dict[str, Any]


def make_schema() -> Schema:
    """Make the JSON Schema (2020-12) of the format."""
    definitions: dict[str, Schema] = {_name_quantity(unit): _quantity(unit) for unit in UNITS}
    root = _Translation(definitions).translate(inspect.type_info(ScenarioFormat))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"zensim scenario, version {FORMAT_VERSION}",
        **definitions[root["$ref"].rsplit("/", 1)[1]],
        "$defs": dict(sorted(definitions.items())),
    }


def format_schema() -> str:
    """Write the JSON Schema as text."""
    return json.dumps(make_schema(), indent=1, ensure_ascii=False) + "\n"


def _name_quantity(unit: str) -> str:
    """Name the definition of a quantity, without characters that references escape."""
    return "quantity_" + re.sub(r"[^a-zA-Z0-9]+", "_", unit.replace("/", "_per_"))


def _quantity(unit: str) -> Schema:
    """Describe a number, a number with a unit, or a draw."""
    words = "|".join(re.escape(word) for word in UNITS[unit])
    number = {
        "anyOf": [{"type": "number"}, {"type": "string", "pattern": f"{_NUMBER}\\s*({words})?$"}]
    }
    pair = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
    several = {"type": "array", "items": number, "minItems": 1}
    draws = [
        {
            "type": "object",
            "properties": {kind: several if kind == "choice" else pair},
            "required": [kind],
            "additionalProperties": False,
        }
        for kind in DRAW_KINDS
    ]
    return {"anyOf": [*number["anyOf"], *draws]}


class _Translation:
    """Translation of types to schemas; structs become definitions."""

    def __init__(self, definitions: dict[str, Schema]) -> None:
        self._definitions = definitions

    def translate(self, kind: inspect.Type, unit: str = "") -> Schema:
        """Translate a type."""
        if isinstance(kind, inspect.Metadata):
            return self._translate_metadata(kind, unit)
        if isinstance(kind, inspect.StructType):
            return self._translate_struct(kind)
        if isinstance(kind, inspect.UnionType):
            return {"anyOf": [self.translate(one, unit) for one in kind.types]}
        return self._translate_collection(kind) or _translate_scalar(kind, unit)

    def _translate_collection(self, kind: inspect.Type) -> Schema:
        if isinstance(kind, inspect.DictType):
            return {"type": "object", "additionalProperties": self.translate(kind.value_type)}
        if isinstance(kind, inspect.VarTupleType):
            least = {"minItems": kind.min_length} if kind.min_length is not None else {}
            return {"type": "array", "items": self.translate(kind.item_type), **least}
        if isinstance(kind, inspect.TupleType):
            items = [self.translate(one) for one in kind.item_types]
            return {"type": "array", "prefixItems": items, "minItems": len(items), "items": False}
        return {}

    def _translate_metadata(self, kind: inspect.Metadata, unit: str) -> Schema:
        own = (kind.extra or {}).get("unit", unit)
        described = dict(kind.extra_json_schema or {})
        if own:
            described["description"] = f"{described.get('description', '')} [{own}]".strip()
        return {**self.translate(kind.type, own), **described}

    def _translate_struct(self, kind: inspect.StructType) -> Schema:
        name = kind.cls.__name__
        if name not in self._definitions:
            self._definitions[name] = {}
            properties = {
                field.encode_name: {**self.translate(field.type), **_give_default(field)}
                for field in kind.fields
            }
            required = [field.encode_name for field in kind.fields if field.required]
            if kind.tag_field is not None:
                properties = {kind.tag_field: {"const": kind.tag}, **properties}
                required = [kind.tag_field, *required]
            self._definitions[name] = {
                "type": "object",
                "description": _describe_class(kind.cls),
                "properties": properties,
                "required": required,
                "additionalProperties": False,
            }
        return {"$ref": f"#/$defs/{name}"}


def _translate_scalar(kind: inspect.Type, unit: str) -> Schema:
    if isinstance(kind, inspect.LiteralType):
        return {"enum": list(kind.values)}
    if isinstance(kind, inspect.FloatType):
        return {"$ref": f"#/$defs/{_name_quantity(unit)}"} if unit else {"type": "number"}
    if isinstance(kind, inspect.IntType):
        limits = {"minimum": kind.ge, "maximum": kind.le}
        found = {word: value for word, value in limits.items() if value is not None}
        return {"type": "integer", **found}
    if isinstance(kind, inspect.StrType):
        return {"type": "string", **({"pattern": kind.pattern} if kind.pattern else {})}
    names = {inspect.BoolType: "boolean", inspect.NoneType: "null"}
    return {"type": names[type(kind)]} if type(kind) in names else {}


def _describe_class(cls: type) -> str:
    return " ".join((cls.__doc__ or "").split())


def _give_default(field: inspect.Field) -> Schema:
    if field.default is msgspec.NODEFAULT or isinstance(field.default, msgspec.Struct):
        return {}
    return {"default": msgspec.to_builtins(field.default)}


def make_reference() -> str:
    """Write the reference of all keys as Markdown; keys of all kinds of a section stand once."""
    root = next(_find_structs(inspect.type_info(ScenarioFormat)))
    parts = [_format_table("A scenario", root)]
    for field in root.fields:
        structs = list(_find_structs(field.type))
        shared = _find_shared_rows(structs)
        if shared:
            parts.append(
                _format_keys(f"`{field.encode_name}`, all kinds", "Keys of each kind.", shared)
            )
        parts += [_format_kind(field.encode_name, kind, shared) for kind in structs]
        parts += [
            _format_table(f"`{inner.encode_name}` of `{field.encode_name}`", one)
            for kind in structs[:1]
            for inner in kind.fields
            if kind.tag_field is None or inner.encode_name == "when"
            for one in _find_structs(inner.type)
        ]
    units = "\n".join(f"| {unit} | {', '.join(words)} |" for unit, words in UNITS.items())
    parts.append(f"### Units\n\n| SI | may be written |\n|---|---|\n{units}\n")
    return "\n".join(parts)


def _find_structs(kind: inspect.Type) -> Iterator[inspect.StructType]:
    """Find the structs of a type, also in lists and unions."""
    if isinstance(kind, inspect.StructType):
        yield kind
    elif isinstance(kind, inspect.Metadata):
        yield from _find_structs(kind.type)
    elif isinstance(kind, inspect.VarTupleType):
        yield from _find_structs(kind.item_type)
    elif isinstance(kind, inspect.UnionType):
        for one in kind.types:
            yield from _find_structs(one)


def _find_shared_rows(kinds: Sequence[inspect.StructType]) -> list[str]:
    """Find the rows that several kinds of one section have all."""
    if not kinds[1:]:
        return []
    rows = [_list_rows(kind) for kind in kinds]
    return [row for row in rows[0] if all(row in others for others in rows[1:])]


def _format_kind(section: str, kind: inspect.StructType, shared: Sequence[str]) -> str:
    tag = f", `{kind.tag_field}: {kind.tag}`" if kind.tag_field is not None else ""
    own = [row for row in _list_rows(kind) if row not in shared]
    return _format_keys(f"`{section}`{tag}", _describe_class(kind.cls), own)


def _format_table(title: str, kind: inspect.StructType) -> str:
    return _format_keys(title, _describe_class(kind.cls), _list_rows(kind))


def _list_rows(kind: inspect.StructType) -> list[str]:
    return [
        f"| `{field.encode_name}` | {_name_type(field.type)} | {_show_default(field)} "
        f"| {_find_description(field.type)} |"
        for field in kind.fields
    ]


def _format_keys(title: str, about: str, rows: Sequence[str]) -> str:
    head = "| key | value | default | meaning |\n|---|---|---|---|"
    table = "\n".join(["", head, *rows, ""]) if rows else ""
    return f"### {title}\n\n{about}\n{table}"


def _show_default(field: inspect.Field) -> str:
    if field.required:
        return "required"
    if isinstance(field.default, msgspec.Struct) or field.default is msgspec.NODEFAULT:
        return ""
    if field.default in ("", None, (), {}):
        return ""
    return f"`{json.dumps(msgspec.to_builtins(field.default))}`"


def _find_description(kind: inspect.Type) -> str:
    """Find the description in the metadata of a type or of a part of it."""
    if isinstance(kind, inspect.Metadata):
        text = (kind.extra_json_schema or {}).get("description")
        return str(text).replace("|", "\\|") if text else _find_description(kind.type)
    if isinstance(kind, inspect.UnionType):
        return next(filter(None, map(_find_description, kind.types)), "")
    return ""


_NAMES: Mapping[type, Callable[[Any, str], str]] = {
    inspect.Metadata: lambda kind, unit: _name_type(
        kind.type, (kind.extra or {}).get("unit", unit)
    ),
    inspect.FloatType: lambda _, unit: f"number [{unit}]" if unit not in ("", "1") else "number",
    inspect.IntType: lambda _kind, _unit: "whole number",
    inspect.StrType: lambda _kind, _unit: "text",
    inspect.BoolType: lambda _kind, _unit: "true, false",
    inspect.LiteralType: lambda kind, _: ", ".join(f"`{one}`" for one in kind.values if one != ""),
    inspect.VarTupleType: lambda kind, unit: f"list of: {_name_type(kind.item_type, unit)}",
    inspect.TupleType: lambda kind, unit: (
        f"[{', '.join(_name_type(one, unit) for one in kind.item_types)}]"
    ),
    inspect.DictType: lambda _kind, _unit: "map",
    inspect.StructType: lambda _kind, _unit: "map, below",
    inspect.UnionType: lambda kind, unit: _name_union(kind.types, unit),
}


def _name_type(kind: inspect.Type, unit: str = "") -> str:
    name = _NAMES.get(type(kind))
    return name(kind, unit) if name is not None else "any"


def _name_union(kinds: Sequence[inspect.Type], unit: str) -> str:
    some = [one for one in kinds if not isinstance(one, inspect.NoneType)]
    return " or ".join(dict.fromkeys(_name_type(one, unit) for one in some))


def replace_reference(page: str) -> str:
    """Replace the reference of a page of the documentation, which is its end."""
    head, _, _ = page.partition(REFERENCE_HEAD)
    return head + REFERENCE_HEAD + make_reference()


def _write_files() -> None:
    SCHEMA_FILE.write_text(format_schema(), encoding="utf-8")
    page = REFERENCE_PAGE.read_text(encoding="utf-8")
    REFERENCE_PAGE.write_text(replace_reference(page), encoding="utf-8")


if __name__ == "__main__":
    _write_files()
