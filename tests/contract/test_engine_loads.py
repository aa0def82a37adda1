"""Contract of `apply_link_wrench` and `apply_joint_effort`."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import ENGINES, STEP_NS, advance, running
from tests.models import a_box, a_state, an_arm
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig

FLOATING = EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False)
DT_S = STEP_NS * 1e-9
UP = (0.0, 0.0, 3.0)


@pytest.fixture(params=ENGINES, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param, FLOATING) as made:
        yield made


def wrench(*numbers: float) -> FloatArray:
    return np.array(numbers)


def velocity(engine: Engine, body: int) -> FloatArray:
    return np.asarray(engine.read([body]).base[0, 7:])


def test_engine_link_is_accelerated_by_force_and_mass(engine: Engine) -> None:
    model = a_box()
    body = engine.add(model, a_state(UP, turn=(0.0, 0.0, 1.0)))

    for _ in range(24):
        engine.apply_link_wrench(body, 0, wrench(2.0, -1.0, 0.5, 0.0, 0.0, 0.0))
        engine.step()

    gained = 24 * DT_S / model.mass_kg
    assert velocity(engine, body)[:3] == pytest.approx([2 * gained, -gained, gained / 2], rel=1e-6)
    assert velocity(engine, body)[3:] == pytest.approx([0, 0, 0], abs=1e-9)


def test_engine_link_is_accelerated_by_torque_and_inertia(engine: Engine) -> None:
    model = a_box()
    body = engine.add(model, a_state(UP))

    for _ in range(24):
        engine.apply_link_wrench(body, 0, wrench(0.0, 0.0, 0.0, 0.0, 0.0, 0.01))
        engine.step()

    gained = 24 * DT_S * 0.01 / model.links[0].inertial.inertia[5]
    assert velocity(engine, body)[5] == pytest.approx(gained, rel=1e-3)


def test_engine_load_lasts_one_step(engine: Engine) -> None:
    body = engine.add(a_box(), a_state(UP))
    engine.apply_link_wrench(body, 0, wrench(2.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    engine.step()
    before = velocity(engine, body)

    advance(engine, 10)

    assert velocity(engine, body) == pytest.approx(before, abs=1e-9)


def test_engine_loads_of_one_step_add_up(engine: Engine) -> None:
    once, twice = (engine.add(a_box(), a_state((x, 0.0, 3.0))) for x in (0.0, 5.0))

    for body in (once, twice, twice):
        engine.apply_link_wrench(body, 0, wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    engine.step()

    assert velocity(engine, twice) == pytest.approx(2.0 * velocity(engine, once), abs=1e-9)


def test_engine_load_does_not_move_a_static_body(engine: Engine) -> None:
    start = a_state(UP)
    body = engine.add(a_box(is_static=True), start)

    engine.apply_link_wrench(body, 0, wrench(9.0, 9.0, 9.0, 9.0, 9.0, 9.0))
    engine.step()

    assert engine.read([body]).base[0] == pytest.approx(start, abs=1e-9)


def test_engine_joint_is_accelerated_along_its_axis(engine: Engine) -> None:
    body = engine.add(an_arm("continuous"), a_state(UP))

    engine.apply_joint_effort(body, 0, 0.01)
    engine.step()
    forward = engine.read([body]).joint_velocities[0]
    for _ in range(2):
        engine.apply_joint_effort(body, 0, -0.01)
        engine.step()
    backward = engine.read([body]).joint_velocities[0]

    assert forward > 0.0 > backward
