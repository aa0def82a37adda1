"""Parameter files of controllers, YAML of ROS 2 and ROS 1, as names and texts.

The only importer of yaml. Only its scanner and composer are used, on plain text: no tag makes an
object, no scalar is converted, and aliases count as often as they are used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import yaml

from zensim.sim_server.description.strict_parsing import to_single_line
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

MAX_YAML_BYTES = 1 << 18
"""Bytes of all files of a request."""
MAX_YAML_FILES = 16
MAX_YAML_NODES = 20_000
MAX_YAML_DEPTH = 24
ROS_PARAMETERS_KEY = "ros__parameters"
MANAGER_NODE = "controller_manager"
ANY_NODE = ""
"""Node of parameters that all nodes have: only wildcards are above them."""

Texts = list[tuple[str, str]]


class Controller(NamedTuple):
    """A controller and its parameters."""

    name: str
    type: str
    texts: Texts
    """Names with dots, and values; a list is a name several times."""


class _NodeParameters(NamedTuple):
    node: str
    texts: Texts


def read_controllers(files: Sequence[str]) -> list[Controller]:
    """List the controllers of parameter files, in order of their definition.

    Args:
        files: Texts; a later one overrides parameters of an earlier one.

    Raises:
        ModelError: A text is not YAML, or too large.
    """
    _check_size(files)
    nodes: dict[str, Texts] = {}
    budget = iter(range(MAX_YAML_NODES))
    for text in files:
        for found in _list_nodes(_compose(text), (), budget):
            nodes[found.node] = _override(nodes.get(found.node, []), found.texts)
    return _find_controllers(nodes)


def _check_size(files: Sequence[str]) -> None:
    size = sum(len(text.encode("utf-8", "replace")) for text in files)
    if size > MAX_YAML_BYTES or len(files) > MAX_YAML_FILES:
        raise ModelError(
            f"{len(files)} controllers' files have {size} bytes; at most {MAX_YAML_FILES} files "
            f"of {MAX_YAML_BYTES} bytes in total are read",
            slug="controllers.size",
        )


def _compose(text: str) -> yaml.Node | None:
    try:
        _check_nesting(text)
        return yaml.compose(text, Loader=yaml.BaseLoader)
    except (yaml.YAMLError, ValueError) as error:
        raise ModelError(
            f"the controllers' file is not YAML: {to_single_line(str(error))}",
            slug="controllers.syntax",
        ) from error


def _check_nesting(text: str) -> None:
    """Check events, which are made one at a time, before nodes are: composing them recurses."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.BaseLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_YAML_DEPTH:
            raise _make_size_error()


def _make_size_error() -> ModelError:
    return ModelError(
        f"a controllers' file has more than {MAX_YAML_NODES} values or nests more than "
        f"{MAX_YAML_DEPTH} deep; send only the controllers of this robot",
        slug="controllers.size",
    )


def _list_nodes(
    node: yaml.Node | None, path: tuple[str, ...], budget: Iterator[int]
) -> Iterator[_NodeParameters]:
    """List the ROS nodes with their parameters; in ROS 1 a mapping with a type is one."""
    if len(path) > MAX_YAML_DEPTH:
        raise _make_size_error()
    pairs = _list_pairs(node, budget)
    if any(key == "type" and "/" in _scalar(value) for key, value in pairs):
        yield _NodeParameters(_name_node(path), _flatten(node, "", budget))
        return
    for key, value in pairs:
        if key == ROS_PARAMETERS_KEY:
            yield _NodeParameters(_name_node(path), _flatten(value, "", budget))
        else:
            yield from _list_nodes(value, (*path, *key.split("/")), budget)


def _name_node(path: tuple[str, ...]) -> str:
    return next((part for part in reversed(path) if part.strip("*")), ANY_NODE)


def _flatten(node: yaml.Node | None, prefix: str, budget: Iterator[int]) -> Texts:
    """List parameters with dots between the names; lists of mappings are left out."""
    if prefix.count(".") > MAX_YAML_DEPTH:
        raise _make_size_error()
    texts: Texts = []
    for key, value in _list_pairs(node, budget):
        name = f"{prefix}{key.replace('/', '.')}"
        if isinstance(value, yaml.MappingNode):
            texts += _flatten(value, f"{name}.", budget)
        elif isinstance(value, yaml.SequenceNode):
            for _ in value.value:
                _spend(budget)
            texts += [(name, _scalar(one)) for one in value.value]
        else:
            texts.append((name, _scalar(value)))
    return texts


def _list_pairs(node: yaml.Node | None, budget: Iterator[int]) -> list[tuple[str, yaml.Node]]:
    if not isinstance(node, yaml.MappingNode):
        return []
    for _ in node.value:
        _spend(budget)
    return [(_scalar(key), value) for key, value in node.value]


def _spend(budget: Iterator[int]) -> None:
    if next(budget, None) is None:
        raise _make_size_error()


def _scalar(node: yaml.Node) -> str:
    return str(node.value).strip() if isinstance(node, yaml.ScalarNode) else ""


def _override(earlier: Texts, later: Texts) -> Texts:
    names = {name for name, _ in later}
    return [(name, text) for name, text in earlier if name not in names] + later


def _find_controllers(nodes: dict[str, Texts]) -> list[Controller]:
    shared, managed = nodes.get(ANY_NODE, []), nodes.get(MANAGER_NODE, [])
    names = [name.removesuffix(".type") for name, _ in managed if name.endswith(".type")]
    rate = [(name, text) for name, text in managed if name == "update_rate"]
    found = []
    for name in dict.fromkeys((*names, *nodes)):
        # Older files have the parameters of a controller below its name in those of the manager.
        inside = [
            (key.removeprefix(f"{name}."), text)
            for key, text in managed
            if key.startswith(f"{name}.")
        ]
        texts = _override(_override(shared, inside), nodes.get(name, []))
        kind = next((text for key, text in texts if key == "type"), "")
        if kind and name not in (ANY_NODE, MANAGER_NODE):
            given = [(key, text) for key, text in texts if key != "type"]
            found.append(Controller(name, kind, _override(rate, given)))
    return found
