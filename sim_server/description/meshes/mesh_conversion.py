"""Meshes of a model for engine and viewer: hulls, split static meshes, decimated visuals.

A moving body collides by the convex hulls of its meshes, a static one by their triangles. The
results are binary STL in the scale of the file, named by their sha256.
"""

from __future__ import annotations

import logging
import re
import warnings
from dataclasses import dataclass, field
from hashlib import sha256
from io import BytesIO
from itertools import chain
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from lxml import etree
from numpy.typing import NDArray

from zensim.proto.messages.model_messages import ReportEntry
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.stl import STL_HEAD, STL_RECORD, read_corners, write_corners
from zensim.sim_server.description.meshes.generated_solids import is_generated, list_corners
from zensim.sim_server.description.meshes.mesh_lookup import list_meshes
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    import trimesh
    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Link, Model, Shape

MAX_GEOMETRY_INSTANCES = 10_000
NODE_INSTANCE_TAG = b"instance_node"


class TooManyInstances(ValueError):
    """Nodes reference each other in a cycle, or have too many geometries."""


def check_collada_instances(data: bytes) -> None:
    """Count the geometries of a COLLADA file before its references are expanded.

    Raises:
        TooManyInstances: There are more than 10,000, or references form a cycle.
        XMLSyntaxError: The bytes are not XML.
    """
    if NODE_INSTANCE_TAG not in data:
        return
    parser = etree.XMLParser(load_dtd=False, no_network=True, resolve_entities=False)
    nodes = {
        f"#{node.get('id')}": node
        for node in etree.fromstring(data, parser).iter("{*}node")
        if node.get("id")
    }
    _count_geometries(nodes)


def _count_geometries(nodes: Mapping[str, Element]) -> None:
    counts: dict[str, int] = {}
    for name in nodes:
        path = (
            [(name, iter(_list_instanced_nodes(nodes[name], nodes)))] if name not in counts else []
        )
        open_names = {name}
        while path:
            at, below = path[-1]
            inner = next((one for one in below if one not in counts), "")
            if inner in open_names:
                raise TooManyInstances
            if inner:
                open_names.add(inner)
                path.append((inner, iter(_list_instanced_nodes(nodes[inner], nodes))))
                continue
            path.pop()
            open_names.discard(at)
            own = sum(1 for _ in nodes[at].iter("{*}instance_geometry", "{*}instance_controller"))
            counts[at] = own + sum(counts[one] for one in _list_instanced_nodes(nodes[at], nodes))
            if counts[at] > MAX_GEOMETRY_INSTANCES:
                raise TooManyInstances


def _list_instanced_nodes(node: Element, nodes: Mapping[str, Element]) -> Iterator[str]:
    for instance in node.iter("{*}instance_node"):
        if (url := instance.get("url") or "") in nodes:
            yield url


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


def read_leading_numbers(text: bytes, kind: type[np.number[Any]]) -> NDArray[Any]:
    """Read numbers up to the first word that is not a number."""
    with warnings.catch_warnings():
        # numpy reports such a word by a warning, newer versions by an error.
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            return np.fromstring(text.decode("ascii"), kind, sep=" ")
        except ValueError:
            return np.zeros(0, kind)


Corners = NDArray[np.float64]
Faces = NDArray[np.int64]
ByteArray = NDArray[np.uint8]
IntArray = NDArray[np.int64]

CHUNK_BYTES = 1 << 22
"""Bytes parsed at once; lines must be shorter."""
AXES = 3
MAX_FACE_SIDES = 10_000
MAX_CORNER_NUMBER = 1 << 40
"""Larger numbers of corners are errors."""
BLANKS = bytes.maketrans(b"\t\v\f\r", b"   \n")
SPACE, NEWLINE, SLASH = b" \n/"
EXCERPT_BYTES = 200
"""Of an invalid line."""


class ObjSyntaxError(ValueError):
    """An invalid line of an OBJ file."""

    def __init__(self, line: bytes) -> None:
        super().__init__(line)
        self.line = line


@dataclass(frozen=True, eq=False)
class _WordIndex:
    """The words of a chunk of text, and the lines that have words."""

    text: ByteArray
    starts: IntArray
    """First byte of each word."""
    lengths: IntArray
    """Bytes of each word with the blanks after it."""
    lines: IntArray
    """Index of the first word of each line."""
    counts: IntArray
    """Words of each line."""

    def starts_with_word(self, letter: bytes) -> NDArray[np.bool_]:
        """Find for each line whether its first word is a letter."""
        first = self.starts[self.lines]
        is_single = self.text[np.minimum(first + 1, len(self.text) - 1)] <= SPACE
        is_letter: NDArray[np.bool_] = self.text[first] == letter[0]
        is_whole: NDArray[np.bool_] = is_letter & (is_single | (first + 1 == len(self.text)))
        return is_whole

    def line(self, number: int) -> bytes:
        """Get the text of a line, cut to 200 bytes."""
        start = int(self.starts[self.lines[number]])
        return self.text[start : start + EXCERPT_BYTES].tobytes().partition(b"\n")[0]


def read_obj(data: bytes, max_count: int) -> tuple[Corners, Faces]:
    """Read corners (v, 3) and triangles (f, 3) of corner indices from 0, without range checks.

    Args:
        data: The file.
        max_count: Reading stops after this many triangles.

    Raises:
        ObjSyntaxError: A line has an invalid number.
    """
    corners = [np.zeros((0, 3))]
    faces = [np.zeros((0, 3), dtype=np.int64)]
    known = found = 0
    for chunk in _split_chunks(data):
        words = _index_words(chunk)
        is_corner = words.starts_with_word(b"v")
        corners.append(_read_vertices(words, is_corner))
        faces.append(_read_faces(words, known + np.cumsum(is_corner)))
        known += len(corners[-1])
        found += len(faces[-1])
        if found > max_count:
            break
    return np.concatenate(corners), np.concatenate(faces)


def _split_chunks(data: bytes) -> Iterator[bytes]:
    """Split a text at line ends."""
    text = data.translate(BLANKS)
    if b"\\\n" in text:
        text = text.replace(b"\\\n", b" ")
    start = 0
    while start < len(text):
        end = min(start + CHUNK_BYTES, len(text))
        if end < len(text):
            end = text.rfind(b"\n", start, end) + 1
        if end <= start:
            raise ObjSyntaxError(text[start : start + EXCERPT_BYTES])
        yield text[start:end]
        start = end


def _index_words(chunk: bytes) -> _WordIndex:
    text = np.frombuffer(chunk, np.uint8)
    is_word = text > SPACE
    starts = np.flatnonzero(is_word & ~np.concatenate([[False], is_word[:-1]]))
    line_of = np.cumsum(text == NEWLINE, dtype=np.int32)[starts]
    lines = np.flatnonzero(np.diff(line_of, prepend=-1))
    lengths = np.diff(starts, append=len(text))
    return _WordIndex(text, starts, lengths, lines, np.diff(lines, append=len(starts)))


def _read_vertices(words: _WordIndex, is_corner: NDArray[np.bool_]) -> Corners:
    """Read the three words after each `v`; colours and weights after them are ignored."""
    if len(short := np.flatnonzero(is_corner & (words.counts <= AXES))):
        raise ObjSyntaxError(words.line(short[0]))
    place = np.arange(len(words.starts)) - np.repeat(words.lines, words.counts)
    is_read = np.repeat(is_corner, words.counts) & (place >= 1) & (place <= AXES)
    text = words.text[_spread_to_bytes(is_read, words)]
    return _read_selected(text, np.float64, words, is_read).reshape(-1, AXES)


def _read_faces(words: _WordIndex, known: IntArray) -> Faces:
    """Read the corners after each `f`.

    Args:
        words: Of a chunk.
        known: Corners before the end of each line; negative numbers are relative to it.
    """
    is_face = words.starts_with_word(b"f")
    if len(wide := np.flatnonzero(is_face & (words.counts > MAX_FACE_SIDES))):
        raise ObjSyntaxError(words.line(wide[0]))
    is_read = np.repeat(is_face, words.counts)
    is_read[words.lines] = False
    plain = np.where(_is_texture_or_normal(words), np.uint8(SPACE), words.text)
    numbers = _read_selected(plain[_spread_to_bytes(is_read, words)], np.int64, words, is_read)
    if len(far := np.flatnonzero(np.abs(numbers) > MAX_CORNER_NUMBER)):
        raise ObjSyntaxError(words.line(int(_line_of_each(words, is_read)[far[0]])))
    sides = words.counts[is_face] - 1
    counts = np.repeat(known[is_face], sides)
    return _triangulate(np.where(numbers < 0, numbers + counts, numbers - 1), sides)


def _spread_to_bytes(of_words: NDArray[np.bool_], words: _WordIndex) -> NDArray[np.bool_]:
    """Repeat a value of each word for its bytes and the blanks after it."""
    lead = int(words.starts[0]) if len(words.starts) else len(words.text)
    return np.concatenate([np.zeros(lead, dtype=bool), np.repeat(of_words, words.lengths)])


def _is_texture_or_normal(words: _WordIndex) -> NDArray[np.bool_]:
    """Find the bytes of texture and normal of a corner: from a slash to a blank."""
    is_slash: NDArray[np.bool_] = words.text == SLASH
    if not is_slash.any():
        return is_slash
    slashes = np.cumsum(is_slash, dtype=np.int32)
    before = (slashes - is_slash)[words.starts]
    lead = len(words.text) - int(words.lengths.sum())
    inside = slashes[lead:] > np.repeat(before, words.lengths)
    found: NDArray[np.bool_] = np.concatenate([np.zeros(lead, dtype=bool), inside])
    found[words.text <= SPACE] = False
    return found


def _read_selected(
    text: ByteArray, kind: type[np.number[Any]], words: _WordIndex, is_read: NDArray[np.bool_]
) -> NDArray[Any]:
    """Read one number per word.

    Raises:
        ObjSyntaxError: A word is not a number.
    """
    ends = np.cumsum(words.lengths[is_read])
    found = read_leading_numbers(text.tobytes(), kind)
    if len(found) != len(ends):
        wrong = _find_bad_word(text, ends, kind)
        raise ObjSyntaxError(words.line(int(_line_of_each(words, is_read)[wrong])))
    return found


def _find_bad_word(text: ByteArray, ends: IntArray, kind: type[np.number[Any]]) -> int:
    """Find the first word that is not a number by bisection."""
    places = np.concatenate([[0], ends])
    first, end = 0, len(ends)
    while end - first > 1:
        middle = (first + end) // 2
        half = text[places[first] : places[middle]].tobytes()
        if len(read_leading_numbers(half, kind)) == middle - first:
            first = middle
        else:
            end = middle
    return first


def _line_of_each(words: _WordIndex, is_read: NDArray[np.bool_]) -> IntArray:
    return np.repeat(np.arange(len(words.lines)), words.counts)[is_read]


def _triangulate(numbers: Faces, sides: IntArray) -> Faces:
    """Split faces into triangles that share the first corner."""
    triangles = np.maximum(sides - 2, 0)
    first = np.repeat(np.cumsum(sides) - sides, triangles)
    place = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    fans: Faces = numbers[np.stack([first, first + place + 1, first + place + 2], axis=1)]
    return fans


MAX_TRIANGLES = 2_000_000
MAX_EXTENT = 1e6
"""Of a coordinate, in the unit of the file."""
ASCII_VERTEX = re.compile(
    rb"^[ \t]*vertex[ \t]+(\S+[ \t]+\S+[ \t]+\S+)", re.IGNORECASE | re.MULTILINE
)


@dataclass(frozen=True, eq=False)
class Triangles:
    """Corners (v, 3) in the scale of the file, and corner indices of triangles (f, 3)."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def read_mesh(name: str, data: bytes) -> Triangles:
    """Read a mesh file by the extension of its name.

    Raises:
        ModelError: The extension is unknown or the file invalid.
    """
    ending = name.rpartition(".")[2].lower()
    if ending not in MESH_READERS:
        raise _mesh_error(
            name,
            f"has the extension {ending[:20]!r}; convert it to stl, obj, dae or glb",
            slug="mesh.format",
            code=SpawnCode.UNSUPPORTED_ASSETS,
        )
    return _check_triangles(name, MESH_READERS[ending](name, data))


def write_stl(triangles: Triangles) -> bytes:
    """Write triangles as binary STL."""
    return write_corners(triangles.vertices[triangles.faces])


def _check_triangles(name: str, found: Triangles) -> Triangles:
    vertices, faces = found.vertices, found.faces
    if not len(faces):
        raise _mesh_error(name, "has no triangles; export it again", slug="mesh.empty")
    if len(faces) > MAX_TRIANGLES:
        raise _too_many_error(name, len(faces))
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _mesh_error(
            name, f"has triangles outside its {len(vertices)} corners", slug="mesh.index"
        )
    if not np.isfinite(vertices).all():
        raise _mesh_error(name, "has coordinates that are not finite numbers", slug="mesh.number")
    if np.abs(vertices).max() > MAX_EXTENT:
        raise _mesh_error(
            name, f"has coordinates beyond {MAX_EXTENT:g}; check its unit", slug="mesh.extent"
        )
    return found


def _read_stl_file(name: str, data: bytes) -> Triangles:
    count = int.from_bytes(data[80:STL_HEAD], "little") if len(data) >= STL_HEAD else -1
    if count >= 0 and len(data) == STL_HEAD + count * STL_RECORD.itemsize:
        if count > MAX_TRIANGLES:
            raise _too_many_error(name, count)
        return _to_triangles(read_corners(data, count))
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data[:4096]:
        return _to_triangles(_read_ascii_corners(name, data))
    # Some exporters pad the end of the file.
    if 0 < count <= MAX_TRIANGLES and len(data) > STL_HEAD + count * STL_RECORD.itemsize:
        return _to_triangles(read_corners(data, count))
    raise _mesh_error(
        name,
        f"has a count of {max(count, 0)} triangles, but only {len(data)} bytes",
        slug="mesh.length",
    )


def _read_ascii_corners(name: str, data: bytes) -> NDArray[np.float64]:
    written = ASCII_VERTEX.findall(data)
    numbers = read_leading_numbers(b" ".join(written), np.float64)
    if len(numbers) != 3 * len(written):
        raise _mesh_error(name, "has a corner without three numbers", slug="mesh.number")
    return numbers.reshape(-1, 3)


def _to_triangles(corners: NDArray[np.floating]) -> Triangles:
    vertices = corners[: len(corners) // 3 * 3].astype(np.float64)
    return Triangles(vertices, np.arange(len(vertices)).reshape(-1, 3))


def _read_obj_file(name: str, data: bytes) -> Triangles:
    try:
        return Triangles(*read_obj(data, MAX_TRIANGLES))
    except ObjSyntaxError as error:
        what = quote(error.line.decode(errors="replace"))
        raise _mesh_error(name, f"has an invalid line: {what}", slug="mesh.unreadable") from error


def _read_dae_file(name: str, data: bytes) -> Triangles:
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data or b"\0" in data[:200]:
        raise _mesh_error(name, "declares a document type or is not UTF-8", slug="mesh.doctype")
    try:
        check_collada_instances(data)
    except etree.XMLSyntaxError as error:
        raise _mesh_error(name, "is not well-formed XML", slug="mesh.unreadable") from error
    except TooManyInstances as error:
        fault = (
            f"has more than {MAX_GEOMETRY_INSTANCES} geometries or contains itself; "
            "export it without instances"
        )
        raise _mesh_error(name, fault, slug="mesh.triangles") from error
    return _load_with_trimesh(name, data, "dae")


def _read_glb_file(name: str, data: bytes) -> Triangles:
    try:
        check_glb_header(data)
    except GltfError as error:
        raise _mesh_error(name, f"cannot be read: {error}", slug="mesh.unreadable") from error
    return _load_with_trimesh(name, data, "glb")


def _load_with_trimesh(name: str, data: bytes, kind: str) -> Triangles:
    import trimesh

    # It logs tracebacks for textures that are not here, which nothing draws.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        scene = trimesh.load_scene(BytesIO(data), file_type=kind, skip_materials=True)
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh)]
    except MemoryError:
        raise
    # Parsers of trimesh raise any exception for invalid files.
    except Exception as error:
        fault = f"cannot be read: {type(error).__name__} {str(error)[:120]}"
        raise _mesh_error(name, fault, slug="mesh.unreadable") from error
    if not parts:
        return Triangles(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [np.asarray(part.faces) + at for part, at in zip(parts, starts, strict=False)]
    vertices = np.concatenate([np.asarray(part.vertices, dtype=np.float64) for part in parts])
    return Triangles(vertices * _find_unit_m(scene), np.concatenate(faces).astype(np.int64))


def _find_unit_m(scene: trimesh.Scene) -> float:
    written = str(scene.units).partition(" * meters")
    try:
        return float(written[0]) if written[1] else 1.0
    except ValueError:
        return 1.0


def _too_many_error(name: str, count: int) -> ModelError:
    return _mesh_error(
        name, f"has {count} triangles; use at most {MAX_TRIANGLES}", slug="mesh.triangles"
    )


def _mesh_error(
    name: str,
    fault: str,
    *,
    slug: str,
    code: int = SpawnCode.UNSUPPORTED_ASSETS,
) -> ModelError:
    return ModelError(f"mesh {quote(name)} {fault}", code=code, slug=slug)


MESH_READERS: dict[str, Callable[[str, bytes], Triangles]] = {
    "stl": _read_stl_file,
    "stlb": _read_stl_file,
    "obj": _read_obj_file,
    "dae": _read_dae_file,
    "glb": _read_glb_file,
}


GRID_CELLS = 512
"""Cells per side of the finest grid; each coarser grid has half as many."""
FIRST_HALVINGS = 2
"""Halvings of the first grid: most large meshes need it or a coarser one."""
MAX_HALVINGS = 5
MAX_TABLE_CELLS = 1 << 25
"""Maximum size of a lookup table by cell; in finer grids, corners are sorted."""

CellIndices = NDArray[np.int32]


def decimate(triangles: Triangles, max_count: int) -> Triangles:
    """Merge corners until few enough triangles are left; after the coarsest grid, drop the rest."""
    if len(triangles.faces) <= max_count:
        return triangles
    cells = _find_cells(triangles.vertices)
    halvings, faces = FIRST_HALVINGS, _merge_corners(cells, triangles.faces, FIRST_HALVINGS)
    while len(faces) > max_count and halvings < MAX_HALVINGS:
        halvings += 1
        faces = _merge_corners(cells, faces, halvings)
    if halvings == FIRST_HALVINGS:
        faces = _try_finer_grids(cells, triangles.faces, faces, max_count)
    return _compact(triangles.vertices, faces[:max_count])


def _try_finer_grids(cells: CellIndices, faces: Faces, found: Faces, max_count: int) -> Faces:
    for halvings in range(FIRST_HALVINGS - 1, -1, -1):
        if len(found) > max_count:
            break
        finer = _merge_corners(cells, faces, halvings)
        if len(finer) > max_count:
            break
        found = finer
    return found


def _find_cells(vertices: NDArray[np.float64]) -> CellIndices:
    """Find the cell of each corner in the finest grid."""
    low = vertices.min(axis=0)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9) / GRID_CELLS
    cells: CellIndices = np.floor((vertices - low) / size).astype(np.int32)
    return cells


def _merge_corners(cells: CellIndices, faces: Faces, halvings: int) -> Faces:
    """Replace each corner by the first of its cell; drop degenerate triangles."""
    side = (GRID_CELLS >> halvings) + 1
    used = _find_used_corners(faces, len(cells))
    x, y, z = (cells[used] >> halvings).T.astype(np.int64)
    cell = (x * side + y) * side + z
    first = np.zeros(len(cells), np.int64)
    first[used] = _first_in_cell(cell, used, side**3)
    a, b, c = new = first[faces].T
    kept: Faces = new.T[(a != b) & (b != c) & (a != c)]
    return kept


def _first_in_cell(cells: NDArray[np.int64], corners: NDArray[np.int64], count: int) -> Faces:
    """Find for each corner the first corner in its cell."""
    if count > MAX_TABLE_CELLS:
        _, firsts, cell_of = np.unique(cells, return_index=True, return_inverse=True)
        found: Faces = corners[firsts][cell_of]
        return found
    table = np.empty(count, np.int32)
    table[cells[::-1]] = corners[::-1]  # the last value written stays
    return table[cells].astype(np.int64)


def _find_used_corners(faces: Faces, count: int) -> NDArray[np.int64]:
    is_used = np.zeros(count, dtype=bool)
    is_used[faces.reshape(-1)] = True
    return np.flatnonzero(is_used)


def _compact(vertices: NDArray[np.float64], faces: Faces) -> Triangles:
    used = _find_used_corners(faces, len(vertices))
    number = np.zeros(len(vertices), np.int64)
    number[used] = np.arange(len(used))
    return Triangles(vertices[used], number[faces])


Points = NDArray[np.float64]
MeshFiles = dict[str, tuple[str, bytes | None]]
"""By mesh URI: sha256 and bytes."""

MAX_HULL_CORNERS = 96
MAX_STATIC_TRIANGLES = 20_000
"""Of a static collision."""
MAX_STATIC_TRIANGLES_OF_MODEL = 300_000
"""Of all static collisions of a model."""
MAX_PIECE_TRIANGLES = 2_500
"""The engine loads such a piece of a static mesh in a few milliseconds."""
MAX_VISUAL_TRIANGLES = 20_000
"""1 MB, which is sent in one message."""
MAX_EXACT_HULL_POINTS = 128
"""With more points, the hull is that of extreme points."""
POINTS_PER_CHUNK = 1 << 11
"""Points whose products fit into the processor's cache."""
FLAT_RATIO = 1e-4
"""Thickness over width."""


@dataclass
class MeshConversions:
    """Converted meshes, shared by models that share files.

    Attributes:
        meshes: Bytes by sha256.
        known: sha256 of the results by the file's sha256, the purpose and the maximum count.
    """

    meshes: dict[str, bytes] = field(default_factory=dict)
    known: dict[tuple[str, str, int], tuple[str, ...]] = field(default_factory=dict)


@dataclass
class _ModelConversion:
    files: dict[str, tuple[str, bytes]]
    purpose: str
    """Of collisions."""
    max_count: int
    """Triangles of a static collision."""
    conversions: MeshConversions
    report: list[ReportEntry] = field(default_factory=list)
    read: dict[str, Triangles] = field(default_factory=dict)


def convert_meshes(
    model: Model, files: dict[str, tuple[str, bytes]], conversions: MeshConversions
) -> Model:
    """Convert the meshes of a model; URIs become sha256 of meshes in `conversions`.

    Raises:
        ModelError: A collision's mesh cannot be read.
    """
    if not list_meshes(model):
        return model
    count = sum(shape.kind == "mesh" for link in model.links for shape in link.collisions)
    max_count = min(MAX_STATIC_TRIANGLES, MAX_STATIC_TRIANGLES_OF_MODEL // max(1, count))
    job = _ModelConversion(files, "static" if model.is_static else "hull", max_count, conversions)
    links = tuple(_convert_link(link, job) for link in model.links)
    return msgspec.structs.replace(model, links=links, report=(*model.report, *job.report))


def _convert_link(link: Link, job: _ModelConversion) -> Link:
    collisions = (_convert_collision(shape, job) for shape in link.collisions)
    visuals = (_convert_visual(link.name, shape, job) for shape in link.visuals)
    return msgspec.structs.replace(
        link,
        collisions=tuple(chain.from_iterable(collisions)),
        visuals=tuple(visual for visual in visuals if visual is not None),
    )


def _convert_collision(shape: Shape, job: _ModelConversion) -> tuple[Shape, ...]:
    return (shape,) if shape.kind != "mesh" else _convert_shape(shape, job.purpose, job)


def _convert_visual(link: str, shape: Shape, job: _ModelConversion) -> Shape | None:
    if shape.kind != "mesh":
        return shape
    try:
        return _convert_shape(shape, "visual", job)[0]
    except ModelError as error:
        job.report.append(
            ReportEntry("suspicious", f"link {quote(link)}", f"{error.message}; not drawn")
        )
        return None


def _convert_shape(shape: Shape, purpose: str, job: _ModelConversion) -> tuple[Shape, ...]:
    if is_generated(shape.mesh):
        source, data, purpose = shape.mesh, b"", "generated"
    else:
        source, data = job.files[shape.mesh]
    key = (source, purpose, job.max_count if purpose == "static" else 0)
    if (names := job.conversions.known.get(key)) is None:
        if source not in job.read:
            job.read[source] = _read_mesh_or_generate(shape.mesh, data)
        if purpose == "static":
            _report_decimation(shape.mesh, len(job.read[source].faces), job)
        parts = CONVERSIONS[purpose](job.read[source], job.max_count)
        stls = {sha256(stl).hexdigest(): stl for stl in map(write_stl, parts)}
        job.conversions.meshes.update(stls)
        names = job.conversions.known[key] = tuple(stls)
    return tuple(msgspec.structs.replace(shape, mesh=name) for name in names)


def _read_mesh_or_generate(uri: str, data: bytes) -> Triangles:
    if is_generated(uri):
        return _make_hull(np.array(list_corners(uri)))
    return read_mesh(uri, data)


def _report_decimation(uri: str, count: int, job: _ModelConversion) -> None:
    if count > job.max_count:
        fault = f"{count} triangles are reduced to {job.max_count} for collisions"
        job.report.append(ReportEntry("suspicious", f"mesh {quote(uri)}", fault))


def convex_hull(triangles: Triangles) -> Triangles:
    """Make the convex hull of the corners; of extreme ones only when there are many."""
    is_used = np.zeros(len(triangles.vertices), dtype=bool)
    is_used[triangles.faces] = True
    points = triangles.vertices[is_used]
    if len(points) > MAX_EXACT_HULL_POINTS:
        points = _select_extreme_points(points, MAX_EXACT_HULL_POINTS)
    hull = _make_hull(_thicken(points))
    if len(hull.vertices) > MAX_HULL_CORNERS:
        hull = _make_hull(_select_extreme_points(hull.vertices, MAX_HULL_CORNERS))
    return hull


def _thicken(points: Points) -> Points:
    """Extend a flat mesh, which has no hull, by a thousandth of its size on all sides."""
    spread = points - points.mean(axis=0)
    thinnest, _, widest = np.sqrt(np.maximum(np.linalg.eigvalsh(spread.T @ spread), 0.0)).tolist()
    if thinnest > FLAT_RATIO * widest:
        return points
    reach = max(float(np.abs(spread).max()), 1e-6) * 1e-3
    corners = np.array(np.meshgrid(*[[-reach, reach]] * 3)).T.reshape(-1, 3)
    thick: Points = (points[:, None, :] + corners[None, :, :]).reshape(-1, 3)
    return thick


def _make_hull(points: Points) -> Triangles:
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        hull = ConvexHull(points, qhull_options="QJ")
    used, places = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = points[used], places.reshape(-1, 3)
    # Qhull does not define the winding: flip triangles whose normal points inwards.
    first, second, third = (vertices[faces[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    inwards = ((first - vertices.mean(axis=0)) * normals).sum(axis=1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return Triangles(vertices, faces)


def _select_extreme_points(points: Points, count: int) -> Points:
    """Select the farthest points in directions on a Fibonacci sphere."""
    turns = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    ring = np.sqrt(1.0 - z * z)
    directions = np.stack([ring * np.cos(turns), ring * np.sin(turns), z], axis=1)
    even = (points / np.maximum(np.ptp(points, axis=0), 1e-9)).astype(np.float32).T.copy()
    chosen = _find_farthest(even, directions.astype(np.float32))
    found: Points = points[np.unique(chosen)]
    return found


def _find_farthest(
    points: NDArray[np.float32], directions: NDArray[np.float32]
) -> NDArray[np.int64]:
    """Find the index of the farthest of points (3, n) in each direction (m, 3)."""
    rows = np.arange(len(directions))
    farthest = np.full(len(directions), -np.inf, np.float32)
    chosen = np.zeros(len(directions), np.int64)
    for start in range(0, points.shape[1], POINTS_PER_CHUNK):
        products = directions @ points[:, start : start + POINTS_PER_CHUNK]
        best = np.argmax(products, axis=1)
        distances = products[rows, best]
        chosen = np.where(distances > farthest, best + start, chosen)
        farthest = np.maximum(distances, farthest)
    return chosen


def split_mesh(triangles: Triangles, max_count: int) -> list[Triangles]:
    """Split a mesh across its longest side until each piece has few enough triangles."""
    if len(triangles.faces) <= max_count:
        return [triangles]
    centres = triangles.vertices[triangles.faces].mean(axis=1)
    order = np.argsort(centres[:, np.ptp(centres, axis=0).argmax()], kind="stable")
    halves = np.array_split(triangles.faces[order], 2)
    return [
        piece
        for half in halves
        for piece in split_mesh(Triangles(triangles.vertices, half), max_count)
    ]


CONVERSIONS: dict[str, Callable[[Triangles, int], list[Triangles]]] = {
    "hull": lambda triangles, _: [convex_hull(triangles)],
    "static": lambda triangles, count: split_mesh(decimate(triangles, count), MAX_PIECE_TRIANGLES),
    "visual": lambda triangles, _: [decimate(triangles, MAX_VISUAL_TRIANGLES)],
    "generated": lambda triangles, _: [triangles],
}
