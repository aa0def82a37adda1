"""What Bullet does with bodies in the step in which they came back out of their sleep."""

import numpy as np
import pytest

from sim_server.physics.pybullet_engine import PyBulletEngine
from tests.engines import advance, running
from tests.models import a_cart, a_state, on_ground


def test_pybullet_rests_a_robot_as_told_last_in_the_step_it_was_brought_back() -> None:
    with running(PyBulletEngine) as engine:
        engine.remove(engine.add(a_cart(), on_ground()))
        advance(engine, 10)
        body = engine.add(a_cart(), on_ground())
        flying = a_state((0.0, 0.0, 50.0), angular=(0.0, 0.0, 1.0))

        engine.put(body, on_ground(3.0), np.zeros(2), np.full(2, 4.0))
        engine.rest(body, flying)
        advance(engine, 3)

        reading = engine.read([body])
        assert reading.base[0, 12] == pytest.approx(1.0, abs=0.01)
        assert reading.joint_velocities == pytest.approx([0.0, 0.0], abs=0.01)
