"""Meshes of a model for engine and viewer: hulls, split static meshes, decimated visuals.

A moving body collides by the convex hulls of its meshes, a static one by their triangles. A visual
becomes one mesh for each material of its file. The results are binary STL in the scale of the
file, images and texture coordinates, named by their sha256.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from io import BytesIO
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
from lxml import etree
from numpy.typing import ArrayLike, NDArray

from zensim.proto.messages.asset_messages import list_reference_uris, list_references
from zensim.proto.messages.model_messages import ReportEntry, Texture
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.stl import STL_HEAD, STL_RECORD, read_corners, write_corners
from zensim.sim_server.description.meshes.convex_hull import find_exact_hull, find_hull
from zensim.sim_server.description.meshes.generated_solids import is_generated, list_corners
from zensim.sim_server.description.meshes.mesh_lookup import has_assets
from zensim.sim_server.description.meshes.textures import (
    OPAQUE,
    WHITE,
    ImageError,
    ObjMaterial,
    make_textured_solid,
    read_obj_materials,
    reduce_image,
)
from zensim.sim_server.description.strict_parsing import quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import trimesh
    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Link, Model, Quat, Shape

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

    def starts_with_word(self, word: bytes) -> NDArray[np.bool_]:
        """Find for each line whether this is its first word."""
        last, first = len(self.text) - 1, self.starts[self.lines]
        after = first + len(word)
        is_word: NDArray[np.bool_] = (self.text[np.minimum(after, last)] <= SPACE) | (after > last)
        for place, letter in enumerate(word):
            is_word &= self.text[np.minimum(first + place, last)] == letter
        return is_word

    def line(self, number: int) -> bytes:
        """Get the text of a line, cut to 200 bytes."""
        start = int(self.starts[self.lines[number]])
        return self.text[start : start + EXCERPT_BYTES].tobytes().partition(b"\n")[0]


@dataclass(frozen=True, eq=False)
class ObjContent:
    """Corners (v, 3), triangles (f, 3) and materials of an OBJ file; indices start at 0.

    Attributes:
        points: Points of images (t, 2).
        images: Indices of points (f, 3); -1 without.
        names: Names of materials.
        materials: Index of each triangle's material (f,); -1 without.
    """

    corners: Corners
    faces: Faces
    points: Corners
    images: Faces
    names: tuple[str, ...]
    materials: IntArray


def read_obj(data: bytes, max_count: int) -> ObjContent:
    """Read an OBJ file without checks of the range of indices.

    Args:
        data: The file.
        max_count: Reading stops after this many triangles.

    Raises:
        ObjSyntaxError: A line has an invalid number.
    """
    reader = _ObjReader()
    for chunk in _split_chunks(data):
        reader.read(_index_words(chunk))
        if sum(map(len, reader.faces)) > max_count:
            break
    return ObjContent(
        np.concatenate(reader.corners),
        np.concatenate(reader.faces),
        np.concatenate(reader.points),
        np.concatenate(reader.images),
        tuple(reader.names),
        np.concatenate(reader.materials),
    )


class _ObjReader:
    """Reads an OBJ file chunk by chunk."""

    def __init__(self) -> None:
        self.corners, self.points = [np.zeros((0, 3))], [np.zeros((0, 2))]
        self.faces, self.images = ([np.zeros((0, 3), dtype=np.int64)] for _ in range(2))
        self.materials = [np.zeros(0, dtype=np.int64)]
        self.names: dict[str, int] = {}
        self._corner_count = self._point_count = 0
        self._material = -1

    def read(self, words: _WordIndex) -> None:
        """Add the content of a chunk."""
        is_corner, is_point = words.starts_with_word(b"v"), words.starts_with_word(b"vt")
        corners = self._corner_count + np.cumsum(is_corner)
        points = self._point_count + np.cumsum(is_point)
        self.corners.append(_read_columns(words, is_corner, AXES))
        self.points.append(_read_columns(words, is_point, 2))
        faces, images, lines = _read_faces(words, corners, points)
        self.faces.append(faces)
        self.images.append(images)
        self.materials.append(self._read_materials(words)[lines])
        self._corner_count += int(is_corner.sum())
        self._point_count += int(is_point.sum())

    def _read_materials(self, words: _WordIndex) -> IntArray:
        """Find the material that applies at each line."""
        is_use = words.starts_with_word(b"usemtl")
        used = [self._material]
        for line in np.flatnonzero(is_use):
            name = words.line(int(line)).partition(b" ")[2].strip().decode("utf-8", "replace")
            used.append(self.names.setdefault(name, len(self.names)))
        self._material = used[-1]
        return np.array(used, dtype=np.int64)[np.cumsum(is_use)]


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


def _read_columns(words: _WordIndex, is_row: NDArray[np.bool_], count: int) -> Corners:
    """Read the first numbers after the first word of lines; what follows them is ignored."""
    if len(short := np.flatnonzero(is_row & (words.counts <= count))):
        raise ObjSyntaxError(words.line(short[0]))
    place = np.arange(len(words.starts)) - np.repeat(words.lines, words.counts)
    is_read = np.repeat(is_row, words.counts) & (place >= 1) & (place <= count)
    text = words.text[_spread_to_bytes(is_read, words)]
    return _read_selected(text, np.float64, words, is_read).reshape(-1, count)


def _read_faces(
    words: _WordIndex, corners: IntArray, points: IntArray
) -> tuple[Faces, Faces, IntArray]:
    """Read the corners after each `f`.

    Args:
        words: Of a chunk.
        corners: Corners before the end of each line; negative numbers are relative to it.
        points: Points of images before the end of each line.

    Returns:
        Corners and points (f, 3) of the triangles, and their lines (f,).
    """
    is_face = words.starts_with_word(b"f")
    if len(wide := np.flatnonzero(is_face & (words.counts > MAX_FACE_SIDES))):
        raise ObjSyntaxError(words.line(wide[0]))
    is_read = np.repeat(is_face, words.counts)
    is_read[words.lines] = False
    slashes, sides = _count_slashes(words), words.counts[is_face] - 1
    is_first = slashes == 0
    numbers = _read_indices(words, is_read, is_first, np.repeat(corners[is_face], sides))
    lines = np.repeat(np.flatnonzero(is_face), np.maximum(sides - 2, 0))
    faces = _triangulate(numbers, sides)
    is_second = (slashes == 1) & (words.text != SLASH)
    images = np.full(len(numbers), -1, dtype=np.int64)
    if is_second.any():
        has_second = _has_second(words, is_second)
        chosen, known = has_second[is_read], np.repeat(points[is_face], sides)
        images[chosen] = _read_indices(words, is_read & has_second, is_second, known[chosen])
    return faces, _triangulate(images, sides), lines


def _read_indices(
    words: _WordIndex, is_read: NDArray[np.bool_], is_kept: NDArray[np.bool_], known: IntArray
) -> IntArray:
    """Read one number of each word from the kept bytes, as an index from 0.

    Args:
        words: Of a chunk.
        is_read: Words.
        is_kept: Bytes; others are blanks.
        known: What negative numbers are relative to.
    """
    plain = np.where(is_kept | (words.text <= SPACE), words.text, np.uint8(SPACE))
    numbers = _read_selected(plain[_spread_to_bytes(is_read, words)], np.int64, words, is_read)
    if len(far := np.flatnonzero(np.abs(numbers) > MAX_CORNER_NUMBER)):
        raise ObjSyntaxError(words.line(int(_line_of_each(words, is_read)[far[0]])))
    indices: IntArray = np.where(numbers < 0, numbers + known, numbers - 1)
    return indices


def _has_second(words: _WordIndex, is_second: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find the words that have a byte after their first slash and before their second one."""
    return np.add.reduceat(is_second & (words.text > SPACE), words.starts) > 0


def _spread_to_bytes(of_words: NDArray[np.bool_], words: _WordIndex) -> NDArray[np.bool_]:
    """Repeat a value of each word for its bytes and the blanks after it."""
    lead = int(words.starts[0]) if len(words.starts) else len(words.text)
    return np.concatenate([np.zeros(lead, dtype=bool), np.repeat(of_words, words.lengths)])


def _count_slashes(words: _WordIndex) -> NDArray[np.int32]:
    """Count for each byte the slashes of its word up to it; those of blanks are not defined."""
    is_slash: NDArray[np.bool_] = words.text == SLASH
    slashes: NDArray[np.int32] = np.cumsum(is_slash, dtype=np.int32)
    if not len(words.starts) or not slashes[-1]:
        return slashes
    before = (slashes - is_slash)[words.starts]
    lead = len(words.text) - int(words.lengths.sum())
    counts: NDArray[np.int32] = slashes.copy()
    counts[lead:] -= np.repeat(before, words.lengths).astype(np.int32)
    return counts


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


FindFile = Callable[[str], tuple[str, bytes] | None]
"""Finds the sha256 and the bytes of a file by its URI; None if the server does not have it."""


def find_no_file(uri: str) -> None:  # noqa: ARG001  every FindFile takes a URI
    """Return None: there are no files."""
    return None


class MeshMaterial(NamedTuple):
    """A material of a mesh file; `image` is an encoded image, empty without."""

    rgba: Quat | None = None
    image: bytes = b""


PLAIN = MeshMaterial()


@dataclass(frozen=True, eq=False)
class Appearance:
    """Materials of the triangles of a mesh.

    Attributes:
        material_of: Index of each triangle's material (f,).
        coordinates: Of the image (f, 3, 2), u to the right and v upward.
        missing: Files that were not found, as named in the mesh file.
    """

    materials: tuple[MeshMaterial, ...]
    material_of: NDArray[np.int64]
    coordinates: NDArray[np.float32]
    missing: tuple[str, ...] = ()

    def select(self, faces: NDArray[Any]) -> Appearance:
        """Make the appearance of some of the triangles."""
        return Appearance(
            self.materials, self.material_of[faces], self.coordinates[faces], self.missing
        )


@dataclass(frozen=True, eq=False)
class Triangles:
    """Corners (v, 3) in the scale of the file, and corner indices of triangles (f, 3)."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    appearance: Appearance | None = None


def read_mesh(name: str, data: bytes, find_file: FindFile = find_no_file) -> Triangles:
    """Read a mesh file by the extension of its name.

    Args:
        name: URI of the file.
        data: Its content.
        find_file: Finds the materials and images that it names.

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
    return _check_triangles(name, MESH_READERS[ending](name, data, find_file))


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


def _read_stl_file(name: str, data: bytes, _: FindFile) -> Triangles:
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


def _read_obj_file(name: str, data: bytes, find_file: FindFile) -> Triangles:
    try:
        content = read_obj(data, MAX_TRIANGLES)
    except ObjSyntaxError as error:
        what = quote(error.line.decode(errors="replace"))
        raise _mesh_error(name, f"has an invalid line: {what}", slug="mesh.unreadable") from error
    looks = _make_obj_appearance(name, data, content, find_file) if content.names else None
    return Triangles(content.corners, content.faces, looks)


class _FileFinder(Mapping[str, bytes]):
    """Finds the files that a file names; `missing` lists those that were not found.

    It is a mapping because trimesh asks one for images.
    """

    def __init__(self, owner: str, find_file: FindFile) -> None:
        self.missing: dict[str, None] = {}
        self._owner, self._find_file = owner, find_file

    def find(self, reference: str, owner: str = "") -> tuple[str, bytes]:
        """Find URI and content of a file; empty content if it is missing."""
        for uri in list_reference_uris(owner or self._owner, reference):
            if (found := self._find_file(uri)) is not None:
                return uri, found[1]
        self.missing[reference] = None
        return "", b""

    def __getitem__(self, name: str) -> bytes:
        """Find the content of a file."""
        _, data = self.find(name)
        if not data:
            raise KeyError(name)
        return data

    def __iter__(self) -> Iterator[str]:
        """List nothing: files are found by name only."""
        return iter(())

    def __len__(self) -> int:
        """Return 0: files are found by name only."""
        return 0


def _make_obj_appearance(
    name: str, data: bytes, content: ObjContent, find_file: FindFile
) -> Appearance:
    finder = _FileFinder(name, find_file)
    written: dict[str, tuple[str, ObjMaterial]] = {}
    for reference in list_references("a.obj", data):
        uri, text = finder.find(reference)
        written |= {key: (uri, one) for key, one in read_obj_materials(text).items()}
    materials = [PLAIN]
    for key in content.names:
        uri, material = written.get(key, ("", ObjMaterial(WHITE)))
        image = finder.find(material.image, uri)[1] if material.image else b""
        materials.append(MeshMaterial(material.rgba, image) if key in written else PLAIN)
    is_mapped = (content.images >= 0).all(axis=1) & (content.images < len(content.points)).all(
        axis=1
    )
    coordinates = np.zeros((len(content.faces), 3, 2), np.float32)
    coordinates[is_mapped] = content.points[content.images[is_mapped]]
    return Appearance(tuple(materials), content.materials + 1, coordinates, tuple(finder.missing))


def _read_dae_file(name: str, data: bytes, find_file: FindFile) -> Triangles:
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
    return _load_with_trimesh(name, data, "dae", find_file)


def _read_glb_file(name: str, data: bytes, find_file: FindFile) -> Triangles:
    try:
        check_glb_header(data)
    except GltfError as error:
        raise _mesh_error(name, f"cannot be read: {error}", slug="mesh.unreadable") from error
    return _load_with_trimesh(name, data, "glb", find_file)


def _load_with_trimesh(name: str, data: bytes, kind: str, find_file: FindFile) -> Triangles:
    import trimesh

    # It logs tracebacks for textures that are not here.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    finder = _FileFinder(name, find_file)
    try:
        scene = trimesh.load_scene(BytesIO(data), file_type=kind, resolver=finder)
        parts = [_place_geometry(scene, node) for node in scene.graph.nodes_geometry]
    except MemoryError:
        raise
    # Parsers of trimesh raise any exception for invalid files.
    except Exception as error:
        fault = f"cannot be read: {type(error).__name__} {str(error)[:120]}"
        raise _mesh_error(name, fault, slug="mesh.unreadable") from error
    return _join_geometries(
        [part for part in parts if part is not None], _find_unit_m(scene), tuple(finder.missing)
    )


class _PlacedGeometry(NamedTuple):
    """A geometry of a scene in the frame of the scene."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: MeshMaterial
    coordinates: NDArray[np.float32]


def _place_geometry(scene: trimesh.Scene, node: str) -> _PlacedGeometry | None:
    import trimesh

    matrix, name = scene.graph[node]
    part = scene.geometry[name]
    if not isinstance(part, trimesh.Trimesh):
        return None
    faces = np.asarray(part.faces, dtype=np.int64)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        faces = faces[:, ::-1]
    vertices = np.asarray(part.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    material, points = _read_visual(part.visual)
    coordinates = (
        np.zeros((len(faces), 3, 2), np.float32)
        if points is None or len(points) != len(vertices)
        else points[faces].astype(np.float32)
    )
    if points is None or not np.isfinite(coordinates).all():
        return _PlacedGeometry(
            vertices, faces, material._replace(image=b""), np.zeros((len(faces), 3, 2), np.float32)
        )
    return _PlacedGeometry(vertices, faces, material, coordinates)


def _read_visual(
    visual: trimesh.visual.ColorVisuals | trimesh.visual.TextureVisuals | None,
) -> tuple[MeshMaterial, NDArray[Any] | None]:
    """Read material and texture coordinates; colours of vertices become their mean."""
    import trimesh

    if not isinstance(visual, trimesh.visual.TextureVisuals):
        if visual is None or not visual.defined:
            return PLAIN, None
        return MeshMaterial(_to_rgba(visual.main_color)), None
    material = visual.material
    colour = getattr(material, "baseColorFactor", None)
    image = getattr(material, "baseColorTexture", None)
    # The image is not decoded here.
    data = image.fp.getvalue() if image is not None else b""
    points = visual.uv[:, :2] if data and visual.uv is not None else None
    return MeshMaterial(WHITE if colour is None else _to_rgba(colour), data), points


def _to_rgba(colour: ArrayLike) -> Quat:
    """Convert a colour of trimesh, in bytes or from 0 to 1; an invisible one becomes opaque."""
    values = np.asarray(colour).reshape(-1)[:4]
    scaled = values / OPAQUE if values.dtype.kind in "iu" else values.astype(float)
    red, green, blue, alpha = np.clip(np.append(scaled, 1.0)[:4], 0.0, 1.0).tolist()
    return (red, green, blue, alpha or 1.0)


def _join_geometries(
    parts: Sequence[_PlacedGeometry], unit_m: float, missing: tuple[str, ...]
) -> Triangles:
    if not parts:
        return Triangles(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + at for part, at in zip(parts, starts, strict=False)]
    number: dict[MeshMaterial, int] = {}
    material_of = [
        np.full(len(part.faces), number.setdefault(part.material, len(number))) for part in parts
    ]
    looks = Appearance(
        tuple(number),
        np.concatenate(material_of),
        np.concatenate([part.coordinates for part in parts]),
        missing,
    )
    vertices = np.concatenate([part.vertices for part in parts]) * unit_m
    return Triangles(vertices, np.concatenate(faces), looks if set(number) != {PLAIN} else None)


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


MESH_READERS: dict[str, Callable[[str, bytes, FindFile], Triangles]] = {
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


class _MergedFaces(NamedTuple):
    """Triangles (f, 3) after corners were merged, and their numbers before (f,)."""

    faces: Faces
    numbers: IntArray


def decimate(triangles: Triangles, max_count: int) -> Triangles:
    """Merge corners until few enough triangles are left; after the coarsest grid, drop the rest.

    Triangles keep their texture coordinates.
    """
    if len(triangles.faces) <= max_count:
        return triangles
    cells = _find_cells(triangles.vertices)
    halvings, merged = FIRST_HALVINGS, _merge_corners(cells, triangles.faces, FIRST_HALVINGS)
    while len(merged.faces) > max_count and halvings < MAX_HALVINGS:
        halvings += 1
        further = _merge_corners(cells, merged.faces, halvings)
        merged = _MergedFaces(further.faces, merged.numbers[further.numbers])
    if halvings == FIRST_HALVINGS:
        merged = _try_finer_grids(cells, triangles.faces, merged, max_count)
    looks = triangles.appearance
    return _compact(
        triangles.vertices,
        merged.faces[:max_count],
        looks.select(merged.numbers[:max_count]) if looks else None,
    )


def _try_finer_grids(
    cells: CellIndices, faces: Faces, found: _MergedFaces, max_count: int
) -> _MergedFaces:
    for halvings in range(FIRST_HALVINGS - 1, -1, -1):
        if len(found.faces) > max_count:
            break
        finer = _merge_corners(cells, faces, halvings)
        if len(finer.faces) > max_count:
            break
        found = finer
    return found


def _find_cells(vertices: NDArray[np.float64]) -> CellIndices:
    """Find the cell of each corner in the finest grid."""
    low = vertices.min(axis=0)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9) / GRID_CELLS
    cells: CellIndices = np.floor((vertices - low) / size).astype(np.int32)
    return cells


def _merge_corners(cells: CellIndices, faces: Faces, halvings: int) -> _MergedFaces:
    """Replace each corner by the first of its cell; drop degenerate triangles."""
    side = (GRID_CELLS >> halvings) + 1
    used = _find_used_corners(faces, len(cells))
    x, y, z = (cells[used] >> halvings).T.astype(np.int64)
    cell = (x * side + y) * side + z
    first = np.zeros(len(cells), np.int64)
    first[used] = _first_in_cell(cell, used, side**3)
    a, b, c = new = first[faces].T
    numbers = np.flatnonzero((a != b) & (b != c) & (a != c))
    return _MergedFaces(new.T[numbers], numbers)


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


def _compact(
    vertices: NDArray[np.float64], faces: Faces, appearance: Appearance | None
) -> Triangles:
    used = _find_used_corners(faces, len(vertices))
    number = np.zeros(len(vertices), np.int64)
    number[used] = np.arange(len(used))
    return Triangles(vertices[used], number[faces], appearance)


MeshFiles = dict[str, tuple[str, bytes | None]]
"""By mesh URI: sha256 and bytes."""

MAX_STATIC_TRIANGLES = 20_000
"""Of a static collision."""
MAX_STATIC_TRIANGLES_OF_MODEL = 300_000
"""Of all static collisions of a model."""
MAX_PIECE_TRIANGLES = 2_500
"""The engine loads such a piece of a static mesh in a few milliseconds."""
MAX_VISUAL_TRIANGLES = 20_000
"""1 MB, which is sent in one message."""


class ConvertedPart(NamedTuple):
    """A converted mesh by its sha256, and the colour and texture of its file."""

    mesh: str
    rgba: Quat | None = None
    texture: Texture | None = None


ConversionKey = tuple[str, str, int]
"""sha256 of a file, the purpose, and the maximum count of triangles."""


@dataclass
class MeshConversions:
    """Converted meshes and images, shared by models that share files.

    Attributes:
        meshes: Bytes of meshes, images and texture coordinates by sha256.
        known: Parts of each conversion.
        images: sha256 of each reduced image, and its mean colour, by the sha256 of its source.
        faults: Why images cannot be used, by the sha256 of their source.
    """

    meshes: dict[str, bytes] = field(default_factory=dict)
    known: dict[ConversionKey, tuple[ConvertedPart, ...]] = field(default_factory=dict)
    images: dict[str, tuple[str, Quat]] = field(default_factory=dict)
    faults: dict[str, str] = field(default_factory=dict)
    image_bytes: int = 0
    source_pixels: int = 0

    def store(self, data: bytes) -> str:
        """Add a result; return its sha256."""
        name = sha256(data).hexdigest()
        self.meshes[name] = data
        return name

    def convert_image(self, data: bytes) -> tuple[str, Quat]:
        """Reduce an image; return its sha256, empty without room for it, and its mean colour.

        Raises:
            ImageError: It cannot be used.
        """
        source = sha256(data).hexdigest()
        if source in self.faults:
            raise ImageError(self.faults[source])
        if source not in self.images:
            try:
                self.images[source] = self._reduce(data)
            except ImageError as error:
                self.faults[source] = str(error)
                raise
        return self.images[source]

    def _reduce(self, data: bytes) -> tuple[str, Quat]:
        if self.source_pixels > MAX_SOURCE_PIXELS_IN_ALL:
            raise ImageError(f"comes after {MAX_SOURCE_PIXELS_IN_ALL} pixels of others")
        reduced = reduce_image(data)
        self.source_pixels += reduced.pixels
        self.image_bytes += len(reduced.data)
        has_room = self.image_bytes <= MAX_IMAGE_BYTES_IN_ALL
        return (self.store(reduced.data) if has_room else ""), reduced.mean


MAX_SOURCE_PIXELS_IN_ALL = 1 << 27
"""That are decoded for a robot or a world: 6 s of CPU."""
MAX_IMAGE_BYTES_IN_ALL = 48 << 20
"""Of the reduced images of a robot or a world; further ones become their mean colour."""
MAX_PARTS = 64
"""Parts of different materials of one visual."""


@dataclass
class _ModelConversion:
    find_file: FindFile
    purpose: str
    """Of collisions."""
    max_count: int
    """Triangles of a static collision."""
    conversions: MeshConversions
    overrides_materials: bool
    """Whether the colour of a visual replaces the materials of its file, as in SDF."""
    report: list[ReportEntry] = field(default_factory=list)
    read: dict[str, Triangles] = field(default_factory=dict)


def convert_meshes(
    model: Model,
    find_file: FindFile,
    conversions: MeshConversions,
    *,
    overrides_materials: bool = True,
) -> Model:
    """Convert the meshes of a model; URIs become sha256 of what is in `conversions`.

    Args:
        model: With URIs of meshes and images.
        find_file: Finds them, and the materials and images that meshes name.
        conversions: Gets the results.
        overrides_materials: Whether the colour of a visual replaces the materials of its file, as
            in SDF; else it is that of parts without a material, as in URDF.

    Raises:
        ModelError: A collision's mesh cannot be read.
    """
    if not has_assets(model):
        return model
    count = sum(shape.kind == "mesh" for link in model.links for shape in link.collisions)
    max_count = min(MAX_STATIC_TRIANGLES, MAX_STATIC_TRIANGLES_OF_MODEL // max(1, count))
    purpose = "static" if model.is_static else "hull"
    job = _ModelConversion(find_file, purpose, max_count, conversions, overrides_materials)
    links = tuple(_convert_link(link, job) for link in model.links)
    report = dict.fromkeys(job.report)
    return msgspec.structs.replace(model, links=links, report=(*model.report, *report))


def _convert_link(link: Link, job: _ModelConversion) -> Link:
    collisions = (_convert_collision(shape, job) for shape in link.collisions)
    visuals = (_convert_visual(link.name, shape, job) for shape in link.visuals)
    return msgspec.structs.replace(
        link,
        collisions=tuple(chain.from_iterable(collisions)),
        visuals=tuple(chain.from_iterable(visuals)),
    )


def _convert_collision(shape: Shape, job: _ModelConversion) -> tuple[Shape, ...]:
    if shape.kind != "mesh":
        return (shape,)
    parts = _convert_shape(shape, job.purpose, job)
    return tuple(msgspec.structs.replace(shape, mesh=part.mesh) for part in parts)


def _convert_visual(link: str, shape: Shape, job: _ModelConversion) -> tuple[Shape, ...]:
    shape = _convert_texture(shape, job)
    if shape.kind != "mesh":
        return (shape if shape.texture is None else _cover_solid(shape, shape.texture, job),)
    is_covered = shape.texture is not None
    is_plain = shape.rgba is not None and job.overrides_materials and not is_covered
    purpose = "covered" if is_covered else "plain" if is_plain else "visual"
    try:
        parts = _convert_shape(shape, purpose, job)
    except ModelError as error:
        job.report.append(
            ReportEntry("suspicious", f"link {quote(link)}", f"{error.message}; not drawn")
        )
        return ()
    return tuple(_paint(shape, part) for part in parts)


def _paint(shape: Shape, part: ConvertedPart) -> Shape:
    """Give a shape the mesh, colour and texture of a part of its file, or its own texture."""
    texture, rgba = part.texture, part.rgba or shape.rgba
    if shape.texture is not None:
        coordinates = part.texture.coordinates if part.texture else ""
        texture = Texture(shape.texture.image, coordinates) if coordinates else None
        rgba = shape.rgba
    return msgspec.structs.replace(shape, mesh=part.mesh, rgba=rgba, texture=texture)


def _convert_texture(shape: Shape, job: _ModelConversion) -> Shape:
    """Replace the URI of a shape's own image by that of its asset; left out if it is unusable."""
    if shape.texture is None:
        return shape
    uri = shape.texture.image
    found = job.find_file(uri)
    image = ""
    if found is None:
        _report_texture(uri, "is not on the server", job)
    else:
        image, mean = _convert_image(uri, found[1], job)
        if not image and mean is not None:
            return msgspec.structs.replace(shape, rgba=shape.rgba or mean, texture=None)
    return msgspec.structs.replace(shape, texture=Texture(image) if image else None)


def _convert_image(name: str, data: bytes, job: _ModelConversion) -> tuple[str, Quat | None]:
    """Convert an image; empty, and reported, if it cannot be used."""
    try:
        image, mean = job.conversions.convert_image(data)
    except ImageError as error:
        _report_texture(name, str(error), job)
        return "", None
    if not image:
        _report_texture(name, "is one too many; its mean colour is drawn", job)
    return image, mean


def _report_texture(name: str, fault: str, job: _ModelConversion) -> None:
    # A world is not refused for a colour.
    job.report.append(ReportEntry("ignored", f"texture {quote(name)}", fault))


def _cover_solid(shape: Shape, texture: Texture, job: _ModelConversion) -> Shape:
    """Replace a primitive by a mesh with texture coordinates."""
    solid = make_textured_solid(shape)
    coordinates = job.conversions.store(solid.coordinates.astype("<f4").tobytes())
    return msgspec.structs.replace(
        shape,
        kind="mesh",
        size=(1.0, 1.0, 1.0),
        mesh=job.conversions.store(write_corners(solid.corners)),
        texture=Texture(texture.image, coordinates),
    )


def _convert_shape(shape: Shape, purpose: str, job: _ModelConversion) -> tuple[ConvertedPart, ...]:
    if is_generated(shape.mesh):
        source, data, purpose = shape.mesh, b"", "generated"
    else:
        source, data = job.find_file(shape.mesh) or ("", b"")
    # Files of equal content may name different images beside them.
    place = shape.mesh if purpose == "visual" else ""
    key = (source + place, purpose, job.max_count if purpose == "static" else 0)
    if (parts := job.conversions.known.get(key)) is None:
        if source not in job.read:
            job.read[source] = _read_mesh_or_generate(shape.mesh, data, job.find_file)
        if purpose == "static":
            _report_decimation(shape.mesh, len(job.read[source].faces), job)
        parts = job.conversions.known[key] = tuple(CONVERSIONS[purpose](job.read[source], job))
    return parts


def _read_mesh_or_generate(uri: str, data: bytes, find_file: FindFile) -> Triangles:
    if is_generated(uri):
        return Triangles(*find_exact_hull(np.array(list_corners(uri))))
    return read_mesh(uri, data, find_file)


def _report_decimation(uri: str, count: int, job: _ModelConversion) -> None:
    if count > job.max_count:
        fault = f"{count} triangles are reduced to {job.max_count} for collisions"
        job.report.append(ReportEntry("suspicious", f"mesh {quote(uri)}", fault))


def convex_hull(triangles: Triangles) -> Triangles:
    """Make the convex hull of the corners that triangles use."""
    is_used = np.zeros(len(triangles.vertices), dtype=bool)
    is_used[triangles.faces] = True
    return Triangles(*find_hull(triangles.vertices[is_used]))


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


def _store_meshes(meshes: Sequence[Triangles], job: _ModelConversion) -> Iterator[ConvertedPart]:
    for mesh in meshes:
        yield ConvertedPart(job.conversions.store(write_stl(mesh)))


def _convert_static(triangles: Triangles, job: _ModelConversion) -> Iterator[ConvertedPart]:
    reduced = decimate(triangles, job.max_count)
    return _store_meshes(split_mesh(reduced, MAX_PIECE_TRIANGLES), job)


def _convert_plain(triangles: Triangles, job: _ModelConversion) -> Iterator[ConvertedPart]:
    return _store_meshes([decimate(triangles, MAX_VISUAL_TRIANGLES)], job)


def _convert_covered(triangles: Triangles, job: _ModelConversion) -> Iterator[ConvertedPart]:
    """Convert a mesh for the image of its visual; without coordinates it stays plain."""
    drawn = decimate(triangles, MAX_VISUAL_TRIANGLES)
    mesh, looks = job.conversions.store(write_stl(drawn)), drawn.appearance
    if looks is None or not looks.coordinates.any():
        yield ConvertedPart(mesh)
        return
    yield ConvertedPart(mesh, texture=Texture("", _store_coordinates(looks.coordinates, job)))


def _convert_materials(triangles: Triangles, job: _ModelConversion) -> Iterator[ConvertedPart]:
    """Convert a mesh into a part for each of its materials."""
    drawn = decimate(triangles, MAX_VISUAL_TRIANGLES)
    looks = drawn.appearance
    if looks is None:
        yield from _store_meshes([drawn], job)
        return
    for name in looks.missing:
        _report_texture(name, "is not on the server", job)
    painted = [_convert_material(material, job) for material in looks.materials]
    groups: dict[ConvertedPart, list[int]] = {}
    for number in np.unique(looks.material_of).tolist():
        groups.setdefault(painted[number], []).append(number)
    for part, numbers in _limit_groups(groups):
        faces = np.flatnonzero(np.isin(looks.material_of, numbers))
        mesh = job.conversions.store(write_corners(drawn.vertices[drawn.faces[faces]]))
        texture = part.texture
        if texture is not None:
            texture = Texture(texture.image, _store_coordinates(looks.coordinates[faces], job))
        yield ConvertedPart(mesh, part.rgba, texture)


def _limit_groups(
    groups: dict[ConvertedPart, list[int]],
) -> Iterator[tuple[ConvertedPart, list[int]]]:
    """List the first groups; the last one has the materials of all others, too."""
    listed = list(groups.items())
    yield from listed[: MAX_PARTS - 1]
    if rest := listed[MAX_PARTS - 1 :]:
        yield rest[0][0], [number for _, numbers in rest for number in numbers]


def _convert_material(material: MeshMaterial, job: _ModelConversion) -> ConvertedPart:
    """Convert a material; the mesh of the result is still empty."""
    if not material.image:
        return ConvertedPart("", material.rgba)
    image, mean = _convert_image("in the mesh", material.image, job)
    if image:
        return ConvertedPart("", material.rgba, Texture(image))
    return ConvertedPart("", mean or material.rgba)


def _store_coordinates(coordinates: NDArray[np.float32], job: _ModelConversion) -> str:
    return job.conversions.store(coordinates.astype("<f4").tobytes())


CONVERSIONS: dict[str, Callable[[Triangles, _ModelConversion], Iterator[ConvertedPart]]] = {
    "hull": lambda triangles, job: _store_meshes([convex_hull(triangles)], job),
    "static": _convert_static,
    "plain": _convert_plain,
    "covered": _convert_covered,
    "visual": _convert_materials,
    "generated": lambda triangles, job: _store_meshes([triangles], job),
}
