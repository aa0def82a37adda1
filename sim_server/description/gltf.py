"""What a GLB file promises, before room is made for it: JSON first, counts, and a tree of nodes."""

from __future__ import annotations

import msgspec

JSON_START = 20
"""Twelve bytes of the file's head, eight of its first chunk's."""
MAX_NUMBERS = 6_000_000
"""Of one accessor: three corners for each triangle that is read."""
MAX_NODES = 10_000


class BadGltf(ValueError):
    """Something that no file that is read here may say."""


class _Accessor(msgspec.Struct):
    count: int = 0


class _Node(msgspec.Struct):
    children: list[int] = []


class _Gltf(msgspec.Struct):
    accessors: list[_Accessor] = []
    nodes: list[_Node] = []
    extensions_required: list[str] = msgspec.field(default=[], name="extensionsRequired")


def check_promises(data: bytes) -> None:
    """Check what a GLB file says of itself.

    Raises:
        BadGltf: Its head is none, or promises too much, or nodes that are no tree.
    """
    length = int.from_bytes(data[12:16], "little")
    try:
        head = msgspec.json.decode(data[JSON_START : JSON_START + length], type=_Gltf)
    except (msgspec.DecodeError, RecursionError) as error:
        raise BadGltf(f"its head is no glTF: {str(error)[:80]}") from error
    if head.extensions_required:
        raise BadGltf(f"it needs {head.extensions_required[0][:40]!r}; export it without")
    if any(not 0 <= accessor.count <= MAX_NUMBERS for accessor in head.accessors):
        raise BadGltf(f"an accessor has more than {MAX_NUMBERS} entries, or fewer than none")
    children = [child for node in head.nodes for child in node.children]
    if len(head.nodes) > MAX_NODES or len(children) > len(set(children)):
        raise BadGltf(f"its nodes are no tree, or more than {MAX_NODES}")
