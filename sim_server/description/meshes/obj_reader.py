"""Lines of OBJ files, read in arrays: corners, faces of any size, points of images, materials."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zensim.sim_server.description.meshes.leading_numbers import read_leading_numbers

if TYPE_CHECKING:
    from collections.abc import Iterator

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
COMMENT = re.compile(rb"(?:(?<=[ \n])|^)#[^\n]*")
SPACE, NEWLINE, SLASH = b" \n/"
EXCERPT_BYTES = 200
"""Bytes of an invalid line that an error quotes."""


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
    if b"#" in text:
        text = COMMENT.sub(b"", text)
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
        # Words that have a byte after their first slash and before their second one.
        has_second = np.add.reduceat(is_second & (words.text > SPACE), words.starts) > 0
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
