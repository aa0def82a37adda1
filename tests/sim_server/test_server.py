"""Server: which world it starts with."""

from pathlib import Path

import pytest

from sim_server.config import ConfigError
from sim_server.server import load_world

MOON = (
    '<sdf version="1.6"><world name="moon"><gravity>0 0 -1.62</gravity>'
    "<include><uri>model://ground_plane</uri></include></world></sdf>"
)


def test_world_is_read_by_its_shipped_name() -> None:
    world = load_world("empty")

    assert (world.name, world.ground_plane, world.sun) == ("default", True, True)


def test_world_is_read_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "moon.sdf"
    file.write_text(MOON, encoding="utf-8")

    world = load_world(str(file))

    assert (world.name, world.gravity) == ("moon", (0.0, 0.0, -1.62))


@pytest.mark.parametrize("name", ["nowhere.sdf", "mars", "", "."])
def test_world_is_refused_when_it_is_neither_shipped_nor_a_file(name: str) -> None:
    with pytest.raises(ConfigError, match=f"world '{name}' is neither a file nor one of empty"):
        load_world(name)


@pytest.mark.parametrize("content", [b"<sdf", b"<robot name='r'/>", b"", b"\xff\xfe\x00"])
def test_world_is_refused_when_its_file_is_none(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "broken.sdf"
    file.write_bytes(content)

    with pytest.raises(ConfigError, match="broken"):
        load_world(str(file))
