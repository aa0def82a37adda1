"""The part of PyYAML that is used: events and nodes of a text, without construction."""

from collections.abc import Iterator
from typing import Any

class YAMLError(Exception): ...
class BaseLoader: ...
class SafeLoader(BaseLoader): ...

class Mark:
    line: int
    column: int

class Event:
    start_mark: Mark

class CollectionStartEvent(Event): ...
class CollectionEndEvent(Event): ...

class Node:
    value: object
    tag: str
    style: str | None
    start_mark: Mark

class ScalarNode(Node):
    value: str

class SequenceNode(Node):
    value: list[Node]

class MappingNode(Node):
    value: list[tuple[Node, Node]]

def parse(stream: str, Loader: type[BaseLoader]) -> Iterator[Event]: ...  # noqa: N803
def compose(stream: str, Loader: type[BaseLoader]) -> Node | None: ...  # noqa: N803
def safe_load(stream: str) -> Any: ...
def safe_load_all(stream: str) -> Iterator[Any]: ...
def safe_dump(data: object) -> str: ...
