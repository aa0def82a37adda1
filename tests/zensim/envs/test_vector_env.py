"""ZensimVectorEnv: seeds, ends, and restarts of worlds."""

import pickle
from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any, Final

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import zensim
from zensim.envs import ReachGoal, ZensimEnv, ZensimVectorEnv, parallel_env

LIMIT_S = 1.0
SHORT: Final[dict[str, Any]] = {"time_limit_s": LIMIT_S, "rate_hz": 10.0}


@pytest.fixture(scope="module")
def env() -> Iterator[ZensimVectorEnv]:
    found = ZensimVectorEnv(3, count=2, threads=1, **SHORT)
    yield found
    found.close()


def act(env: ZensimVectorEnv, step: int) -> np.ndarray:
    """Actions that differ by world and robot."""
    sample = env.action_space.sample()
    phases = np.arange(sample.size).reshape(sample.shape)
    return np.asarray(np.sin(0.3 * step + phases), np.float32)


def test_spaces_hold_what_is_returned(env: ZensimVectorEnv) -> None:
    observations, infos = env.reset(seed=1)

    assert env.observation_space.contains(observations)
    assert observations.shape == (3, 2, 4)
    assert env.single_action_space.shape == (2, 2)
    assert infos == {}
    observations, rewards, terminated, truncated, infos = env.step(env.action_space.sample())
    assert env.observation_space.contains(observations)
    assert rewards.shape == terminated.shape == truncated.shape == (3,)
    assert infos["robot_rewards"].mean(axis=1) == pytest.approx(rewards)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


def test_equal_seeds_give_equal_episodes_and_others_do_not(env: ZensimVectorEnv) -> None:
    runs = []
    for seed in (5, 5, 6):
        first, _ = env.reset(seed=seed)
        runs.append(np.stack([first, *(env.step(act(env, step))[0] for step in range(15))]))

    assert (runs[0] == runs[1]).all()
    assert (runs[0] != runs[2]).any()
    assert (runs[0][0, 0] != runs[0][0, 1]).any()


def test_first_world_does_not_depend_on_the_number_of_worlds() -> None:
    runs = []
    for worlds, threads in ((1, 1), (16, 2)):
        env = ZensimVectorEnv(worlds, count=2, threads=threads, **SHORT)
        env.reset(seed=9)
        found = [env.step(act(env, step)[:1].repeat(worlds, axis=0)) for step in range(25)]
        runs.append([(one[0][0].tobytes(), float(one[1][0])) for one in found])
        env.close()

    assert runs[0] == runs[1]


def test_reset_without_a_seed_goes_on_with_the_random_numbers(env: ZensimVectorEnv) -> None:
    first = [env.reset(seed=3)[0], env.reset()[0]]
    second = [env.reset(seed=3)[0], env.reset()[0]]

    assert (first[0] != first[1]).any()
    assert (np.array(first) == np.array(second)).all()


def test_ended_world_restarts_in_the_next_step(env: ZensimVectorEnv) -> None:
    env.reset(seed=1)
    still = np.zeros_like(env.action_space.sample())
    ends = [env.step(still)[2:4] for _ in range(round(LIMIT_S * 10.0))]

    observations, rewards, terminated, truncated, _ = env.step(still)

    assert not np.any(ends[:-1])
    assert np.array(ends[-1]).tolist() == [[False] * 3, [True] * 3]
    assert rewards.tolist() == [0.0] * 3
    assert not terminated.any()
    assert not truncated.any()
    assert observations[..., 2:] == pytest.approx(np.zeros((3, 2, 2)), abs=1e-3)
    assert env.batch.times.tolist() == [0.0] * 3


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_vector_env_does_what_single_ones_do(mode: AutoresetMode) -> None:
    options: dict[str, Any] = {"time_limit_s": 0.8, "task": "reach"}
    own = ZensimVectorEnv(2, autoreset_mode=mode, threads=1, **options)
    reference: SyncVectorEnv = SyncVectorEnv(
        [lambda: ZensimEnv(**options)] * 2, autoreset_mode=mode
    )
    found, expected = own.reset(seed=[4, 8])[0][:, 0], reference.reset(seed=[4, 8])[0]
    assert (found == expected).all()
    for step in range(20):
        actions = act(own, step)
        mine, theirs = own.step(actions), reference.step(actions[:, 0])
        assert (mine[0][:, 0] == theirs[0]).all()
        for one, other in zip(mine[1:4], theirs[1:4], strict=True):
            assert one == pytest.approx(other)
        ended = mine[2] | mine[3]
        if mode is AutoresetMode.DISABLED and ended.any():
            for env in (own, reference):
                env.reset(options={"reset_mask": ended.copy()})
    own.close()
    reference.close()


def test_seed_of_numpy_is_that_of_python(env: ZensimVectorEnv) -> None:
    drawn = np.int64(5)
    assert (env.reset(seed=drawn)[0] == env.reset(seed=5)[0]).all()

    single = ZensimEnv("reach")

    assert (single.reset(seed=drawn)[0] == single.reset(seed=5)[0]).all()


def pass_through_pickle(env: ZensimVectorEnv) -> ZensimVectorEnv:
    found = pickle.loads(pickle.dumps(env))
    assert isinstance(found, ZensimVectorEnv)
    return found


@pytest.mark.parametrize("duplicate", [deepcopy, pass_through_pickle])
@pytest.mark.parametrize(
    "options",
    [
        {"task": "reach"},
        {"task": "avoid", "count": 4, "spacing": 0.4, "dynamics": "full", "threads": 2},
        {"task": "navigate"},
        {"model": "box_bot_lidar", "sensors": ("scan", "imu"), "dynamics": "full"},
    ],
    ids=["kinematic", "full", "navigate", "sensors"],
)
def test_copy_goes_on_with_the_bits_of_the_original(
    options: dict[str, Any], duplicate: Callable[[ZensimVectorEnv], ZensimVectorEnv]
) -> None:
    env = ZensimVectorEnv(3, time_limit_s=2.0, rate_hz=10.0, **options)
    env.reset(seed=1)
    for step in range(10):
        env.step(act(env, step))

    copied = duplicate(env)

    for step in range(20):
        found, expected = copied.step(act(env, step)), env.step(act(env, step))
        assert (found[0] == expected[0]).all()
        assert (found[1] == expected[1]).all()
    digests = [[one.batch.digest(world) for world in range(3)] for one in (copied, env)]
    assert digests[0] == digests[1]


@pytest.mark.parametrize("seed", [1.5, -1, True])
def test_seed_that_is_no_whole_number_is_refused(seed: float) -> None:
    single, robots, env = ZensimEnv(), parallel_env(count=2), ZensimVectorEnv(3)
    env.reset(seed=[1, 2, 3])
    expected, _ = env.reset()
    env.reset(seed=[1, 2, 3])
    calls: list[tuple[Callable[..., object], object]] = [
        *((one.reset, seed) for one in (single, robots, env)),
        (env.reset, [1, 2, seed]),
    ]

    for reset, given in calls:
        with pytest.raises(zensim.Invalid) as refused:
            reset(seed=given)
        assert f"seed={seed}" in str(refused.value)

    assert (env.reset()[0] == expected).all()


def test_environments_of_one_task_have_goals_of_their_own() -> None:
    task = ReachGoal()
    first, second = (ZensimVectorEnv(worlds, task=task, threads=1) for worlds in (2, 3))
    before, _ = first.reset(seed=1)
    second.reset(seed=2)

    after = first.step(np.zeros((2, 1, 2), np.float32))[0]

    assert after[..., :2] == pytest.approx(before[..., :2], abs=0.01)


def test_action_of_a_world_that_restarts_is_ignored(env: ZensimVectorEnv) -> None:
    env.reset(seed=1)
    still = np.zeros_like(env.action_space.sample())
    while not env.step(still)[3].all():
        pass

    observations = env.step(np.full_like(still, np.nan))[0]

    assert np.isfinite(observations).all()
    assert env.batch.times.tolist() == [0.0] * 3


def test_mask_resets_chosen_worlds_only() -> None:
    env = ZensimVectorEnv(3, autoreset_mode=AutoresetMode.DISABLED, threads=1, **SHORT)
    env.reset(seed=1)
    before = env.step(act(env, 0))[0]

    after, _ = env.reset(options={"reset_mask": np.array([False, True, False])})

    assert (after[[0, 2]] == before[[0, 2]]).all()
    assert (after[1] != before[1]).any()
    assert env.batch.times.tolist() == pytest.approx([0.1, 0.0, 0.1])


def test_step_of_an_ended_world_is_refused_without_autoreset() -> None:
    env = ZensimVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED, threads=1, time_limit_s=0.1)
    with pytest.raises(zensim.Invalid) as refused:
        env.step(act(env, 0))
    assert refused.value.slug == "not_reset"
    env.reset(seed=1)
    env.step(act(env, 0))

    with pytest.raises(zensim.Invalid) as refused:
        env.step(act(env, 1))

    assert refused.value.slug == "not_reset"


def test_wrong_arguments_are_refused(env: ZensimVectorEnv) -> None:
    env.reset(seed=1)
    for mask in (np.ones(2, np.bool_), np.zeros(3, np.bool_), np.ones(3)):
        with pytest.raises(zensim.Invalid):
            env.reset(options={"reset_mask": mask})
    with pytest.raises(zensim.Invalid):
        env.reset(seed=[1, 2])
    with pytest.raises(zensim.Invalid):
        env.step(np.zeros((3, 2)))
    wrong: tuple[dict[str, Any], ...] = (
        {"rate_hz": 7.0, "dynamics": "full"},
        {"dynamics": "auto"},
        {"count": 0},
        {"count": 1.5},
        {"threads": 1.5},
        {"task": "fly"},
        {"task": "avoid", "count": 1},
    )
    for options in wrong:
        with pytest.raises(zensim.Invalid):
            ZensimVectorEnv(1, **options)
    for worlds in (0, 10**7, 1.5):
        with pytest.raises(zensim.Invalid):
            ZensimVectorEnv(worlds)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        ZensimVectorEnv(1, robots=3)  # type: ignore[call-arg]
    with pytest.raises(zensim.Invalid):
        ZensimVectorEnv(1, autoreset_mode=AutoresetMode.SAME_STEP)


def test_statistics_of_gymnasium_count_episodes() -> None:
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(
        ZensimVectorEnv(2, threads=1, time_limit_s=0.5)
    )
    env.reset(seed=1)

    found = [env.step(np.zeros((2, 1, 2), np.float32))[4] for _ in range(5)]

    assert found[-1]["episode"]["l"].tolist() == [5, 5]
    env.close()


def test_environment_of_a_given_world_can_be_copied() -> None:
    with zensim.World() as world:
        world.spawn_fleet("box_bot", count=2)
        env = ZensimVectorEnv(2, world=world, **SHORT)
    env.reset(seed=1)

    copied = deepcopy(env)

    assert (copied.step(act(env, 1))[0] == env.step(act(env, 1))[0]).all()


def test_given_world_is_copied_with_its_sensors() -> None:
    with zensim.World("walls") as world:
        world.spawn("box_bot_lidar", name="r1")
        env = ZensimVectorEnv(2, world=world, sensors=("scan", "imu"), threads=1)

    observations, _ = env.reset(seed=2)

    assert observations.shape == (2, 1, 4 + 360 + 10)
    assert env.observation_space.contains(observations)
    assert env.observation_space.contains(env.step(act(env, 1))[0])
