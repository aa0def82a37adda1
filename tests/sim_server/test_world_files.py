"""Worlds are found, read and furnished; a strict server refuses doubtful ones."""

from pathlib import Path

import pytest

from proto.model import Shape
from sim_server.config import ConfigError
from sim_server.description.library import shipped_worlds
from sim_server.world_files import furnish, load_world
from tests.sim_server.fakes import a_world

CRATE = (
    "<model name='crate'><link name='box'><inertial><mass>1</mass><inertia><ixx>0.1</ixx>"
    "<iyy>0.1</iyy><izz>0.1</izz></inertia></inertial></link></model>"
)
FREE_M = 10.0
"""Nothing stands at x and y from 0 to this, where fleets are put."""


def a_file(folder: Path, inside: str) -> str:
    file = folder / "w.world"
    ground = "<include><uri>model://ground_plane</uri></include>"
    file.write_text(f"<sdf version='1.6'><world name='w'>{ground}{inside}</world></sdf>")
    return str(file)


@pytest.mark.parametrize("name", shipped_worlds())
def test_shipped_world_is_read_without_doubt(name: str) -> None:
    world = load_world(name, is_strict=True)

    assert world.ground_plane


@pytest.mark.parametrize("name", ["walls", "warehouse"])
def test_shipped_world_leaves_room_for_fleets(name: str) -> None:
    solids = [
        (placed.origin.position, shape)
        for placed in load_world(name).models
        for shape in placed.model.links[0].collisions
    ]

    assert solids
    assert [shape for at, shape in solids if _reaches_in(at, shape)] == []


def _reaches_in(at: tuple[float, float, float], shape: Shape) -> bool:
    spans = [
        (a + o - size / 2.0, a + o + size / 2.0)
        for a, o, size in zip(at, shape.origin.position, shape.size, strict=True)
    ]
    return all(low < FREE_M + 0.5 and high > -0.5 for low, high in spans[:2])


def test_world_file_includes_models_beside_it_and_from_the_path(tmp_path: Path) -> None:
    for folder, name in ((tmp_path / "beside", "near"), (tmp_path / "path", "far")):
        (folder / name).mkdir(parents=True)
        text = f"<sdf version='1.6'>{CRATE.replace('crate', name)}</sdf>"
        (folder / name / "model.sdf").write_text(text)
    includes = "".join(f"<include><uri>model://{name}</uri></include>" for name in ("near", "far"))

    world = load_world(a_file(tmp_path / "beside", includes), [str(tmp_path / "path")])

    assert [placed.name for placed in world.models] == ["near", "far"]


def test_strict_server_refuses_what_is_suspicious(tmp_path: Path) -> None:
    file = a_file(tmp_path, "<actor name='a'/>")

    assert load_world(file).models == ()
    with pytest.raises(ConfigError, match="refused by --strict: world: <actor> 'a'"):
        load_world(file, is_strict=True)


@pytest.mark.parametrize("name", ["", "nowhere", "/etc/nothing.world"])
def test_world_that_is_not_there_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="neither a file nor one of empty, walls, warehouse"):
        load_world(name)


def test_world_that_cannot_be_is_refused_with_its_slug(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"sdf\.include: "):
        load_world(a_file(tmp_path, "<include><uri>model://nothing</uri></include>"))


def test_models_of_a_world_become_its_entities(tmp_path: Path) -> None:
    world = a_world()

    furnish(world, load_world(a_file(tmp_path, CRATE)))

    (entity,) = world.entities
    assert (entity.name, entity.namespace, entity.belongs_to_world) == ("crate", "", True)


def test_model_that_the_engine_refuses_ends_the_start(tmp_path: Path) -> None:
    world = a_world()
    model = load_world(a_file(tmp_path, CRATE))
    furnish(world, model)

    with pytest.raises(ConfigError, match="model 'crate' of the world: "):
        furnish(world, model)
