"""Colours of robots on the page, distinct with colour blindness, too."""

from collections.abc import Sequence
from typing import Final, TypeAlias
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

Rgb: TypeAlias = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

ROBOT_COLOURS: Final[tuple[Rgb, ...]] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (213, 94, 0),
    (86, 180, 233),
    (204, 121, 167),
    (240, 228, 66),
)
"""Palette of Okabe and Ito (2008) without black, so that neighbours in a row differ most."""
GAMMA: Final = 2.2
DIGITS: Final = "0123456789"


def find_robot_colour(name: str) -> Rgb:
    """Find the colour of a robot.

    It depends on the name alone, so a robot keeps it when others come and go. Numbered robots take
    turns: equal colours are seven numbers apart.
    """
    digits = name[len(name.rstrip(DIGITS)) :]
    number = int(digits[-4:]) if digits else crc32(name.encode())
    return ROBOT_COLOURS[number % len(ROBOT_COLOURS)]


def to_linear(colours: Sequence[Rgb] | NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Convert colours (..., 3) as screens show them to the linear ones of batches and segments.

    viser 1.1 does not convert them, so they would be pale.
    """
    linear: NDArray[np.uint8] = np.round(255.0 * (np.asarray(colours) / 255.0) ** GAMMA).astype(
        np.uint8
    )
    return linear
