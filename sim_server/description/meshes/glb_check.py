"""Counts in the header of a GLB file, checked before the file is read."""

from __future__ import annotations

import msgspec

GLB_JSON_START = 20
"""Twelve bytes of the file's header, eight of the first chunk's."""
MAX_ACCESSOR_ENTRIES = 6_000_000
"""Three corners for each allowed triangle."""
MAX_GLTF_NODES = 10_000


class GltfError(ValueError):
    """An invalid or too large GLB file; the text is the reason."""


class _GltfAccessor(msgspec.Struct):
    count: int = 0


class _GltfNode(msgspec.Struct):
    children: list[int] = []


class _GltfHeader(msgspec.Struct):
    accessors: list[_GltfAccessor] = []
    nodes: list[_GltfNode] = []
    extensions_required: list[str] = msgspec.field(default=[], name="extensionsRequired")


def check_glb_header(data: bytes) -> None:
    """Check the counts in the header of a GLB file.

    Raises:
        GltfError: The header is invalid, a count is too large, or the nodes are not a tree.
    """
    length = int.from_bytes(data[12:16], "little")
    try:
        head = msgspec.json.decode(data[GLB_JSON_START : GLB_JSON_START + length], type=_GltfHeader)
    except (msgspec.DecodeError, RecursionError) as error:
        raise GltfError(f"its header is not glTF: {str(error)[:80]}") from error
    if head.extensions_required:
        name = head.extensions_required[0][:40]
        raise GltfError(f"it requires the extension {name!r}; export it without")
    if any(not 0 <= accessor.count <= MAX_ACCESSOR_ENTRIES for accessor in head.accessors):
        raise GltfError(f"an accessor has more than {MAX_ACCESSOR_ENTRIES} entries or less than 0")
    children = [child for node in head.nodes for child in node.children]
    if len(head.nodes) > MAX_GLTF_NODES or len(children) > len(set(children)):
        raise GltfError(f"its nodes are not a tree, or more than {MAX_GLTF_NODES}")
