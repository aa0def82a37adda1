"""Textures: images, materials of OBJ files, coordinates of primitives."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from zensim.proto.messages.model_messages import Shape
from zensim.sim_server.description.meshes.textures import (
    MAX_SIDE_PIXELS,
    ImageError,
    make_textured_solid,
    read_obj_materials,
    reduce_image,
)

RED = (255, 0, 0)


def an_image(
    kind: str = "PNG", size: tuple[int, int] = (4, 2), colour: tuple[int, ...] = RED
) -> bytes:
    stream = BytesIO()
    Image.new("RGBA" if len(colour) == 4 else "RGB", size, colour).save(stream, kind)
    return stream.getvalue()


def opened(data: bytes) -> Image.Image:
    return Image.open(BytesIO(data))


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "TGA", "BMP"])
def test_opaque_image_becomes_a_jpeg(kind: str) -> None:
    found = reduce_image(an_image(kind))

    assert (opened(found.data).format, opened(found.data).size) == ("JPEG", (4, 2))
    assert found.mean == pytest.approx((1.0, 0.0, 0.0, 1.0), abs=0.02)


def test_transparent_image_stays_transparent() -> None:
    found = reduce_image(an_image(colour=(0, 255, 0, 51)))

    assert opened(found.data).format == "PNG"
    assert found.mean == pytest.approx((0.0, 1.0, 0.0, 0.2), abs=0.01)


def test_image_with_a_palette_is_read() -> None:
    stream = BytesIO()
    Image.new("RGB", (4, 4), RED).convert("P").save(stream, "PNG")

    assert reduce_image(stream.getvalue()).mean[0] > 0.9


@pytest.mark.parametrize("size", [(3000, 20), (20, 3000), (2048, 2048)])
def test_large_image_is_reduced(size: tuple[int, int]) -> None:
    found = reduce_image(an_image("JPEG", size))

    assert max(opened(found.data).size) == MAX_SIDE_PIXELS
    assert found.pixels <= size[0] * size[1]


def test_same_image_gives_the_same_bytes() -> None:
    assert reduce_image(an_image()).data == reduce_image(an_image()).data


def a_bomb() -> bytes:
    """A PNG header of 30000 by 30000 pixels without them."""
    data = bytearray(an_image())
    data[16:24] = (30_000).to_bytes(4, "big") * 2
    return bytes(data)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x89PNG\r\n\x1a\n",
        an_image(size=(64, 64))[:60],
        an_image("GIF"),
        b"<svg xmlns='http://www.w3.org/2000/svg'/>",
        a_bomb(),
        an_image("JPEG")[:200],
    ],
    ids=["empty", "head", "cut", "gif", "svg", "bomb", "cut_jpeg"],
)
def test_bad_image_is_refused(data: bytes) -> None:
    with pytest.raises(ImageError):
        reduce_image(data)


def test_materials_of_an_obj_are_read() -> None:
    text = (
        b"newmtl red one\nKd 1 0 0\nd 0.5\n newmtl wood\nKd 0 0 0\nmap_Kd  wood.png \nnewmtl none\n"
    )

    found = read_obj_materials(text)

    assert found["red one"].rgba == (1.0, 0.0, 0.0, 0.5)
    assert (found["wood"].rgba, found["wood"].image) == ((1.0, 1.0, 1.0, 1.0), "wood.png")
    assert found["none"].image == ""


def test_bad_numbers_of_a_material_are_not_used() -> None:
    found = read_obj_materials(b"newmtl a\nKd nan 7 x\nd 0\nTr 2\n\xff\xfe")

    assert found["a"].rgba == (1.0, 1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    "shape",
    [
        Shape("box", (1.0, 2.0, 3.0)),
        Shape("sphere", (0.5, 0.0, 0.0)),
        Shape("cylinder", (0.5, 2.0, 0.0)),
        Shape("capsule", (0.5, 2.0, 0.0)),
    ],
    ids=lambda shape: shape.kind,
)
def test_textured_solid_is_closed_and_faces_outward(shape: Shape) -> None:
    solid = make_textured_solid(shape)

    first, second, third = (solid.corners[:, i] for i in range(3))
    volume = float((np.cross(first, second) * third).sum() / 6.0)
    exact = {"box": 6.0, "sphere": 0.524, "cylinder": 1.571, "capsule": 2.094}[shape.kind]
    assert volume == pytest.approx(exact, rel=0.03)
    assert solid.coordinates.shape == (len(solid.corners), 3, 2)
    spans = (solid.coordinates.min(), solid.coordinates.max())
    assert spans == pytest.approx((0.0, 1.0))


def test_image_is_upright_on_the_sides_of_a_box() -> None:
    solid = make_textured_solid(Shape("box", (2.0, 2.0, 2.0)))

    corners, points = solid.corners.reshape(-1, 3), solid.coordinates.reshape(-1, 2)
    front = corners[:, 0] == 1.0
    is_side = np.repeat(np.all(front.reshape(-1, 3), axis=1), 3)
    assert np.array_equal(points[is_side, 1] == 1.0, corners[is_side, 2] == 1.0)
    assert np.array_equal(points[is_side, 0] == 1.0, corners[is_side, 1] == 1.0)
