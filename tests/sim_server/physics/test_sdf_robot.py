"""SDF models in each engine."""

import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, MakeEngine, advance
from tests.models import a_state
from tests.sim_server.description.sdf_robots import PIONEER
from zensim.proto.messages.model_messages import Inertial, Link, Model, Shape
from zensim.sim_server.description.builtin_models import read_builtin_world
from zensim.sim_server.description.model_geometry import find_ground_clearance
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.description.sdf.sdf_world import read_world
from zensim.sim_server.physics.engine_config import EngineConfig

RACK_TOP_M = 2.2
every_engine = pytest.mark.parametrize("make", PHYSICAL, ids=lambda make: make.name)


@every_engine
def test_sdf_robot_drives_at_the_speed_of_its_wheels(make: MakeEngine) -> None:
    model = read_sdf_model(PIONEER)
    engine = make(EngineConfig(STEP_NS))
    body = engine.add(model, a_state((0.0, 0.0, -find_ground_clearance(model))))
    advance(engine, round(5e8 / STEP_NS))
    start = engine.read([body]).base[0]
    engine.command([body], np.array([2.0, 2.0]))

    advance(engine, round(3e9 / STEP_NS))

    x, y = engine.read([body]).base[0, :2] - start[:2]
    engine.close()
    assert 0.9 * 0.66 < x < 0.67
    assert abs(y) < 0.02


@every_engine
def test_warehouse_shelves_hold_dropped_bodies(make: MakeEngine) -> None:
    engine = make(EngineConfig(STEP_NS))
    racks = next(
        p.model for p in read_world(read_builtin_world("warehouse")).models if "east" in p.name
    )
    engine.add(racks, a_state())
    ball = Shape("sphere", (0.1, 0.0, 0.0))
    inertial = Inertial(1.0, inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    dropped = Model("ball", (Link("ball", inertial, (ball,)),))
    places = [shape.origin.position for shape in racks.links[0].collisions]
    bodies = [engine.add(dropped, a_state((x, y, RACK_TOP_M + 0.12))) for x, y, _ in places]

    for _ in range(round(5e8 / STEP_NS)):
        engine.step()

    heights = engine.read(bodies).base[:, 2]
    engine.close()
    assert len(places) > 16
    np.testing.assert_allclose(heights, RACK_TOP_M + 0.1, atol=0.01)
