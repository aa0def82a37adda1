"""YAML 1.2 text to nodes that know their file, line and column; errors with positions.

PyYAML composes the nodes; its values are those of YAML 1.1, so that plain scalars are resolved
here, by the core schema of YAML 1.2.
"""

import math
import re
from collections.abc import Mapping
from functools import lru_cache

import msgspec
import yaml

MAX_BYTES = 4_000_000
MAX_NODES = 200_000
"""Nodes of a file, counted after aliases."""
MAX_DEPTH = 30
TEXT_TAG = "tag:yaml.org,2002:str"
DEFAULT_TAGS = {
    yaml.ScalarNode: TEXT_TAG,
    yaml.SequenceNode: "tag:yaml.org,2002:seq",
    yaml.MappingNode: "tag:yaml.org,2002:map",
}
WORDS: Mapping[str, bool | float | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), math.inf),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}
FIRST_OF_NUMBERS = frozenset("+-.0123456789")
_INTEGER = re.compile(r"[-+]?[0-9]{1,300}")
_BASED = re.compile(r"0(?:o[0-7]{1,300}|x[0-9a-fA-F]{1,300})")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_INDENT = re.compile(r"^[ \-?:]*", re.MULTILINE)
_NO_BRACKETS = re.compile(r"[^][{}]+")

Scalar = str | int | float | bool | None


class Place(msgspec.Struct, frozen=True):
    """A position in a file; line and column count from 1, 0 = the file as a whole."""

    file: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


class Issue(msgspec.Struct, frozen=True):
    """One mistake in a file: where, at which key, what is wrong and what would work."""

    place: Place
    path: str
    message: str

    def __str__(self) -> str:
        return (
            f"{self.place}: {self.path}: {self.message}"
            if self.path
            else (f"{self.place}: {self.message}")
        )


class ScenarioInvalid(ValueError):
    """A scenario file with mistakes; `issues` has all of them, in the order of the file."""

    def __init__(self, issues: tuple[Issue, ...]) -> None:
        super().__init__("\n".join(map(str, issues)))
        self.issues = issues

    def __reduce__(self) -> tuple[type["ScenarioInvalid"], tuple[tuple[Issue, ...]]]:
        return type(self), (self.issues,)


class ScenarioNode(msgspec.Struct, frozen=True):
    """A value with its position: a scalar, a list of nodes, or nodes by key."""

    place: Place
    value: "Scalar | list[ScenarioNode] | dict[str, ScenarioNode]"
    key_places: Mapping[str, Place] = {}
    """Places of the keys of a map."""

    @property
    def is_map(self) -> bool:
        """Whether the value is a map."""
        return isinstance(self.value, dict)

    @property
    def items(self) -> "dict[str, ScenarioNode]":
        """Nodes by key; empty if this is no map."""
        return self.value if isinstance(self.value, dict) else {}

    @property
    def elements(self) -> "list[ScenarioNode]":
        """Nodes of a list; empty if this is no list."""
        return self.value if isinstance(self.value, list) else []


class _PlainLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Composes every plain scalar as text; finds tags by the kind of a node alone."""

    def resolve(self, kind: type[yaml.Node], _value: object, _implicit: object) -> str:
        """Find the tag of a node that names none."""
        return DEFAULT_TAGS[kind]


def read_nodes(text: str, file: str) -> ScenarioNode:
    """Compose the nodes of a YAML text.

    Raises:
        ScenarioInvalid: It is not YAML, has tags or double keys, or is too large or too deep.
    """
    _check_size(text, file)
    try:
        composed = yaml.compose(text, Loader=_PlainLoader)
    except yaml.YAMLError as error:
        raise ScenarioInvalid((_describe_yaml_error(error, file),)) from error
    if composed is None:
        return ScenarioNode(Place(file, 1, 1), {})
    reading = _Reading(file)
    node = reading.convert(composed, 0)
    if reading.issues:
        raise ScenarioInvalid(tuple(reading.issues))
    return node


def fail_at(place: Place, path: str, message: str) -> ScenarioInvalid:
    """Make the error of a single mistake."""
    return ScenarioInvalid((Issue(place, path, message),))


def _check_size(text: str, file: str) -> None:
    if len(text) > MAX_BYTES:
        raise fail_at(Place(file), "", f"the file has more than {MAX_BYTES} characters")
    if _bound_depth(text) > MAX_DEPTH:
        _check_depth(text, file)


def _bound_depth(text: str) -> int:
    """Bound the depth from above: brackets that are open at once, and columns of indentation."""
    depth = most = 0
    for bracket in _NO_BRACKETS.sub("", text):
        if bracket in "]}":
            depth -= 1
        else:
            depth += 1
            most = max(most, depth)
    indent = max((len(match.group()) for match in _INDENT.finditer(text)), default=0)
    return most + indent


def _check_depth(text: str, file: str) -> None:
    """Refuse a deep text before it is composed, which takes the stack of the process."""
    depth = 0
    try:
        for event in yaml.parse(text, Loader=_PlainLoader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                mark = event.start_mark
                raise fail_at(
                    Place(file, mark.line + 1, mark.column + 1),
                    "",
                    f"nested more than {MAX_DEPTH} levels deep",
                )
    except yaml.YAMLError as error:
        raise ScenarioInvalid((_describe_yaml_error(error, file),)) from error


def _describe_yaml_error(error: yaml.YAMLError, file: str) -> Issue:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = str(getattr(error, "problem", "") or getattr(error, "reason", "") or error)
    context = str(getattr(error, "context", "") or "")
    place = Place(file, mark.line + 1, mark.column + 1) if mark is not None else Place(file, 1, 1)
    advice = "; indent with spaces" if "tab" in problem or "\\t" in problem else ""
    mistake = f"not valid YAML: {problem}{f' {context}' if context else ''}{advice}"
    return Issue(place, "", " ".join(mistake.split()))


class _Reading:
    """Conversion of composed nodes; an aliased node is converted once and counted each time."""

    def __init__(self, file: str) -> None:
        self.issues: list[Issue] = []
        self._file = file
        self._done: dict[int, tuple[ScenarioNode, int, int]] = {}
        self._open: set[int] = set()

    def convert(self, node: yaml.Node, depth: int) -> ScenarioNode:
        """Convert a node and what it contains; mistakes are added to `issues`."""
        converted, size, height = self._convert(node)
        if size > MAX_NODES:
            self._refuse(node, "", f"more than {MAX_NODES} values, counted after aliases")
        if depth + height > MAX_DEPTH:
            self._refuse(node, "", f"nested more than {MAX_DEPTH} levels deep")
        return converted

    def _convert(self, node: yaml.Node) -> tuple[ScenarioNode, int, int]:
        """Convert a node; return its size and height, too."""
        if isinstance(node, yaml.ScalarNode):
            if node.tag != TEXT_TAG:
                self._check_tag(node)
            # Quoted text and blocks of text are text.
            value = node.value if node.style else resolve_scalar(node.value)
            mark = node.start_mark
            place = Place(self._file, mark.line + 1, mark.column + 1)
            return ScenarioNode(place, value), 1, 1
        key = id(node)
        if key in self._done:
            return self._done[key]
        if key in self._open:
            self._refuse(node, "", "an alias contains itself")
            return ScenarioNode(self._place(node), None), 1, 1
        self._check_tag(node)
        self._open.add(key)
        try:
            if isinstance(node, yaml.MappingNode):
                found = self._convert_map(node)
            else:
                assert isinstance(node, yaml.SequenceNode)
                found = self._convert_list(node)
        finally:
            self._open.discard(key)
        self._done[key] = found
        return found

    def _check_tag(self, node: yaml.Node) -> None:
        if node.tag != DEFAULT_TAGS[type(node)]:
            self._refuse(node, "", f"the tag `{node.tag}` is not allowed; remove it")

    def _convert_list(self, node: yaml.SequenceNode) -> tuple[ScenarioNode, int, int]:
        values, size, height = [], 1, 0
        for one in node.value:
            value, inner, depth = self._convert(one)
            values.append(value)
            size += inner
            height = max(height, depth)
        return ScenarioNode(self._place(node), values), size, height + 1

    def _convert_map(self, node: yaml.MappingNode) -> tuple[ScenarioNode, int, int]:
        values: dict[str, ScenarioNode] = {}
        places: dict[str, Place] = {}
        size, height = 1, 0
        for key_node, value_node in node.value:
            key = self._read_key(key_node)
            if key in places:
                self._refuse(key_node, key, f"the key `{key}` is given twice; first {places[key]}")
            places[key] = self._place(key_node)
            values[key], inner, depth = self._convert(value_node)
            size += inner
            height = max(height, depth)
        return ScenarioNode(self._place(node), values, places), size, height + 1

    def _read_key(self, node: yaml.Node) -> str:
        if not isinstance(node, yaml.ScalarNode):
            self._refuse(node, "", "a key is a word, not a list or a map")
            return ""
        if node.value == "<<":
            self._refuse(node, "<<", "merge keys are no part of YAML 1.2; use `include`")
        return str(node.value)

    def _place(self, node: yaml.Node) -> Place:
        mark = node.start_mark
        return Place(self._file, mark.line + 1, mark.column + 1)

    def _refuse(self, node: yaml.Node, path: str, message: str) -> None:
        self.issues.append(Issue(self._place(node), path, message))


@lru_cache(maxsize=4096)
def resolve_scalar(text: str) -> Scalar:
    """Resolve a plain scalar by the core schema of YAML 1.2: `no` is text, `1e3` is a number."""
    if text in WORDS:
        return WORDS[text]
    if text[0] not in FIRST_OF_NUMBERS:
        return text
    if _INTEGER.fullmatch(text):
        return int(text)
    if _BASED.fullmatch(text):
        return int(text[2:], 8 if text[1] == "o" else 16)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


def name_of(node: ScenarioNode) -> str:
    """Find the name of an entry; empty if it has none."""
    name = node.items.get("name")
    return name.value if name is not None and isinstance(name.value, str) else ""
