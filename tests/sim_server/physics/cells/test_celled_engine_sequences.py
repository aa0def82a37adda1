"""Random sequences of calls on a celled engine: no error, and repeatable results."""

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
CALLS = 80


class RandomCalls:
    """Bodies under random calls."""

    def __init__(self, engine: Engine, seed: int) -> None:
        self.engine = engine
        self.draws = np.random.default_rng(seed)
        self.models: dict[int, Model] = {}

    def add(self) -> None:
        model = MODELS[self.draws.integers(len(MODELS))]
        self.models[self.engine.add(model, self._draw_state())] = model

    def remove(self) -> None:
        self.engine.remove(body := self._draw_body())
        del self.models[body]

    def set_base_state(self) -> None:
        self.engine.set_base_state(self._draw_body(), self._draw_state())

    def set_at_rest(self) -> None:
        body = self._draw_body()
        self.engine.set_at_rest(
            body, self._draw_state(), self._draw_numbers(len(self.models[body].joints))
        )

    def set_state(self) -> None:
        count = len(self.models[body := self._draw_body()].joints)
        self.engine.set_state(
            body, self._draw_state(), self._draw_numbers(count), self._draw_numbers(count)
        )

    def apply_wrench(self) -> None:
        self.engine.apply_link_wrench(self._draw_body(), 0, 400.0 * self._draw_numbers(6))

    def find_overlaps(self) -> None:
        body = self._draw_body()
        others = set(self.engine.find_overlaps(body))
        assert others <= self.models.keys() - {body}

    def remove_all(self) -> None:
        while self.models:
            self.remove()
        self.engine.forget_removed()

    def drive_and_read(self) -> FloatArray:
        bodies = tuple(self.draws.permutation(list(self.models)).tolist())
        count = sum(self.models[body].target_count for body in bodies)
        self.engine.command(bodies, self.draws.uniform(-5.0, 5.0, count))
        advance(self.engine, int(self.draws.integers(6)))
        reading = self.engine.read(bodies)
        assert len(reading.joint_positions) == sum(len(self.models[b].joints) for b in bodies)
        for body, row in zip(bodies, reading.base, strict=True):
            assert np.array_equal(self.engine.read([body]).base[0], row)
        return reading.base

    def _draw_body(self) -> int:
        if not self.models:
            self.add()
        return int(self.draws.choice(list(self.models)))

    def _draw_state(self) -> FloatArray:
        x, y, yaw = self.draws.uniform(-2.5, 2.5, 3)
        base = on_ground(x, y, yaw)
        base[2] = self.draws.choice([0.05, 0.1, 1.0])
        base[7:10] = self.draws.uniform(-3.0, 3.0, 3) * (self.draws.random() < 0.3)
        return base

    def _draw_numbers(self, count: int) -> FloatArray:
        return self.draws.uniform(-0.1, 0.1, count)


def run_random_calls(seed: int) -> bytes:
    config = EngineConfig(STEP_NS)
    cells = InProcessCellExecutor(partial(PyBulletEngine, config, awake=1))
    engine = CelledEngine(
        config,
        cells,
        CellSettings(single_cell_bodies=2, cell_bodies=seed + 1, period_steps=3, moved_bodies=2),
    )
    calls = RandomCalls(engine, seed)
    often = (calls.add, calls.add, calls.add, calls.remove, calls.set_base_state, calls.set_at_rest)
    actions = (
        *often,
        *often,
        calls.set_state,
        calls.apply_wrench,
        calls.find_overlaps,
        calls.remove_all,
    )
    try:
        found = []
        for _ in range(CALLS):
            actions[calls.draws.integers(len(actions))]()
            found.append(calls.drive_and_read().tobytes())
    finally:
        engine.close()
    return b"".join(found)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_random_calls_succeed_and_give_the_same_bits_again(seed: int) -> None:
    assert run_random_calls(seed) == run_random_calls(seed)
