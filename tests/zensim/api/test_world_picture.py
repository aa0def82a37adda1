"""Pictures of a world."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import zensim
from zensim.api.world_picture import WorldPicture
from zensim.sim_server.scene.camera_images import CamerasUnavailable
from zensim.sim_server.sensors.camera_sensors import ViewedScene

WIDTH, HEIGHT = 320, 200
BOX = """<robot name="box"><link name="base_link">VISUAL
<collision><geometry><box size="1 1 1"/></geometry></collision>
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link></robot>"""
HEAD_BYTES = 41
"""Of a PNG file, before its compressed rows."""


@pytest.fixture(scope="module")
def world() -> Iterator[zensim.World]:
    with zensim.World() as world:
        world.spawn_fleet("box_bot", count=4, layout="grid", spacing=2.0)
        yield world


def read_pixels(picture: WorldPicture) -> np.ndarray:
    """Read the colours (h, w, 3) of a picture."""
    width, height = struct.unpack(">II", picture.png[16:24])
    rows = zlib.decompress(picture.png[HEAD_BYTES:-16])
    lines = np.frombuffer(rows, np.uint8).reshape(height, 1 + 3 * width)
    return lines[:, 1:].reshape(height, width, 3)


def test_picture_shows_all_robots_within_its_edges(world: zensim.World) -> None:
    pixels = read_pixels(world.picture(width=WIDTH, height=HEIGHT)).astype(int)

    coloured = np.ptp(pixels, axis=2) > 60  # robots are blue, the ground is grey
    rows, columns = np.nonzero(coloured)
    assert pixels.shape == (HEIGHT, WIDTH, 3)
    assert rows.min() > 0
    assert rows.max() < HEIGHT - 1
    assert columns.min() > 0
    assert columns.max() < WIDTH - 1
    assert max(np.ptp(rows) / HEIGHT, np.ptp(columns) / WIDTH) > 0.5


@pytest.mark.parametrize(
    "visual", ["", "<visual><geometry><box size='1 1 1'/></geometry></visual>"]
)
def test_picture_shows_a_robot_with_or_without_visuals(tmp_path: Path, visual: str) -> None:
    file = tmp_path / "box.urdf"
    file.write_text(BOX.replace("VISUAL", visual))
    with zensim.World() as world:
        world.spawn(file)
        pixels = read_pixels(world.picture(width=WIDTH, height=HEIGHT))

    assert len(np.unique(pixels[80:120, 140:180].reshape(-1, 3), axis=0)) > 1


def test_picture_is_saved_as_a_png_file(world: zensim.World, tmp_path: Path) -> None:
    picture = world.picture(width=WIDTH, height=HEIGHT)

    picture.save(tmp_path / "world.png")

    assert (tmp_path / "world.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert repr(picture) == "<WorldPicture, 320 x 200 pixels>"


@pytest.mark.parametrize("side", [0, 4097, 1.5])
def test_picture_of_a_wrong_size_is_refused(world: zensim.World, side: float) -> None:
    with pytest.raises(zensim.Invalid, match="width"):
        world.picture(width=side)  # type: ignore[arg-type]


def test_host_without_cameras_makes_no_pictures(
    world: zensim.World, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise CamerasUnavailable("install libegl1")

    monkeypatch.setattr(ViewedScene, "find_renderer", refuse)

    with pytest.raises(zensim.Unsupported) as caught:
        world.picture()

    assert caught.value.slug == "no_cameras"
