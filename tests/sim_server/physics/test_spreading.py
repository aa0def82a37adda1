"""Static meshes in parts of their own, and shapes made before they are needed."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.engines import STEP_NS
from tests.models import a_box, a_state
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.sim_server.physics.blueprint import blueprint_of
from zensim.sim_server.physics.engine import EngineConfig
from zensim.sim_server.physics.pybullet_engine import MAX_PARTS, PyBulletEngine
from zensim.sim_server.physics.spreading import spread

MESHES = 20


def a_scene(count: int = MESHES, *, boxes: int = 0, is_static: bool = True) -> Model:
    """Make a model of meshes, each a metre beside the one before it, and of boxes."""
    shapes = [
        Shape("mesh", (1.0, 1.0, 1.0), mesh=f"m{i}", friction=0.5 + i % 2) for i in range(count)
    ]
    shapes += [Shape("box", (1.0, 1.0, 1.0), friction=0.5)] * boxes
    return Model("scene", (Link("base", collisions=tuple(shapes)),), is_static=is_static)


@pytest.mark.parametrize("count", [1, 20, 126, 127, 500])
def test_static_meshes_are_spread_over_the_parts_that_an_engine_has(count: int) -> None:
    planned = blueprint_of(a_scene(count, boxes=3))

    found = spread(planned, max_parts=MAX_PARTS)

    assert len(found.parts) <= MAX_PARTS
    sizes = [sum(bool(shape.mesh) for shape in part.shapes) for part in found.parts]
    assert max(sizes) <= -(-count // 50)
    assert sum(sizes) == count
    assert sum(len(part.shapes) for part in found.parts) == count + 3
    for part in found.parts:
        assert {shape.friction for shape in part.shapes} <= {part.friction}


def test_moving_meshes_stay_where_they_are() -> None:
    planned = blueprint_of(a_scene(is_static=False))

    assert spread(planned, max_parts=MAX_PARTS) == planned


def test_shapes_are_prepared_one_part_at_a_time(tmp_path: Path) -> None:
    for number in range(MESHES):
        wall = trimesh.creation.box((0.1, 1.0, 1.0 + 0.01 * number))
        wall.apply_translation((number, 0.0, 0.5))
        tmp_path.joinpath(f"m{number}.stl").write_bytes(wall.export(file_type="stl"))
    engine = PyBulletEngine(EngineConfig(STEP_NS, mesh_folder=str(tmp_path)))

    turns = [engine.prepare(a_scene()) for _ in range(MESHES + 1)]
    engine.add(a_scene(), a_state((0.0, 0.0, 0.0)))
    on_top = [engine.add(a_box(), a_state((float(x), 0.0, 3.0))) for x in range(MESHES)]
    for _ in range(480):
        engine.step()

    heights = engine.read(on_top).base[:, 2]
    assert turns == [*[False] * MESHES, True]
    assert np.all(heights > 1.0)
    engine.close()


@pytest.mark.parametrize("shape", [Shape("mesh", mesh="a"), Shape("plane")], ids=lambda s: s.kind)
def test_preparing_leaves_it_to_adding_to_say_what_is_wrong(tmp_path: Path, shape: Shape) -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS, mesh_folder=str(tmp_path)))

    assert engine.prepare(Model("m", (Link("base", collisions=(shape,)),), is_static=True))
    engine.close()
