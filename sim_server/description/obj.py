"""The text of an OBJ file to corners and triangles."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Corners = NDArray[np.float64]
Faces = NDArray[np.int64]

BESIDE_CORNER = re.compile(r"/\S*")
"""Of a word of a face: its texture and its normal."""
INDENTED = re.compile(rb"^ +[vf]\s", re.MULTILINE)
FARTHEST = 1 << 40
"""A number of a corner beyond which no file goes."""
MAX_SIDES = 10_000
"""Of any face."""
MOST_SIDES = 64
"""Of a face that is read together with others."""


class NoObj(ValueError):
    """A line that is none of an OBJ."""

    def __init__(self, line: bytes) -> None:
        super().__init__(line)
        self.line = line


def read_obj(data: bytes) -> tuple[Corners, Faces]:
    """Read corners (v, 3) and triangles (f, 3) of their numbers, from 0; nothing is checked.

    Raises:
        NoObj: A line holds something else than numbers.
    """
    text = data.replace(b"\\\n", b" ").replace(b"\t", b" ")
    lines = text.splitlines()
    found = None
    if INDENTED.search(text) is None:
        found = _at_once(
            [line for line in lines if line.startswith(b"v ")],
            [line for line in lines if line.startswith(b"f ")],
        )
    return found or _line_by_line(lines)


def _at_once(corners: list[bytes], faces: list[bytes]) -> tuple[Corners, Faces] | None:
    """Read a regular file; None when it is none, whatever that means."""
    words = [len(line.split()) - 1 for line in corners]
    sides = np.array([len(line.split()) - 1 for line in faces], dtype=np.int64)
    if len(set(words)) > 1 or (len(sides) and sides.max() > MOST_SIDES):
        return None
    try:
        written = _rest(corners).split()
        places = np.array(list(map(float, written))).reshape(len(corners), -1)[:, :3]
        numbers = np.array(list(map(int, BESIDE_CORNER.sub("", _rest(faces)).split())), np.int64)
    except (ValueError, OverflowError):
        return None
    is_plain = places.shape[1:] == (3,) and len(numbers) == sides.sum() and (numbers > 0).all()
    return (places, _fans(numbers - 1, sides)) if is_plain else None


def _rest(lines: list[bytes]) -> str:
    return b" ".join(line[2:] for line in lines).decode("ascii")


def _fans(numbers: Faces, sides: Faces) -> Faces:
    """Part faces of so many sides into triangles that share the first corner."""
    starts = np.cumsum(sides) - sides
    fans = [np.zeros((0, 3), dtype=np.int64)]
    for second in range(1, int(sides.max(initial=0)) - 1):
        first = starts[sides > second + 1]
        fans.append(numbers[np.stack([first, first + second, first + second + 1], axis=1)])
    return np.concatenate(fans)


def _line_by_line(lines: list[bytes]) -> tuple[Corners, Faces]:
    vertices: list[tuple[float, float, float]] = []
    faces: list[tuple[int, int, int]] = []
    for line in lines:
        words = line.split()
        try:
            if words[:1] == [b"v"]:
                x, y, z = words[1:4]
                vertices.append((float(x), float(y), float(z)))
            elif words[:1] == [b"f"]:
                if len(words) > MAX_SIDES:
                    raise NoObj(line)
                corners = [_corner(word, len(vertices)) for word in words[1:]]
                faces.extend((corners[0], b, c) for b, c in pairwise(corners[1:]))
        except ValueError as error:
            raise NoObj(line) from error
    return np.array(vertices).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3)


def _corner(word: bytes, count: int) -> int:
    number = int(word.partition(b"/")[0])
    if abs(number) > FARTHEST:
        raise ValueError(number)
    return number - 1 if number > 0 else number + count
