"""Worlds are found, read and furnished; a strict server refuses doubtful ones."""

import sys
from pathlib import Path

import pytest
import trimesh

from tests.sim_server.description.meshes.test_mesh_conversion import exported
from tests.sim_server.fakes import a_world
from zensim.proto.messages.model_messages import Shape
from zensim.sim_server.description.builtin_models import list_builtin_worlds
from zensim.sim_server.server_config import ConfigError
from zensim.sim_server.world_loading import world_loader
from zensim.sim_server.world_loading.world_loader import (
    WorldLoaderRequest,
    list_warnings,
    load_world_in_process,
    spawn_models,
)
from zensim.sim_server.world_loading.world_loader_process import load_world_file

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


@pytest.mark.parametrize("name", list_builtin_worlds())
def test_shipped_world_is_read_without_doubt(name: str) -> None:
    world = load_world_file(name, is_strict=True)

    assert world.model.ground_plane


@pytest.mark.parametrize("name", ["walls", "warehouse"])
def test_shipped_world_leaves_room_for_fleets(name: str) -> None:
    solids = [
        (placed.origin.position, shape)
        for placed in load_world_file(name).model.models
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

    world = load_world_file(a_file(tmp_path / "beside", includes), [str(tmp_path / "path")])

    assert [placed.name for placed in world.model.models] == ["near", "far"]


def test_strict_server_refuses_what_is_suspicious(tmp_path: Path) -> None:
    file = a_file(tmp_path, "<actor name='a'/>")

    assert load_world_file(file).model.models == ()
    with pytest.raises(ConfigError, match="refused by --strict: world: <actor> 'a'"):
        load_world_file(file, is_strict=True)


@pytest.mark.parametrize("name", ["", "nowhere", "/etc/nothing.world"])
def test_world_that_is_not_there_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="neither a file nor one of empty, walls, warehouse"):
        load_world_file(name)


def test_world_that_cannot_be_is_refused_with_its_slug(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"sdf\.include: "):
        load_world_file(a_file(tmp_path, "<include><uri>model://nothing</uri></include>"))


def test_models_of_a_world_become_its_entities(tmp_path: Path) -> None:
    world = a_world()

    spawn_models(world, load_world_file(a_file(tmp_path, CRATE)).model)

    (entity,) = world.entities
    assert (entity.name, entity.namespace, entity.belongs_to_world) == ("crate", "", True)


def test_model_that_the_engine_refuses_ends_the_start(tmp_path: Path) -> None:
    world = a_world()
    model = load_world_file(a_file(tmp_path, CRATE)).model
    spawn_models(world, model)

    with pytest.raises(ConfigError, match="model 'crate' of the world: "):
        spawn_models(world, model)


def a_mesh_model(name: str, uri: str, *, is_static: bool = False) -> str:
    mesh = f"<geometry><mesh><uri>{uri}</uri><scale>2 2 2</scale></mesh></geometry>"
    return (
        f"<model name='{name}'><static>{str(is_static).lower()}</static><link name='l'><inertial>"
        "<mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>"
        f"<collision name='c'>{mesh}</collision><visual name='v'>{mesh}</visual></link></model>"
    )


def a_torus(ending: str) -> bytes:
    return exported(trimesh.creation.torus(1.0, 0.3), ending)


@pytest.mark.parametrize("ending", ["stl", "dae", "obj"])
def test_meshes_of_a_world_are_read_beside_it_and_from_the_path(
    tmp_path: Path, ending: str
) -> None:
    (tmp_path / "path" / "rings" / "meshes").mkdir(parents=True)
    (tmp_path / "path" / "rings" / "meshes" / f"ring.{ending}").write_bytes(a_torus(ending))
    (tmp_path / f"ring.{ending}").write_bytes(a_torus(ending))
    inside = a_mesh_model("near", f"ring.{ending}", is_static=True)
    inside += a_mesh_model("far", f"model://rings/meshes/ring.{ending}")

    world = load_world_file(a_file(tmp_path, inside), [str(tmp_path / "path")])

    near, far = (placed.model.links[0] for placed in world.model.models)
    assert list_warnings(world.model.report) == []
    assert near.collisions[0].size == (2.0, 2.0, 2.0)
    assert near.visuals[0].mesh == far.visuals[0].mesh
    sizes = [len(world.meshes[link.collisions[0].mesh]) for link in (near, far)]
    assert sizes[0] > 5 * sizes[1]  # as it is, and its hull


def test_mesh_that_an_included_model_names_is_beside_that_model(tmp_path: Path) -> None:
    for number, name in enumerate(("one", "two"), start=1):
        (tmp_path / name).mkdir()
        ring = trimesh.creation.torus(number, 0.1)
        (tmp_path / name / "a.stl").write_bytes(exported(ring, "stl"))
        sdf = f"<sdf version='1.6'>{a_mesh_model(name, 'a.stl')}</sdf>"
        (tmp_path / name / "model.sdf").write_text(sdf)
    includes = "".join(f"<include><uri>model://{name}</uri></include>" for name in ("one", "two"))

    world = load_world_file(a_file(tmp_path, includes))

    one, two = (placed.model.links[0].collisions[0].mesh for placed in world.model.models)
    assert one != two


def test_mesh_that_is_not_here_or_is_none_is_told(tmp_path: Path) -> None:
    (tmp_path / "bad.stl").write_bytes(b"no mesh")
    inside = a_mesh_model("bad", "bad.stl") + a_mesh_model("gone", "file:///etc/gone.stl")

    world = load_world_file(a_file(tmp_path, inside)).model

    assert [placed.name for placed in world.models] == ["gone"]
    assert world.models[0].model.links[0].collisions == ()
    left_out, *missing = sorted(list_warnings(world.report), reverse=True)
    assert left_out.startswith("model 'bad': left out: mesh.length: mesh 'bad.stl'")
    assert [fault.partition(", ")[0] for fault in missing] == ["gone: link 'l'"] * 2


def test_part_of_a_mesh_is_told_to_be_the_whole(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(a_torus("stl"))
    part = "</uri><submesh><name>half</name></submesh>"
    file = a_file(tmp_path, a_mesh_model("m", "a.stl").replace("</uri>", part, 1))

    (fault,) = list_warnings(load_world_file(file).model.report)

    assert fault.endswith("<submesh>: not supported; the whole mesh is used")


def test_world_is_the_same_when_it_is_read_elsewhere(tmp_path: Path) -> None:
    file = a_file(tmp_path, "<include><uri>model://near</uri></include>")
    (tmp_path / "path" / "near").mkdir(parents=True)
    near = f"<sdf version='1.6'>{CRATE.replace('crate', 'near')}</sdf>"
    (tmp_path / "path" / "near" / "model.sdf").write_text(near)
    paths = (str(tmp_path / "path"),)

    assert load_world_in_process(WorldLoaderRequest(file, paths)) == load_world_file(file, paths)
    assert load_world_in_process(WorldLoaderRequest("walls")) == load_world_file("walls")


def test_world_is_refused_as_it_is_here_when_it_is_read_elsewhere(tmp_path: Path) -> None:
    file = a_file(tmp_path, "<actor name='a'/>")

    with pytest.raises(ConfigError, match="refused by --strict: world: <actor> 'a'"):
        load_world_in_process(WorldLoaderRequest(file, is_strict=True))


def test_world_is_refused_when_it_kills_who_reads_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world_loader, "COMMAND", (sys.executable, "-c", "raise SystemExit(9)"))

    with pytest.raises(ConfigError, match="status 9"):
        load_world_in_process(WorldLoaderRequest("deadly.world"))
