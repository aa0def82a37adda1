"""The text of an OBJ file to corners and triangles, pieces of it at once: never line by line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zensim.sim_server.description.number_text import leading_numbers

if TYPE_CHECKING:
    from collections.abc import Iterator

Corners = NDArray[np.float64]
Faces = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Numbers = NDArray[np.int64]

PIECE_BYTES = 1 << 22
"""Read at once, and no line is as long."""
AXES = 3
MAX_SIDES = 10_000
"""Of any face."""
FARTHEST = 1 << 40
"""A number of a corner beyond which no file goes."""
BLANKS = bytes.maketrans(b"\t\v\f\r", b"   \n")
SPACE, NEWLINE, SLASH = b" \n/"
SHOWN = 200
"""Bytes of a wrong line."""


class NoObj(ValueError):
    """A line that is none of an OBJ."""

    def __init__(self, line: bytes) -> None:
        super().__init__(line)
        self.line = line


@dataclass(frozen=True, eq=False)
class _Words:
    """The words of a piece of text: where each begins, up to the next, and which line it is of.

    `lines` are the places in `starts` of the first word of each line that has one.
    """

    text: Bytes
    starts: Numbers
    lengths: Numbers
    lines: Numbers
    counts: Numbers
    """Words of each line."""

    def of_kind(self, letter: bytes) -> NDArray[np.bool_]:
        """Say of each line whether its first word is a letter."""
        first = self.starts[self.lines]
        alone = self.text[np.minimum(first + 1, len(self.text) - 1)] <= SPACE
        is_letter: NDArray[np.bool_] = self.text[first] == letter[0]
        is_whole: NDArray[np.bool_] = is_letter & (alone | (first + 1 == len(self.text)))
        return is_whole

    def line(self, number: int) -> bytes:
        """Find a line."""
        start = int(self.starts[self.lines[number]])
        return self.text[start : start + SHOWN].tobytes().partition(b"\n")[0]


def read_obj(data: bytes, most: int) -> tuple[Corners, Faces]:
    """Read corners (v, 3) and triangles (f, 3) of their numbers, from 0; nothing is checked.

    Args:
        data: The file.
        most: Triangles after which no more are read.

    Raises:
        NoObj: A line holds something else than numbers.
    """
    corners = [np.zeros((0, 3))]
    faces = [np.zeros((0, 3), dtype=np.int64)]
    known = found = 0
    for piece in _pieces(data):
        words = _words(piece)
        is_corner = words.of_kind(b"v")
        corners.append(_corners(words, is_corner))
        faces.append(_triangles(words, known + np.cumsum(is_corner)))
        known += len(corners[-1])
        found += len(faces[-1])
        if found > most:
            break
    return np.concatenate(corners), np.concatenate(faces)


def _pieces(data: bytes) -> Iterator[bytes]:
    """Cut a text after lines."""
    text = data.translate(BLANKS)
    if b"\\\n" in text:
        text = text.replace(b"\\\n", b" ")
    start = 0
    while start < len(text):
        end = min(start + PIECE_BYTES, len(text))
        if end < len(text):
            end = text.rfind(b"\n", start, end) + 1
        if end <= start:
            raise NoObj(text[start : start + SHOWN])
        yield text[start:end]
        start = end


def _words(piece: bytes) -> _Words:
    text = np.frombuffer(piece, np.uint8)
    is_word = text > SPACE
    starts = np.flatnonzero(is_word & ~np.concatenate([[False], is_word[:-1]]))
    line_of = np.cumsum(text == NEWLINE, dtype=np.int32)[starts]
    lines = np.flatnonzero(np.diff(line_of, prepend=-1))
    lengths = np.diff(starts, append=len(text))
    return _Words(text, starts, lengths, lines, np.diff(lines, append=len(starts)))


def _corners(words: _Words, is_corner: NDArray[np.bool_]) -> Corners:
    """Read the three words after each `v`; colours and weights may follow."""
    if len(short := np.flatnonzero(is_corner & (words.counts <= AXES))):
        raise NoObj(words.line(short[0]))
    place = np.arange(len(words.starts)) - np.repeat(words.lines, words.counts)
    is_read = np.repeat(is_corner, words.counts) & (place >= 1) & (place <= AXES)
    text = words.text[_spread(is_read, words)]
    return _read(text, np.float64, words, is_read).reshape(-1, AXES)


def _triangles(words: _Words, known: Numbers) -> Faces:
    """Read what follows each `f`.

    Args:
        words: Of a piece.
        known: Corners before the end of each line, which numbers below 0 count from.
    """
    is_face = words.of_kind(b"f")
    if len(wide := np.flatnonzero(is_face & (words.counts > MAX_SIDES))):
        raise NoObj(words.line(wide[0]))
    is_read = np.repeat(is_face, words.counts)
    is_read[words.lines] = False
    plain = np.where(_is_beside(words), np.uint8(SPACE), words.text)
    numbers = _read(plain[_spread(is_read, words)], np.int64, words, is_read)
    if len(far := np.flatnonzero(np.abs(numbers) > FARTHEST)):
        raise NoObj(words.line(int(_line_of(words, is_read)[far[0]])))
    sides = words.counts[is_face] - 1
    behind = np.repeat(known[is_face], sides)
    return _fans(np.where(numbers < 0, numbers + behind, numbers - 1), sides)


def _spread(of_words: NDArray[np.bool_], words: _Words) -> NDArray[np.bool_]:
    """Say of each byte what is said of its word, the blanks behind it included."""
    lead = int(words.starts[0]) if len(words.starts) else len(words.text)
    return np.concatenate([np.zeros(lead, dtype=bool), np.repeat(of_words, words.lengths)])


def _is_beside(words: _Words) -> NDArray[np.bool_]:
    """Say which bytes name the texture and the normal of a corner: from a slash to a blank."""
    is_slash: NDArray[np.bool_] = words.text == SLASH
    if not is_slash.any():
        return is_slash
    slashes = np.cumsum(is_slash, dtype=np.int32)
    before = (slashes - is_slash)[words.starts]
    lead = len(words.text) - int(words.lengths.sum())
    inside = slashes[lead:] > np.repeat(before, words.lengths)
    is_beside: NDArray[np.bool_] = np.concatenate([np.zeros(lead, dtype=bool), inside])
    is_beside[words.text <= SPACE] = False
    return is_beside


def _read(
    text: Bytes, kind: type[np.number[Any]], words: _Words, is_read: NDArray[np.bool_]
) -> NDArray[Any]:
    """Read as many numbers as there are words.

    Raises:
        NoObj: One is none.
    """
    ends = np.cumsum(words.lengths[is_read])
    found = leading_numbers(text.tobytes(), kind)
    if len(found) != len(ends):
        wrong = _wrong_word(text, ends, kind)
        raise NoObj(words.line(int(_line_of(words, is_read)[wrong])))
    return found


def _wrong_word(text: Bytes, ends: Numbers, kind: type[np.number[Any]]) -> int:
    """Find the first word that is no number, by halves."""
    places = np.concatenate([[0], ends])
    first, behind = 0, len(ends)
    while behind - first > 1:
        middle = (first + behind) // 2
        half = text[places[first] : places[middle]].tobytes()
        if len(leading_numbers(half, kind)) == middle - first:
            first = middle
        else:
            behind = middle
    return first


def _line_of(words: _Words, is_read: NDArray[np.bool_]) -> Numbers:
    return np.repeat(np.arange(len(words.lines)), words.counts)[is_read]


def _fans(numbers: Faces, sides: Numbers) -> Faces:
    """Part faces of so many sides into triangles that share the first corner."""
    triangles = np.maximum(sides - 2, 0)
    first = np.repeat(np.cumsum(sides) - sides, triangles)
    place = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    fans: Faces = numbers[np.stack([first, first + place + 1, first + place + 2], axis=1)]
    return fans
