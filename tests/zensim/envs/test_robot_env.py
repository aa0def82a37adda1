"""ZensimEnv: one robot that learns."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import zensim
from zensim.envs import ZensimEnv


@pytest.mark.filterwarnings("ignore:.*render modes")
@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("reach", {}),
        ("formation", {"count": 2}),
        ("reach", {"model": "box_bot_lidar", "sensors": ("scan", "imu")}),
    ],
)
def test_env_passes_the_checker_of_gymnasium(task: str, options: dict[str, object]) -> None:
    env = ZensimEnv(task, **options)  # type: ignore[arg-type]

    check_env(env)

    env.close()


def test_robot_that_drives_to_its_goal_succeeds() -> None:
    env = ZensimEnv("reach")
    observation, _ = env.reset(seed=1)
    rewards = []
    for _ in range(300):
        x, y = observation[:2]
        turn = np.clip(2.0 * np.arctan2(y, x), -1.0, 1.0)
        action = np.array([1.0 if abs(turn) < 0.9 else 0.0, turn], np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
        if terminated or truncated:
            break

    assert terminated
    assert info == {"success": True}
    assert rewards[-1] > 0.9
    assert sum(rewards) > 1.0


def test_robot_that_stands_is_truncated_and_loses_a_little() -> None:
    env = ZensimEnv("reach", time_limit_s=2.0)
    env.reset(seed=1)

    found = [env.step(np.zeros(2, np.float32)) for _ in range(20)]

    assert [one[3] for one in found] == [False] * 19 + [True]
    assert sum(one[1] for one in found) == pytest.approx(-0.2, abs=0.01)


@pytest.mark.parametrize(("step_hz", "limit_s"), [(700.0, 10.0), (240.0, 0.3)])
def test_time_limit_is_kept_whatever_the_length_of_a_step(step_hz: float, limit_s: float) -> None:
    with zensim.World(step_hz=step_hz, control_hz=100.0) as world:
        world.spawn("box_bot")
        env = ZensimEnv("reach", world=world, rate_hz=10.0, time_limit_s=limit_s)
    env.reset(seed=1)
    steps = round(limit_s * 10.0)

    found = [env.step(np.zeros(2, np.float32))[3] for _ in range(steps)]

    assert found == [False] * (steps - 1) + [True]


def test_step_before_reset_and_actions_that_are_not_finite_are_refused() -> None:
    env = ZensimEnv("reach")
    with pytest.raises(zensim.Invalid) as refused:
        env.step(np.zeros(2, np.float32))
    assert refused.value.slug == "not_reset"
    env.reset(seed=1)

    for number in (np.nan, np.inf):
        with pytest.raises(zensim.Invalid) as refused:
            env.step(np.array([number, 0.0], np.float32))
        assert refused.value.slug == "not_finite"
        assert env.batch.names[0] in str(refused.value)


def test_closed_environment_is_not_reset() -> None:
    env = ZensimEnv("reach")
    env.reset(seed=1)
    env.close()

    for call in (lambda: env.reset(seed=1), lambda: env.step(np.zeros(2, np.float32))):
        with pytest.raises(zensim.Closed) as refused:
            call()
        assert "environment" in str(refused.value)


def test_several_robots_that_learn_are_refused() -> None:
    with pytest.raises(zensim.Invalid):
        ZensimEnv("avoid", count=3)


def test_wrappers_of_gymnasium_work() -> None:
    env = gymnasium.wrappers.RescaleAction(
        ZensimEnv("reach"), np.full(2, -2.0, np.float32), np.full(2, 2.0, np.float32)
    )
    env.reset(seed=1)

    observation = env.step(np.array([2.0, 0.0], np.float32))[0]

    assert env.observation_space.contains(observation)
