"""What Bullet does with bodies in the step in which they came back out of their sleep."""

from functools import partial

import numpy as np
import pytest

from tests.engines import STEP_NS, advance, running
from tests.models import a_cart, a_state, on_ground
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine


def test_pybullet_rests_a_robot_as_told_last_in_the_step_it_was_brought_back() -> None:
    with running(PyBulletEngine) as engine:
        engine.remove(engine.add(a_cart(), on_ground()))
        advance(engine, 10)
        body = engine.add(a_cart(), on_ground())
        flying = a_state((0.0, 0.0, 50.0), angular=(0.0, 0.0, 1.0))

        engine.set_state(body, on_ground(3.0), np.zeros(2), np.full(2, 4.0))
        engine.set_at_rest(body, flying)
        advance(engine, 3)

        reading = engine.read([body])
        assert reading.base[0, 12] == pytest.approx(1.0, abs=0.01)
        assert reading.joint_velocities == pytest.approx([0.0, 0.0], abs=0.01)


def test_pybullet_brings_a_robot_back_moving_that_did_not_sleep() -> None:
    with running(partial(PyBulletEngine, awake=1)) as engine:
        first = [engine.add(a_cart(), on_ground(5.0 * x)) for x in range(3)]
        for body in first:
            engine.remove(body)
        advance(engine, 2)
        moving = on_ground()
        moving[7] = 0.5

        for x in range(3):  # each is awake, or rose when the one before was taken
            moving[0] = 5.0 * x
            body = engine.add(a_cart(), moving)
            engine.set_state(body, moving, np.zeros(2), np.full(2, 10.0))
            engine.command([body], np.full(2, 10.0))
            engine.step()

            assert body in first
            found = engine.read([body]).base[0]
            assert found[0] == pytest.approx(5.0 * x + 0.5 * STEP_NS * 1e-9, abs=2e-4)
            assert found[7] == pytest.approx(0.5, rel=0.02)
