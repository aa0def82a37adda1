"""A mesh file's bytes to triangles: STL, OBJ, DAE, GLB. Counts are checked first."""

from __future__ import annotations

import re
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from lxml import etree

from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.stl import STL_HEAD, STL_RECORD, read_corners, write_corners
from zensim.sim_server.description.collada import MAX_DRAWN, DrawnTooOften, check_drawn
from zensim.sim_server.description.gltf import BadGltf, check_promises
from zensim.sim_server.description.number_text import leading_numbers
from zensim.sim_server.description.obj import NoObj, read_obj
from zensim.sim_server.description.wording import shown
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

MAX_TRIANGLES = 2_000_000
MAX_EXTENT = 1e6
"""Of a coordinate, in the file's own unit."""
VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True, eq=False)
class Triangles:
    """Corners (v, 3) in the file's scale, and triples of their indices (f, 3)."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def read_mesh(name: str, data: bytes) -> Triangles:
    """Read a mesh file by the ending of its name.

    Raises:
        ModelError: The ending is not known, or the bytes are no such mesh.
    """
    ending = name.rpartition(".")[2].lower()
    if ending not in READERS:
        raise _bad(
            name,
            f"ends in {ending[:20]!r}; convert it to stl, obj, dae or glb",
            slug="mesh.format",
            code=SpawnCode.UNSUPPORTED_ASSETS,
        )
    return _checked(name, READERS[ending](name, data))


def write_stl(triangles: Triangles) -> bytes:
    """Write triangles as binary STL."""
    return write_corners(triangles.vertices[triangles.faces])


def _checked(name: str, found: Triangles) -> Triangles:
    vertices, faces = found.vertices, found.faces
    if not len(faces):
        raise _bad(name, "has no triangles; export it again", slug="mesh.empty")
    if len(faces) > MAX_TRIANGLES:
        raise _too_many(name, len(faces))
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _bad(name, f"names corners outside of its {len(vertices)}", slug="mesh.index")
    if not np.isfinite(vertices).all():
        raise _bad(name, "has coordinates that are not finite numbers", slug="mesh.number")
    if np.abs(vertices).max() > MAX_EXTENT:
        raise _bad(name, f"reaches beyond {MAX_EXTENT:g}; check its unit", slug="mesh.extent")
    return found


def _stl(name: str, data: bytes) -> Triangles:
    count = int.from_bytes(data[80:STL_HEAD], "little") if len(data) >= STL_HEAD else -1
    if count >= 0 and len(data) == STL_HEAD + count * STL_RECORD.itemsize:
        if count > MAX_TRIANGLES:
            raise _too_many(name, count)
        return _soup(read_corners(data, count))
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096]:
        return _soup(_written_corners(name, data))
    # Some exporters pad the end: more bytes than the count says are harmless, fewer are not.
    if 0 < count <= MAX_TRIANGLES and len(data) > STL_HEAD + count * STL_RECORD.itemsize:
        return _soup(read_corners(data, count))
    raise _bad(
        name,
        f"promises {max(count, 0)} triangles, but its {len(data)} bytes do not hold them",
        slug="mesh.length",
    )


def _written_corners(name: str, data: bytes) -> NDArray[np.float64]:
    written = VERTEX.findall(data)
    numbers = leading_numbers(b" ".join(written), np.float64)
    if len(numbers) != 3 * len(written):
        raise _bad(name, "has a corner that is no three numbers", slug="mesh.number")
    return numbers.reshape(-1, 3)


def _soup(corners: NDArray[np.floating]) -> Triangles:
    vertices = corners[: len(corners) // 3 * 3].astype(np.float64)
    return Triangles(vertices, np.arange(len(vertices)).reshape(-1, 3))


def _obj(name: str, data: bytes) -> Triangles:
    try:
        return Triangles(*read_obj(data, MAX_TRIANGLES))
    except NoObj as error:
        what = shown(error.line.decode(errors="replace"))
        raise _bad(name, f"has a line that is no OBJ: {what}", slug="mesh.unreadable") from error


def _dae(name: str, data: bytes) -> Triangles:
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data or b"\0" in data[:200]:
        raise _bad(name, "declares a document type or is not UTF-8", slug="mesh.doctype")
    try:
        check_drawn(data)
    except etree.XMLSyntaxError as error:
        raise _bad(name, "is not well-formed XML", slug="mesh.unreadable") from error
    except DrawnTooOften as error:
        fault = f"draws more than {MAX_DRAWN} geometries, or itself; export it flat"
        raise _bad(name, fault, slug="mesh.triangles") from error
    return _by_trimesh(name, data, "dae")


def _glb(name: str, data: bytes) -> Triangles:
    try:
        check_promises(data)
    except BadGltf as error:
        raise _bad(name, f"cannot be read: {error}", slug="mesh.unreadable") from error
    return _by_trimesh(name, data, "glb")


def _by_trimesh(name: str, data: bytes, kind: str) -> Triangles:
    try:
        scene = trimesh.load_scene(BytesIO(data), file_type=kind, skip_materials=True)
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    except MemoryError:
        raise
    # A foreign parser over foreign bytes raises anything.
    except Exception as error:
        fault = f"cannot be read: {type(error).__name__} {str(error)[:120]}"
        raise _bad(name, fault, slug="mesh.unreadable") from error
    if not parts:
        return Triangles(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [np.asarray(part.faces) + at for part, at in zip(parts, starts, strict=False)]
    vertices = np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in parts])
    return Triangles(vertices * _unit(scene), np.concatenate(faces).astype(np.int64))


def _unit(scene: trimesh.Scene) -> float:
    written = str(scene.units).partition(" * meters")
    try:
        return float(written[0]) if written[1] else 1.0
    except ValueError:
        return 1.0


def _too_many(name: str, count: int) -> ModelError:
    return _bad(
        name, f"has {count} triangles; at most {MAX_TRIANGLES} are read", slug="mesh.triangles"
    )


def _bad(
    name: str,
    fault: str,
    *,
    slug: str,
    code: int = SpawnCode.UNSUPPORTED_ASSETS,
) -> ModelError:
    return ModelError(f"mesh {shown(name)} {fault}", code=code, slug=slug)


READERS: dict[str, Callable[[str, bytes], Triangles]] = {
    "stl": _stl,
    "stlb": _stl,
    "obj": _obj,
    "dae": _dae,
    "glb": _glb,
}
