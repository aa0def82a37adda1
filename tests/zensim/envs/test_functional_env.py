"""FunctionalEnv: steps that change nothing, with the bits of other environments."""

import numpy as np
import pytest

import zensim
from zensim.envs import FunctionalEnv, ZensimVectorEnv


def draw_actions(steps: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.0, 1.0, (steps, 3, 4, 2))


def test_steps_have_the_bits_of_the_vector_environment() -> None:
    actions = draw_actions(40)
    vector = ZensimVectorEnv(3, task="avoid", count=4, spacing=0.5)
    with FunctionalEnv(3, task="avoid", count=4, spacing=0.5) as env:
        state, first = env.reset(seed=4)
        assert (vector.reset(seed=4)[0] == first).all()

        for one in actions:
            state, outcome = env.step(state, one)
            observations, _, _, _, infos = vector.step(one)

            assert (outcome.observations == observations).all()
            assert (outcome.rewards == infos["robot_rewards"]).all()
            assert (outcome.is_over == infos["robot_over"]).all()


@pytest.mark.parametrize(
    "options",
    [
        {"task": "avoid", "count": 4, "spacing": 0.5},
        {"task": "deliver", "count": 4, "sensors": ("scan",)},
    ],
    ids=["avoid", "deliver"],
)
def test_a_state_is_stepped_again_after_others(options: dict[str, object]) -> None:
    actions = draw_actions(30)
    with FunctionalEnv(3, **options) as env:  # type: ignore[arg-type]
        state, _ = env.reset(seed=1)
        for one in actions[:10]:
            state, _ = env.step(state, one)
        branch, outcomes = state, []
        for one in actions[10:]:
            branch, outcome = env.step(branch, one)
            outcomes.append(outcome)

        _, other = env.step(state, -actions[10])
        for one, expected in zip(actions[10:], outcomes, strict=True):
            state, found = env.step(state, one)
            assert (found.observations == expected.observations).all()
            assert (found.rewards == expected.rewards).all()

    assert (other.observations != outcomes[0].observations).any()


def test_worlds_restart_instead_of_a_step() -> None:
    with FunctionalEnv(3, count=4) as env:
        state, _ = env.reset(seed=1)
        for one in draw_actions(5):
            state, _ = env.step(state, one)

        _, outcome = env.step(state, draw_actions(1)[0], np.array([True, False, False]))

    assert (outcome.observations[0, :, 2:] == 0.0).all()
    assert (outcome.observations[1, :, 2:] != 0.0).any()


def test_a_state_of_other_worlds_is_refused() -> None:
    with FunctionalEnv(1) as one, FunctionalEnv(3) as env:
        state, _ = one.reset(seed=1)

        with pytest.raises(zensim.Invalid):
            env.step(state, np.zeros((3, 1, 2)))


@pytest.mark.parametrize(
    "options", [{"task": "avoid"}, {"task": "reach", "spacing": 3.0}, {"rate_hz": 5.0}], ids=str
)
def test_a_state_of_other_settings_is_refused_and_changes_nothing(
    options: dict[str, object],
) -> None:
    actions = draw_actions(2)
    with FunctionalEnv(3, count=4) as env, FunctionalEnv(3, count=4, **options) as other:  # type: ignore[arg-type]
        state, _ = env.reset(seed=1)
        foreign, _ = other.reset(seed=1)
        _, expected = env.step(state, actions[0])

        for _ in range(2):
            with pytest.raises(zensim.Invalid) as refused:
                env.step(foreign, actions[0])

        assert refused.value.slug == "wrong_state"
        _, found = env.step(state, actions[0])
        assert (found.observations == expected.observations).all()


def test_a_state_of_an_equal_environment_is_stepped() -> None:
    actions = draw_actions(1)[0]
    with FunctionalEnv(3, count=4, threads=1) as env, FunctionalEnv(3, count=4) as other:
        state, _ = env.reset(seed=1)

        found = other.step(state, actions)[1]

        assert (found.observations == env.step(state, actions)[1].observations).all()


def test_full_dynamics_and_inertial_units_are_refused() -> None:
    with pytest.raises(zensim.Unsupported):
        FunctionalEnv(1, dynamics="full")
    with pytest.raises(zensim.Unsupported):
        FunctionalEnv(1, model="box_bot_lidar", sensors=["imu"])
