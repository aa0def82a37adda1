"""Entities that fall out of the world are warned of once."""

import numpy as np
import pytest

from tests.engines import STEP_NS, running
from tests.models import a_box, a_state
from tests.sim_server.fakes import CONTROL_STEPS
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.world.fall_watch import FallWatch
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world.spawn_request import ValidatedSpawn

STEPS_PER_S = 1_000_000_000 // STEP_NS
NAMES = ("r1", "r2")


def states(*motions: tuple[float, float]) -> np.ndarray:
    """Make states of height [m] and upward speed [m/s]."""
    rows = np.zeros((len(motions), 13))
    rows[:, 2], rows[:, 9] = zip(*motions, strict=True)
    return rows


def test_fall_is_new_once() -> None:
    watch, initial = FallWatch(), np.zeros(2)

    assert watch.update(NAMES, states((-20.0, -20.0), (0.0, 0.0)), initial) == ("r1",)
    assert watch.update(NAMES, states((-30.0, -25.0), (0.0, 0.0)), initial) == ()
    assert watch.falling == {"r1"}

    assert watch.update(NAMES, states((0.0, 0.0), (0.0, 0.0)), initial) == ()
    assert watch.falling == set()
    assert watch.update(NAMES, states((-20.0, -20.0), (-20.0, -20.0)), initial) == NAMES


@pytest.mark.parametrize("motion", [(-20.0, -1.0), (-5.0, -20.0), (3.0, 9.0), (-300.0, 0.0)])
def test_drives_dives_and_drops_are_no_falls(motion: tuple[float, float]) -> None:
    assert FallWatch().update(("r1",), states(motion), np.zeros(1)) == ()


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine])
def test_robot_beyond_the_edge_of_the_floor_is_warned_of(make: type) -> None:
    config = EngineConfig(STEP_NS, gravity=(0.0, 0.0, -9.81), has_ground=False)
    with running(make, config) as engine:
        world = SimulatedWorld(engine, name="w", step_ns=STEP_NS, control_steps=CONTROL_STEPS)
        for name, x in (("floor", 0.0), ("on", 0.0), ("off", 3.0)):
            model = a_box(name, 2.0 if name == "floor" else 0.2, is_static=name == "floor")
            base = a_state((x, 0.0, 0.0 if name == "floor" else 1.1))
            world.spawn(ValidatedSpawn(name, "", model, base))
        for _ in range(3 * STEPS_PER_S):
            world.step()

        warned = [event.entity for event in world.clock.take_events() if event.kind == "warning"]

    assert warned == ["off"]
    assert world.fall_watch.falling == {"off"}
