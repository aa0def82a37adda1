"""Worlds in cells bear whatever is done to them, and do it alike when it is done again."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_box, a_cart, a_fork, a_lopsided_box, a_puck, an_arm, on_ground
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.cells.cell_executor import InProcessCellExecutor
from zensim.sim_server.physics.cells.celled_engine import CelledEngine, CellSettings
from zensim.sim_server.physics.engine_config import EngineConfig

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import Model
    from zensim.sim_server.physics.engine import Engine, FloatArray

MODELS = (
    *(a_cart(), a_box(), a_puck(), a_fork(), a_box(is_static=True)),
    *(an_arm("prismatic"), a_lopsided_box()),
)
DOINGS = 80


class Crowd:
    """Bodies that come, go and are thrown about."""

    def __init__(self, engine: Engine, seed: int) -> None:
        self.engine = engine
        self.draws = np.random.default_rng(seed)
        self.models: dict[int, Model] = {}

    def come(self) -> None:
        model = MODELS[self.draws.integers(len(MODELS))]
        self.models[self.engine.add(model, self._somewhere())] = model

    def go(self) -> None:
        self.engine.remove(body := self._somebody())
        del self.models[body]

    def be_placed(self) -> None:
        self.engine.set_base_state(self._somebody(), self._somewhere())

    def rest(self) -> None:
        body = self._somebody()
        self.engine.set_at_rest(
            body, self._somewhere(), self._numbers(len(self.models[body].joints))
        )

    def be_put(self) -> None:
        count = len(self.models[body := self._somebody()].joints)
        self.engine.set_state(body, self._somewhere(), self._numbers(count), self._numbers(count))

    def be_pushed(self) -> None:
        self.engine.apply_link_wrench(self._somebody(), 0, 400.0 * self._numbers(6))

    def overlap(self) -> None:
        body = self._somebody()
        others = set(self.engine.find_overlaps(body))
        assert others <= self.models.keys() - {body}

    def go_all(self) -> None:
        while self.models:
            self.go()
        self.engine.forget_removed()

    def drive(self) -> FloatArray:
        bodies = tuple(self.draws.permutation(list(self.models)).tolist())
        count = sum(self.models[body].target_count for body in bodies)
        self.engine.command(bodies, self.draws.uniform(-5.0, 5.0, count))
        advance(self.engine, int(self.draws.integers(6)))
        reading = self.engine.read(bodies)
        assert len(reading.joint_positions) == sum(len(self.models[b].joints) for b in bodies)
        for body, row in zip(bodies, reading.base, strict=True):
            assert np.array_equal(self.engine.read([body]).base[0], row)
        return reading.base

    def _somebody(self) -> int:
        if not self.models:
            self.come()
        return int(self.draws.choice(list(self.models)))

    def _somewhere(self) -> FloatArray:
        x, y, yaw = self.draws.uniform(-2.5, 2.5, 3)
        base = on_ground(x, y, yaw)
        base[2] = self.draws.choice([0.05, 0.1, 1.0])
        base[7:10] = self.draws.uniform(-3.0, 3.0, 3) * (self.draws.random() < 0.3)
        return base

    def _numbers(self, count: int) -> FloatArray:
        return self.draws.uniform(-0.1, 0.1, count)


def happenings(seed: int) -> bytes:
    config = EngineConfig(STEP_NS)
    cells = InProcessCellExecutor(partial(PyBulletEngine, config, awake=1))
    engine = CelledEngine(
        config, cells, CellSettings(alone=2, most=seed + 1, period_steps=3, at_once=2)
    )
    crowd = Crowd(engine, seed)
    often = (crowd.come, crowd.come, crowd.come, crowd.go, crowd.be_placed, crowd.rest)
    doings = (*often, *often, crowd.be_put, crowd.be_pushed, crowd.overlap, crowd.go_all)
    try:
        found = []
        for _ in range(DOINGS):
            doings[crowd.draws.integers(len(doings))]()
            found.append(crowd.drive().tobytes())
    finally:
        engine.close()
    return b"".join(found)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_clusters_bear_whatever_comes_and_repeat_it(seed: int) -> None:
    assert happenings(seed) == happenings(seed)
