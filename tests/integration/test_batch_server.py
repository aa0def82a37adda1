"""A batch has the bits of a server in lockstep."""

import numpy as np

import zensim
from zensim.envs.batch import Batch

CONTROL_STEPS = 334
STEPS_OF_A_CONTROL_STEP = 3
ROBOTS = 4


def test_batch_equals_a_lockstep_server_after_1000_steps() -> None:
    with zensim.World("walls") as world:
        world.spawn_fleet("box_bot", count=ROBOTS, spacing=0.5)
        batch = Batch(world, 2)
    twists = np.zeros((CONTROL_STEPS, ROBOTS, 3))
    generator = np.random.default_rng(1)
    twists[..., 0] = generator.uniform(-0.1, 0.5, twists.shape[:2])
    twists[..., 2] = generator.uniform(-2.0, 2.0, twists.shape[:2])

    for one in twists:
        batch.step(np.stack([one, one]))
    with zensim.launch("walls", engine="mujoco", timeout_s=120.0) as sim:
        fleet = sim.spawn_fleet("box_bot", count=ROBOTS, spacing=0.5)
        for one in twists:
            fleet.drive(one[:, 0], one[:, 2])
            sim.step(STEPS_OF_A_CONTROL_STEP)
        expected = sim.state_hash()

    assert CONTROL_STEPS * STEPS_OF_A_CONTROL_STEP > 1000
    assert batch.digest(0) == batch.digest(1) == expected
