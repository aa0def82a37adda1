"""Carriers of skid-steered wheels: which robots get them, and how these turn."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_box_bot, a_cart, a_state
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.model_geometry import find_ground_clearance
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.blueprint import make_blueprint, order_depth_first
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.bullet.wheel_carriers import add_wheel_carriers, list_carriers
from zensim.sim_server.physics.engine_config import EngineConfig

WHEEL_SPEEDS = np.array([-2.0, 2.0, -2.0, 2.0])


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    made = PyBulletEngine(EngineConfig(STEP_NS))
    yield made
    made.close()


def a_skid_bot() -> Model:
    return read_urdf(read_builtin_model("skid_bot"))


def turn_of(engine: PyBulletEngine, heading: float) -> float:
    model = a_skid_bot()
    place = (0.0, 0.0, -find_ground_clearance(model))
    body = engine.add(model, a_state(place, turn=(0.0, 0.0, heading)))
    engine.command([body], WHEEL_SPEEDS)
    advance(engine, 60)
    turn = float(engine.read([body]).base[0, 12])
    engine.remove(body)
    return turn


def test_each_wheel_of_a_skid_steered_robot_has_a_carrier() -> None:
    model = a_skid_bot()
    found = add_wheel_carriers(order_depth_first(make_blueprint(model)))

    assert len(list_carriers(found)) == 4
    assert sum(part.mass_kg for part in found.parts) == pytest.approx(model.mass_kg, rel=1e-2)
    names = [found.parts[part].joint for part in found.link_parts[1:]]
    assert [joint.name for joint in names if joint] == [joint.name for joint in model.joints]


@pytest.mark.parametrize("model", [a_cart(), a_box_bot()], ids=lambda model: model.name)
def test_robot_with_two_driven_wheels_has_none(model: Model) -> None:
    blueprint = order_depth_first(make_blueprint(model))

    assert add_wheel_carriers(blueprint) is blueprint


def test_robot_whose_links_collide_with_each_other_has_none() -> None:
    model = a_skid_bot()
    base = msgspec.structs.replace(model.links[0], self_collides=True)
    blueprint = order_depth_first(
        make_blueprint(msgspec.structs.replace(model, links=(base, *model.links[1:])))
    )

    assert add_wheel_carriers(blueprint) is blueprint


def test_skid_steered_robot_turns_alike_at_any_heading(engine: PyBulletEngine) -> None:
    turns = [turn_of(engine, heading) for heading in (0.0, 0.4, 0.8, 1.2)]

    assert turns == pytest.approx([turns[0]] * 4, rel=0.05)
    assert abs(turns[0]) > 0.1


def test_carriers_stay_in_place_and_are_reset(engine: PyBulletEngine) -> None:
    model = a_skid_bot()
    start = a_state((0.0, 0.0, -find_ground_clearance(model)))
    body = engine.add(model, start)
    paths = []
    for _ in range(2):
        engine.set_at_rest(body, start)
        engine.command([body], WHEEL_SPEEDS)
        advance(engine, 240)
        paths.append(engine.read([body]).base[0])

    assert len(engine.read([body]).joint_positions) == len(model.joints)
    assert paths[0][:2] == pytest.approx(paths[1][:2], abs=2e-3)
    assert paths[0][12] == pytest.approx(paths[1][12], rel=0.02)
