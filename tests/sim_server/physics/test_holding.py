"""Which wheels resist rolling while they stand."""

from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_box, a_box_bot, box_bot_at
from tests.sim_server.physics.bullet import dynamics_of
from zensim.sim_server.physics.blueprint import blueprint_of
from zensim.sim_server.physics.engine import EngineConfig
from zensim.sim_server.physics.holding import RESISTANCE, holds_of
from zensim.sim_server.physics.pybullet_engine import PyBulletEngine


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    found = PyBulletEngine(EngineConfig(STEP_NS))
    yield found
    found.close()


def test_wheels_with_motors_resist_by_their_radius() -> None:
    model = a_box_bot()

    holds = dict(holds_of(model, blueprint_of(model)))

    assert holds == {0: pytest.approx(RESISTANCE * 0.035), 1: pytest.approx(RESISTANCE * 0.035)}


def test_what_has_no_motors_rolls_freely() -> None:
    assert holds_of(a_box(), blueprint_of(a_box())) == ()


def test_wheels_resist_rolling_while_they_are_told_to_stand(engine: PyBulletEngine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())
    born = [part.rolling_friction for part in dynamics_of(engine, body)]

    engine.command([body], np.array([5.0, 5.0]))
    driven = [part.rolling_friction for part in dynamics_of(engine, body)]
    engine.command([body], np.zeros(2))
    stopped = [part.rolling_friction for part in dynamics_of(engine, body)]

    assert born == stopped == [0.0, *[pytest.approx(3.5e-4)] * 2, 0.0]
    assert driven == [0.0] * 4


def test_box_bot_that_has_stopped_does_not_rock(engine: PyBulletEngine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())
    engine.command([body], np.array([10.0, 10.0]))
    advance(engine, 240)

    engine.command([body], np.zeros(2))
    advance(engine, 240)
    turns = []
    for _ in range(120):
        engine.step()
        turns.append(np.abs(engine.read([body]).base[0, 10:13]).max())

    assert max(turns) < 2e-3
