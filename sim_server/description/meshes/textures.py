"""Textures: images checked and reduced, materials of OBJ files, coordinates of primitives.

Images are decoded in the parser process and encoded again, so that what a viewer gets is small and
was written by this module.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

# TGA is not loaded with the common formats, and the sandbox permits no later imports.
from PIL import Image, TgaImagePlugin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zensim.proto.messages.model_messages import Quat, Shape

MAX_SIDE_PIXELS = 1024
MAX_SOURCE_PIXELS = 1 << 25
"""8192 by 4096: 134 MB while it is decoded. JPEG is decoded at up to an eighth of its sides."""
IMAGE_FORMATS = ("PNG", "JPEG", TgaImagePlugin.TgaImageFile.format, "BMP")
PLAIN_MODES = ("RGB", "RGBA")
JPEG_QUALITY = 85
PNG_LEVEL = 2
OPAQUE = 255


class ImageError(ValueError):
    """An image that cannot be used; the text is the reason."""


@dataclass(frozen=True)
class ReducedImage:
    """An encoded image, JPEG if it is opaque and else PNG, its mean colour, and its source's size.

    Attributes:
        pixels: That were decoded.
    """

    data: bytes
    mean: Quat
    pixels: int


def reduce_image(data: bytes) -> ReducedImage:
    """Decode an image, reduce its sides to 1024 pixels, and encode it.

    Raises:
        ImageError: It is none of PNG, JPEG, TGA and BMP, too large or damaged.
    """
    try:
        with Image.open(BytesIO(data), formats=IMAGE_FORMATS) as source:
            source.draft("RGB", (MAX_SIDE_PIXELS, MAX_SIDE_PIXELS))
            width, height = source.size
            _check_size(width, height)
            image = source if source.mode in PLAIN_MODES else source.convert(_find_mode(source))
            image.thumbnail((MAX_SIDE_PIXELS, MAX_SIDE_PIXELS))
            image = _drop_opaque_alpha(image)
            return ReducedImage(_encode(image), _find_mean(image), width * height)
    except ImageError:
        raise
    # Decoders raise any exception for damaged images, MemoryError for large ones.
    except Exception as error:
        raise ImageError(f"cannot be decoded: {type(error).__name__} {str(error)[:80]}") from error


def warm_up_images() -> None:
    """Read and write an image of each format: the sandbox later prevents lazy imports."""
    for kind in IMAGE_FORMATS:
        stream = BytesIO()
        Image.new("RGB", (2, 2)).save(stream, kind)
        reduce_image(stream.getvalue())
    _encode(Image.new("RGBA", (2, 2)))


def _check_size(width: int, height: int) -> None:
    if width * height > MAX_SOURCE_PIXELS:
        raise ImageError(f"has {width} by {height} pixels; reduce it")


def _find_mode(source: Image.Image) -> str:
    has_alpha = "A" in source.getbands() or "transparency" in source.info
    return "RGBA" if has_alpha else "RGB"


def _drop_opaque_alpha(image: Image.Image) -> Image.Image:
    if image.mode == "RGBA" and image.getchannel("A").getextrema() == (OPAQUE, OPAQUE):
        return image.convert("RGB")
    return image


def _encode(image: Image.Image) -> bytes:
    stream = BytesIO()
    if image.mode == "RGB":
        image.save(stream, "JPEG", quality=JPEG_QUALITY)
    else:
        # A third of the time of the default level, for an eighth more bytes.
        image.save(stream, "PNG", compress_level=PNG_LEVEL)
    return stream.getvalue()


def _find_mean(image: Image.Image) -> Quat:
    red, green, blue, alpha = np.asarray(image.convert("RGBA")).mean(axis=(0, 1)) / OPAQUE
    return (float(red), float(green), float(blue), float(alpha))


@dataclass(frozen=True)
class ObjMaterial:
    """A material of an OBJ file: its colour, and its image as written."""

    rgba: Quat
    image: str = ""


_MATERIAL_LINE = re.compile(
    r"^[ \t]*(newmtl|Kd|d|Tr|map_Kd)[ \t]+(\S[^\r\n]*?)[ \t]*$", re.MULTILINE
)
WHITE: Quat = (1.0, 1.0, 1.0, 1.0)


def read_obj_materials(data: bytes) -> dict[str, ObjMaterial]:
    """Read the materials of an MTL file by name: diffuse colour, opacity and image."""
    found: dict[str, dict[str, str]] = {}
    values: dict[str, str] = {}
    for key, value in _MATERIAL_LINE.findall(data.decode("utf-8", "replace")):
        if key == "newmtl":
            values = found.setdefault(value, {})
        else:
            values[key] = value
    return {name: _make_obj_material(values) for name, values in found.items()}


def _make_obj_material(values: dict[str, str]) -> ObjMaterial:
    colour, opaque = (
        _read_unit_numbers(values.get("Kd", "")),
        _read_unit_numbers(values.get("d", "")),
    )
    clear = _read_unit_numbers(values.get("Tr", ""))
    alpha = opaque[0] if opaque else 1.0 - clear[0] if clear else 1.0
    image = values.get("map_Kd", "")
    # Exporters write a diffuse colour of any value beside an image.
    red, green, blue = colour if len(colour) == len(WHITE[:3]) and not image else WHITE[:3]
    # Writers disagree on whether d or Tr is opacity; an invisible material is not drawn.
    return ObjMaterial((red, green, blue, alpha or 1.0), image)


def _read_unit_numbers(text: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return []
    return [min(max(number, 0.0), 1.0) for number in numbers if math.isfinite(number)]


@dataclass(frozen=True, eq=False)
class TexturedSolid:
    """Triangles of a primitive and their texture coordinates.

    Attributes:
        corners: (f, 3, 3) [m].
        coordinates: (f, 3, 2).
    """

    corners: NDArray[np.float64]
    coordinates: NDArray[np.float64]


ROUND_SEGMENTS = 32
ARC_STEPS = 8
"""Steps of a quarter of a circle."""
_SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
"""Corners of two triangles that form a unit square."""


def make_textured_solid(shape: Shape) -> TexturedSolid:
    """Make the triangles of a box, sphere, cylinder or capsule about its own origin.

    Each side of a box shows the whole image, upright. An image goes once around a round solid.
    """
    if shape.kind == "box":
        return _make_box(np.array(shape.size))
    radius = shape.size[0]
    length = 0.0 if shape.kind == "sphere" else shape.size[1]
    if shape.kind == "cylinder":
        profile = [
            (0.0, -length / 2),
            (radius, -length / 2),
            (radius, length / 2),
            (0.0, length / 2),
        ]
    else:
        angles = np.linspace(0.0, np.pi / 2, ARC_STEPS + 1)
        upper = [(radius * np.cos(a), length / 2 + radius * np.sin(a)) for a in angles]
        profile = [(r, -z) for r, z in reversed(upper)] + upper[0 if length else 1 :]
    return _revolve(np.array(profile))


def _make_box(size: NDArray[np.float64]) -> TexturedSolid:
    corners = []
    # Right and up of the image on each side, seen from outside.
    for right, up in (
        ((0, 1, 0), (0, 0, 1)), ((0, -1, 0), (0, 0, 1)), ((-1, 0, 0), (0, 0, 1)),
        ((1, 0, 0), (0, 0, 1)), ((1, 0, 0), (0, 1, 0)), ((1, 0, 0), (0, -1, 0)),
    ):  # fmt: skip
        axes = np.array((right, up))
        side = (_SQUARE * 2.0 - 1.0) @ axes + np.cross(right, up)
        corners.append(side * size / 2.0)
    return TexturedSolid(
        np.concatenate(corners).reshape(-1, 3, 3), np.tile(_SQUARE, (6, 1)).reshape(-1, 3, 2)
    )


def _revolve(profile: NDArray[np.float64]) -> TexturedSolid:
    """Turn a profile (n, 2) of radius and height, lowest first, about z."""
    lengths = np.hypot(*np.diff(profile, axis=0).T)
    v = np.concatenate([[0.0], np.cumsum(lengths)]) / max(float(lengths.sum()), 1e-12)
    u = np.linspace(0.0, 1.0, ROUND_SEGMENTS + 1)
    ring = np.stack([np.cos(2.0 * np.pi * u), np.sin(2.0 * np.pi * u)], axis=1)
    points = np.concatenate(
        [profile[:, None, :1] * ring[None], np.repeat(profile[:, None, 1:], len(u), axis=1)], axis=2
    )
    image = np.stack(np.meshgrid(u, v), axis=2)
    return TexturedSolid(_join_rows(points), _join_rows(image))


def _join_rows(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Make the triangles (f, 3, k) between neighbours of a grid (rows, columns, k)."""
    low_left, low_right = grid[:-1, :-1], grid[:-1, 1:]
    high_left, high_right = grid[1:, :-1], grid[1:, 1:]
    corners = [low_left, low_right, high_right, low_left, high_right, high_left]
    return np.stack(corners, axis=2).reshape(-1, 3, grid.shape[2])
