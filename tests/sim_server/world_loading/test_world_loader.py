"""World files are loaded with models and meshes, and their models are spawned."""

import sys
from pathlib import Path

import pytest
import trimesh

from tests.sim_server.description.meshes.mesh_samples import exported
from tests.sim_server.fakes import a_world
from zensim.proto.messages.model_messages import Shape
from zensim.proto.settings.start_settings import WorldFileSettings
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
"""The area with x and y from 0 to this is free, for fleets."""


def a_file(folder: Path, content: str) -> str:
    file = folder / "w.world"
    ground = "<include><uri>model://ground_plane</uri></include>"
    file.write_text(f"<sdf version='1.6'><world name='w'>{ground}{content}</world></sdf>")
    return str(file)


@pytest.mark.parametrize("name", list_builtin_worlds())
def test_builtin_world_has_no_warnings(name: str) -> None:
    world = load_world_file(name, WorldFileSettings(strict=True))

    assert world.model.ground_plane


@pytest.mark.parametrize("name", ["walls", "warehouse"])
def test_builtin_world_has_a_free_area_for_fleets(name: str) -> None:
    shapes = [
        (placed.origin.position, shape)
        for placed in load_world_file(name).model.models
        for shape in placed.model.links[0].collisions
    ]

    assert shapes
    assert [shape for at, shape in shapes if _overlaps_free_area(at, shape)] == []


def _overlaps_free_area(
    at: tuple[float, float, float], shape: Shape, area: tuple[float, float] = (FREE_M, FREE_M)
) -> bool:
    # Cylinders and spheres have their radius first; their bounds are wider than they are.
    size = shape.size if shape.kind == "box" else (2.0 * max(shape.size),) * 3
    spans = [
        (a + o - side / 2.0, a + o + side / 2.0)
        for a, o, side in zip(at, shape.origin.position, size, strict=True)
    ]
    return all(
        low < far + 0.5 and high > -0.5 for (low, high), far in zip(spans, area, strict=False)
    )


@pytest.mark.parametrize("name", list_builtin_worlds())
def test_row_of_ten_robots_is_free_in_each_builtin_world(name: str) -> None:
    solids = [
        (placed.origin.position, shape)
        for placed in load_world_file(name).model.models
        for shape in placed.model.links[0].collisions
    ]

    assert [shape for at, shape in solids if _overlaps_free_area(at, shape, (9.0, 0.0))] == []


@pytest.mark.parametrize("name", ["maze", "office", "warehouse"])
def test_named_poses_of_a_builtin_world_are_free(name: str) -> None:
    world = load_world_file(name).model
    solids = [shape for placed in world.models for shape in placed.model.links[0].collisions]

    assert world.named_poses
    for bounded in world.named_poses:
        at, reach = bounded.pose.pose.position, bounded.bounds.points[0]
        assert [
            shape
            for shape in solids
            if abs(shape.origin.position[0] - at.x) < shape.size[0] / 2.0 + reach.x
            and abs(shape.origin.position[1] - at.y) < shape.size[1] / 2.0 + reach.y
        ] == [], bounded.pose.name


@pytest.mark.parametrize("name", ["maze", "office", "warehouse"])
def test_builtin_world_has_several_colours_to_see(name: str) -> None:
    world = load_world_file(name).model

    colours = {s.rgba for p in world.models for link in p.model.links for s in link.visuals}
    assert len(colours) >= 8
    assert None not in colours


def test_cells_of_the_maze_are_connected() -> None:
    world = load_world_file("maze").model
    boxes = [shape for placed in world.models for shape in placed.model.links[0].collisions]
    reached, pending = set[tuple[int, int]](), [(0, 0)]
    while pending:
        cell = pending.pop()
        if cell in reached:
            continue
        reached.add(cell)
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            if not any(_is_between(box, cell, dx, dy) for box in boxes):
                pending.append((cell[0] + dx, cell[1] + dy))

    assert reached == {(x, y) for x in range(8) for y in range(8)}


def _is_between(box: Shape, cell: tuple[int, int], dx: int, dy: int) -> bool:
    """Whether a wall is between the middle of a cell of 1.5 m and its neighbour."""
    middle = (1.5 * (cell[0] + dx / 2.0) - 0.75, 1.5 * (cell[1] + dy / 2.0))
    return all(
        abs(at - centre) <= side / 2.0 + 1e-6
        for at, centre, side in zip(middle, box.origin.position, box.size, strict=False)
    )


def test_world_file_includes_models_beside_it_and_from_the_path(tmp_path: Path) -> None:
    for folder, name in ((tmp_path / "beside", "near"), (tmp_path / "path", "far")):
        (folder / name).mkdir(parents=True)
        text = f"<sdf version='1.6'>{CRATE.replace('crate', name)}</sdf>"
        (folder / name / "model.sdf").write_text(text)
    includes = "".join(f"<include><uri>model://{name}</uri></include>" for name in ("near", "far"))

    world = load_world_file(
        a_file(tmp_path / "beside", includes),
        WorldFileSettings(model_paths=(str(tmp_path / "path"),)),
    )

    assert [placed.name for placed in world.model.models] == ["near", "far"]


def test_strict_server_refuses_a_world_with_warnings(tmp_path: Path) -> None:
    file = a_file(tmp_path, "<actor name='a'/>")

    assert load_world_file(file).model.models == ()
    with pytest.raises(ConfigError, match="`strict`"):
        load_world_file(file, WorldFileSettings(strict=True))


@pytest.mark.parametrize("name", ["", "nowhere", "/etc/nothing.world"])
def test_world_that_does_not_exist_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match="empty, maze, office, walls, warehouse"):
        load_world_file(name)


def test_world_that_is_not_valid_is_refused_with_its_slug(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"sdf\.include: "):
        load_world_file(a_file(tmp_path, "<include><uri>model://nothing</uri></include>"))


def test_models_of_a_world_are_spawned(tmp_path: Path) -> None:
    world = a_world()

    spawn_models(world, load_world_file(a_file(tmp_path, CRATE)).model)

    (entity,) = world.entities
    assert (entity.name, entity.namespace, entity.belongs_to_world) == ("crate", "", True)


def test_models_that_overlap_are_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world = a_world()
    model = load_world_file(a_file(tmp_path, CRATE + CRATE.replace("crate", "chair"))).model

    spawn_models(world, model)

    warned = [event for event in world.clock.take_events() if event.kind == "warning"]
    assert [event.entity for event in warned] == ["crate"]
    assert "'chair'" in warned[0].message
    assert ["'chair'" in record.getMessage() for record in caplog.records] == [True]


def test_model_that_the_engine_refuses_is_named(tmp_path: Path) -> None:
    world = a_world()
    model = load_world_file(a_file(tmp_path, CRATE)).model
    spawn_models(world, model)

    with pytest.raises(ConfigError, match="crate"):
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
def test_meshes_are_found_beside_the_world_file_and_in_the_path(
    tmp_path: Path, ending: str
) -> None:
    (tmp_path / "path" / "rings" / "meshes").mkdir(parents=True)
    (tmp_path / "path" / "rings" / "meshes" / f"ring.{ending}").write_bytes(a_torus(ending))
    (tmp_path / f"ring.{ending}").write_bytes(a_torus(ending))
    content = a_mesh_model("near", f"ring.{ending}", is_static=True)
    content += a_mesh_model("far", f"model://rings/meshes/ring.{ending}")

    world = load_world_file(
        a_file(tmp_path, content), WorldFileSettings(model_paths=(str(tmp_path / "path"),))
    )

    near, far = (placed.model.links[0] for placed in world.model.models)
    assert list_warnings(world.model.report) == []
    assert near.collisions[0].size == (2.0, 2.0, 2.0)
    assert near.visuals[0].mesh == far.visuals[0].mesh
    sizes = [len(world.meshes[link.collisions[0].mesh]) for link in (near, far)]
    assert sizes[0] > 5 * sizes[1]  # the mesh itself, and its hull


def test_mesh_of_an_included_model_is_found_beside_that_model(tmp_path: Path) -> None:
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


def test_missing_and_invalid_meshes_are_reported(tmp_path: Path) -> None:
    (tmp_path / "bad.stl").write_bytes(b"no mesh")
    content = a_mesh_model("bad", "bad.stl") + a_mesh_model("gone", "file:///etc/gone.stl")

    with pytest.raises(ConfigError, match=r"mesh\.missing"):
        load_world_file(a_file(tmp_path, content))
    world = load_world_file(a_file(tmp_path, content), WorldFileSettings(allow_missing=True)).model

    assert [placed.name for placed in world.models] == ["gone"]
    assert world.models[0].model.links[0].collisions == ()
    excluded, *missing = sorted(list_warnings(world.report), reverse=True)
    assert "mesh.length" in excluded
    assert [warning.partition(", ")[0] for warning in missing] == ["gone: link 'l'"] * 2


def test_submesh_is_reported_as_unsupported(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(a_torus("stl"))
    part = "</uri><submesh><name>half</name></submesh>"
    file = a_file(tmp_path, a_mesh_model("m", "a.stl").replace("</uri>", part, 1))

    (warning,) = list_warnings(load_world_file(file).model.report)

    assert "<submesh>" in warning


def test_world_loaded_in_a_child_process_is_the_same(tmp_path: Path) -> None:
    file = a_file(tmp_path, "<include><uri>model://near</uri></include>")
    (tmp_path / "path" / "near").mkdir(parents=True)
    near = f"<sdf version='1.6'>{CRATE.replace('crate', 'near')}</sdf>"
    (tmp_path / "path" / "near" / "model.sdf").write_text(near)
    paths = WorldFileSettings(model_paths=(str(tmp_path / "path"),))

    assert load_world_in_process(WorldLoaderRequest(file, paths)) == load_world_file(file, paths)
    assert load_world_in_process(WorldLoaderRequest("walls")) == load_world_file("walls")


def test_world_is_refused_in_a_child_process_for_the_same_reason(tmp_path: Path) -> None:
    file = a_file(tmp_path, "<actor name='a'/>")

    with pytest.raises(ConfigError, match="`strict`"):
        load_world_in_process(WorldLoaderRequest(file, WorldFileSettings(strict=True)))


def test_world_that_crashes_the_child_process_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world_loader, "COMMAND", (sys.executable, "-c", "raise SystemExit(9)"))

    with pytest.raises(ConfigError, match="9"):
        load_world_in_process(WorldLoaderRequest("crashing.world"))
