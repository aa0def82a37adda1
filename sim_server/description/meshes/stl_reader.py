"""STL files, binary and text."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.stl import STL_HEAD, STL_RECORD, read_corners
from zensim.sim_server.description.meshes.leading_numbers import read_leading_numbers
from zensim.sim_server.description.meshes.mesh_triangles import (
    MAX_TRIANGLES,
    FindFile,
    Triangles,
    mesh_error,
    too_many_error,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

ASCII_VERTEX = re.compile(
    rb"^[ \t]*vertex[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.IGNORECASE | re.MULTILINE
)


def read_stl_file(name: str, data: bytes, _: FindFile) -> Triangles:
    """Read a binary STL file, also one with bytes at its end, or one of text."""
    count = int.from_bytes(data[80:STL_HEAD], "little") if len(data) >= STL_HEAD else -1
    if count >= 0 and len(data) == STL_HEAD + count * STL_RECORD.itemsize:
        if count > MAX_TRIANGLES:
            raise too_many_error(name, count)
        return _to_triangles(read_corners(data, count))
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096]:
        return _to_triangles(_read_ascii_corners(name, data))
    # Some exporters pad the end of the file.
    if 0 < count <= MAX_TRIANGLES and len(data) > STL_HEAD + count * STL_RECORD.itemsize:
        return _to_triangles(read_corners(data, count))
    raise mesh_error(
        name,
        f"has a count of {max(count, 0)} triangles, but only {len(data)} bytes",
        slug="mesh.length",
    )


def _read_ascii_corners(name: str, data: bytes) -> NDArray[np.float64]:
    written = ASCII_VERTEX.findall(data)
    numbers = read_leading_numbers(b" ".join(written), np.float64)
    if len(numbers) != 3 * len(written):
        raise mesh_error(name, "has a corner without three numbers", slug="mesh.number")
    return numbers.reshape(-1, 3)


def _to_triangles(corners: NDArray[np.floating]) -> Triangles:
    vertices = corners[: len(corners) // 3 * 3].astype(np.float64)
    return Triangles(vertices, np.arange(len(vertices)).reshape(-1, 3))
