"""Each engine repeats a run exactly, whatever was simulated before."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, MakeEngine, advance
from tests.models import a_box_bot, box_bot_at
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig

ROBOTS, STEPS, PERIOD = 6, 480, 24
SPACING_M = 0.11
"""Close enough to touch."""


def drive(make: MakeEngine, before: Callable[[Engine], object]) -> bytes:
    """Drive touching robots after some history; return their state as bytes."""
    engine = make(EngineConfig(STEP_NS))
    before(engine)
    model, draws = a_box_bot(), np.random.default_rng(1)
    places = [divmod(i, 3) for i in range(ROBOTS)]
    bodies = [engine.add(model, box_bot_at(SPACING_M * x, SPACING_M * y)) for x, y in places]
    for _ in range(STEPS // PERIOD):
        engine.command(bodies, draws.uniform(-8.0, 8.0, model.target_count * ROBOTS))
        advance(engine, PERIOD)
    reading = engine.read(bodies)
    engine.close()
    return reading.base.tobytes() + reading.joint_positions.tobytes()


def add_and_remove_another(engine: Engine) -> None:
    body = engine.add(a_box_bot(), box_bot_at())
    advance(engine, 50)
    engine.remove(body)
    engine.forget_removed()


HISTORIES: dict[str, Callable[[Engine], object]] = {
    "none": lambda _: None,
    "time": lambda engine: advance(engine, 50),
    "another": add_and_remove_another,
}


@pytest.mark.parametrize("make", PHYSICAL, ids=lambda make: make.name)
@pytest.mark.parametrize("history", HISTORIES.values(), ids=HISTORIES)
def test_engine_repeats_a_run_exactly_after_any_history(
    make: MakeEngine, history: Callable[[Engine], object]
) -> None:
    assert drive(make, history) == drive(make, HISTORIES["none"])
