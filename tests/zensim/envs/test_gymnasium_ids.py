"""Tasks by the ids of Gymnasium."""

import gymnasium
import numpy as np
import pytest

pytest.importorskip("mujoco")


def test_task_of_one_robot_is_made_by_its_id() -> None:
    with gymnasium.make("zensim.envs:zensim/Reach-v0", rate_hz=10.0) as env:
        observation, _ = env.reset(seed=1)
        following, reward, *_ = env.step(np.zeros(2, np.float32))

    assert observation.shape == following.shape == env.observation_space.shape
    assert np.isfinite(float(reward))


@pytest.mark.parametrize("name", ["Reach", "Avoid", "Formation", "Pursue", "Cover"])
def test_worlds_of_a_task_are_made_by_its_id(name: str) -> None:
    envs = gymnasium.make_vec(f"zensim.envs:zensim/{name}-v0", num_envs=2)
    try:
        observations, _ = envs.reset(seed=1)
    finally:
        envs.close()

    assert observations.shape == envs.observation_space.shape
    assert len(observations) == 2
