"""Contract of `Engine.hide` and `Engine.show`."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_box, a_box_bot, a_state, box_bot_at
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.cells.cell_executor import InProcessCellExecutor, WorkerCellExecutor
from zensim.sim_server.physics.cells.celled_engine import CelledEngine, CellSettings
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import CellConfig
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine

CONFIG = EngineConfig(STEP_NS)


def tiered() -> TieredEngine:
    return TieredEngine(PyBulletEngine(CONFIG), CONFIG, "full")


def celled(*, most: int) -> CelledEngine:
    settings = CellSettings(single_cell_bodies=most, cell_bodies=most, period_steps=1)
    return CelledEngine(
        CONFIG, InProcessCellExecutor(lambda: PyBulletEngine(CONFIG, awake=2)), settings
    )


def remote() -> CelledEngine:
    config = CellConfig("pybullet", CONFIG)
    cells = WorkerCellExecutor(config.make, config, workers=1)
    return CelledEngine(
        CONFIG, cells, CellSettings(single_cell_bodies=1, cell_bodies=1, period_steps=1)
    )


def celled_mujoco(*, most: int) -> CelledEngine:
    settings = CellSettings(single_cell_bodies=most, cell_bodies=most, period_steps=1)
    return CelledEngine(
        CONFIG, InProcessCellExecutor(lambda: MujocoEngine(CONFIG), threads=2), settings
    )


MAKERS: dict[str, Callable[[], Engine]] = {
    "pybullet": lambda: PyBulletEngine(CONFIG),
    "tiers": tiered,
    "one cell": lambda: celled(most=8),
    "cells": lambda: celled(most=1),
    "workers": remote,
    "mujoco": lambda: MujocoEngine(CONFIG),
    "mujoco, cells": lambda: celled_mujoco(most=1),
}


@pytest.fixture(params=MAKERS.values(), ids=list(MAKERS))
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    made: Engine = request.param()
    try:
        yield made
    finally:
        made.close()


def test_hidden_body_stays_in_place_and_collides_with_nothing(engine: Engine) -> None:
    hidden = engine.add(a_box(), a_state((0.0, 0.0, 0.5)))
    engine.hide(hidden)
    falling = engine.add(a_box(), a_state((0.0, 0.0, 0.8)))

    advance(engine, 240)

    heights = engine.read([hidden, falling]).base[:, 2]
    assert heights == pytest.approx([0.5, 0.1], abs=1e-3)


def test_shown_body_moves_like_a_new_one(engine: Engine) -> None:
    first = engine.add(a_box_bot(), box_bot_at(0.0, 2.0))
    engine.hide(first)
    advance(engine, 50)

    engine.show([first])
    second = engine.add(a_box_bot(), box_bot_at())
    engine.command([first, second], np.full(4, 5.0))
    advance(engine, 240)

    one, other = engine.read([first, second]).base[:, :3]
    assert one[0] > 0.1
    assert one - other == pytest.approx(np.array([0.0, 2.0, 0.0]), abs=1e-3)


def test_hidden_body_can_be_read(engine: Engine) -> None:
    there = engine.add(a_box(), a_state((3.0, 0.0, 0.1)))
    hidden = engine.add(a_box_bot(), box_bot_at(1.0, 2.0))
    engine.hide(hidden)

    reading = engine.read((hidden, there))

    assert reading.base[:, :2] == pytest.approx(np.array([[1.0, 2.0], [3.0, 0.0]]), abs=1e-6)
    assert reading.joint_positions.shape == (2,)


def test_hidden_body_can_be_removed(engine: Engine) -> None:
    hidden = engine.add(a_box_bot(), box_bot_at())
    engine.hide(hidden)
    engine.remove(hidden)

    body = engine.add(a_box_bot(), box_bot_at(1.0))
    engine.command([body], np.full(2, 5.0))
    advance(engine, 240)

    assert engine.read([body]).base[0, 0] > 1.1


@pytest.mark.parametrize("how", ["mujoco", "mujoco, cells"])
def test_shown_body_has_exactly_the_state_set_while_hidden(how: str) -> None:
    engine = MAKERS[how]()
    there, hidden = (engine.add(a_box_bot(), box_bot_at(0.0, y)) for y in (0.0, 3.0))
    engine.hide(hidden)
    engine.set_base_state(hidden, box_bot_at(1.0, 2.0))
    advance(engine, 5)
    for place in range(3, 20):
        engine.hide(engine.add(a_box_bot(), box_bot_at(0.0, float(place))))

    engine.show([hidden])

    assert engine.read([hidden]).base[0].tolist() == box_bot_at(1.0, 2.0).tolist()
    assert engine.read([there]).base[0, 0] == pytest.approx(0.0, abs=1e-3)
    engine.close()


def test_hidden_body_of_mujoco_is_found_by_overlaps() -> None:
    engine = MujocoEngine(CONFIG)
    hidden = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
    engine.hide(hidden)

    other = engine.add(a_box(), a_state((0.05, 0.0, 0.1)))

    assert engine.find_overlaps(other) == [hidden]
    engine.close()
