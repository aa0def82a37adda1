"""ZensimParallelEnv: robots of one world as agents."""

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test

import zensim
from zensim.envs import parallel_env


@pytest.mark.parametrize("task", ["reach", "avoid", "formation"])
def test_env_passes_the_test_of_pettingzoo(task: str) -> None:
    env = parallel_env(task, count=3, time_limit_s=3.0)

    parallel_api_test(env, num_cycles=100)

    env.close()


def test_script_of_the_documents_runs_to_its_end() -> None:
    env = parallel_env(model="box_bot", count=4, task="reach", time_limit_s=2.0)
    observations, infos = env.reset(seed=0)
    for seed, name in enumerate(env.possible_agents):
        env.action_space(name).seed(seed)
    steps = 0
    while env.agents:
        actions = {name: env.action_space(name).sample() for name in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(actions)
        steps += 1

    assert steps == 20
    assert set(observations) == set(rewards) == set(terminations) == set(truncations) == set(infos)


def test_colliding_robots_end_and_the_others_go_on() -> None:
    with zensim.World() as world:
        world.spawn_fleet("box_bot", poses=[(0.0, 0.0, 0.0), (0.3, 0.0, np.pi), (0.0, 2.0, 0.0)])
        env = parallel_env("avoid", world=world)
    env.reset(seed=1)
    ahead = {name: np.array([1.0, 0.0], np.float32) for name in env.possible_agents}
    ahead[env.possible_agents[2]][:] = 0.0

    for _ in range(20):
        _, rewards, terminated, _, infos = env.step(ahead)
        if any(terminated.values()):
            break

    crashed = env.possible_agents[:2]
    assert [terminated[name] for name in env.possible_agents] == [True, True, False]
    assert all(rewards[name] < -0.5 for name in crashed)
    assert not any(infos[name]["success"] for name in crashed)
    assert env.agents == env.possible_agents[2:]


def test_equal_seeds_give_equal_observations() -> None:
    env = parallel_env("reach", count=3)
    first, second, third = (env.reset(seed=seed)[0] for seed in (1, 1, 2))

    assert all((first[name] == second[name]).all() for name in first)
    assert any((first[name] != third[name]).any() for name in first)


def test_missing_action_is_refused() -> None:
    env = parallel_env("reach", count=2)
    env.reset(seed=1)

    with pytest.raises(zensim.Invalid):
        env.step({env.possible_agents[0]: np.zeros(2, np.float32)})


@pytest.mark.parametrize("action", [np.array([1.0]), np.zeros((1, 2)), np.array(0.5), "ahead"])
def test_action_of_a_wrong_shape_is_refused(action: object) -> None:
    env = parallel_env("reach", count=2)
    env.reset(seed=1)
    first, second = env.agents

    with pytest.raises(zensim.Invalid) as refused:
        env.step({first: np.zeros(2, np.float32), second: action})  # type: ignore[dict-item]

    assert second in str(refused.value)
    assert env.batch.times.tolist() == [0.0]
