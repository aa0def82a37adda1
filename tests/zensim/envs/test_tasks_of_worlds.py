"""Tasks with worlds of their own: places, chase, coverage and deliveries."""

import math
from dataclasses import replace

import numpy as np
import pytest

import zensim
from zensim.envs import ZensimEnv, ZensimVectorEnv
from zensim.envs.coverage_task import CoverField
from zensim.envs.env_settings import make_world_start
from zensim.envs.free_places import find_free_places
from zensim.envs.navigation_task import NavigateMaze
from zensim.envs.pursuit_task import CatchEvader
from zensim.envs.robot_task import FleetView
from zensim.envs.world_streams import WorldStreams


def steer(seen: np.ndarray) -> np.ndarray:
    """Drive to points (..., 2) in the frames of robots."""
    error = np.arctan2(seen[..., 1], seen[..., 0])
    return np.stack([np.clip(np.cos(error), 0.0, 1.0), np.clip(error, -1.0, 1.0)], axis=-1)


def run(env: ZensimVectorEnv, first: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Drive to what columns `first` and the next say; return first success, and rewards."""
    observations, _ = env.reset(seed=1)
    successes, rewards = np.zeros(env.num_envs, np.bool_), []
    for _ in range(steps):
        observations, _, _, _, infos = env.step(steer(observations[..., first : first + 2]))
        successes |= infos["robot_success"].all(axis=1)
        rewards.append(infos["robot_rewards"])
        if successes.all():
            break
    env.close()
    return successes, np.array(rewards)


def test_free_places_are_reached_clear_and_between_walls() -> None:
    with zensim.World("maze") as world:
        world.spawn("box_bot", name="r1")
        places = find_free_places(make_world_start(world), 0.3)
        origins = np.column_stack([places[::50], np.full(len(places[::50]), 0.2)])
        turns = np.arange(8) * np.pi / 4.0
        directions = np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1)
        ranges, _ = world.cast_rays(
            np.repeat(origins, 8, axis=0), np.tile(directions, (len(origins), 1))
        )

    assert len(places) > 1000
    assert np.min(ranges) > 0.15
    assert np.isfinite(np.reshape(ranges, (-1, 8))).any(axis=1).all()


def test_places_in_a_world_without_walls_are_refused() -> None:
    with zensim.World() as world:
        world.spawn("box_bot", name="r1")
        with pytest.raises(zensim.Invalid):
            find_free_places(make_world_start(world), 0.2)


def test_goals_of_navigation_are_free_places_and_a_lidar_follows() -> None:
    task = NavigateMaze()
    env = ZensimEnv(task)

    observation, _ = env.reset(seed=3)

    assert observation.shape == (4 + 360,)
    assert env.observation_space.contains(observation)
    with zensim.World("maze") as world:
        world.spawn("box_bot_lidar", name="r1")
        places = find_free_places(make_world_start(world), 0.2)
    x, y, _ = env.batch.poses2d[0, 0]
    away = np.hypot(*(places - (x, y) - observation[:2]).T)
    assert away.min() < 1e-3
    env.close()


def test_a_pursuer_that_is_faster_catches_the_evader() -> None:
    successes, rewards = run(ZensimVectorEnv(3, task="pursue", count=2), 0, 200)

    assert successes.all()
    assert rewards[-1].max() > 0.9


def test_the_evader_flees_and_is_seen_in_the_frame_of_the_robot() -> None:
    task = CatchEvader()
    poses = np.array([[[0.0, 0.0, np.pi / 2.0], [2.0, 0.0, 0.0]]])
    view = FleetView(poses, np.zeros((1, 2, 2)), np.zeros((1, 2), np.bool_), np.zeros(1))
    task.restart(np.arange(1), view, WorldStreams(1))

    assert task.drive(view)[0, 1] == pytest.approx([0.3, 0.0])
    assert task.observe(view)[0, 0, :5] == pytest.approx([0.0, -2.0, 0.0, 0.0, -1.0])


def test_robots_that_drive_to_the_nearest_cell_cover_the_field() -> None:
    successes, rewards = run(ZensimVectorEnv(2, task="cover"), 7, 600)

    assert successes.all()
    assert rewards.sum() > 0.0


def test_covered_cells_pay_once() -> None:
    task = CoverField(side_m=2.0)
    poses = np.array([[[-0.75, -0.75, 0.0], [0.75, 0.75, 0.0]]])
    view = FleetView(poses, np.zeros((1, 2, 2)), np.zeros((1, 2), np.bool_), np.zeros(1))
    task.restart(np.arange(1), view, WorldStreams(1))
    moved = replace(view, poses=poses * (-1.0, 1.0, 1.0))

    paid = [task.judge(one).rewards for one in (view, moved, moved)]

    assert task.observe(view)[0, 0, 6] == pytest.approx(12.0 / 16.0)
    assert paid[0] == pytest.approx(np.full((1, 2), -0.01))
    nearer_m = math.sqrt(0.5) - math.sqrt(1.25)
    assert paid[1] == pytest.approx(np.full((1, 2), 0.29 + 0.2 * nearer_m))
    assert paid[2] == pytest.approx(paid[0])


def test_a_delivery_pays_and_gives_the_next_goal() -> None:
    env = ZensimVectorEnv(2, task="deliver", count=4, sensors=())

    _, rewards = run(env, 0, 600)

    assert rewards.shape == (600, 2, 4)
    assert (rewards > 0.9).sum(axis=0).max() >= 2


def test_worlds_of_tasks_have_their_settings_unless_others_are_given() -> None:
    env = ZensimVectorEnv(1, task="deliver")
    other = ZensimVectorEnv(1, task="deliver", world="maze", count=2, model="box_bot", sensors=())

    assert env.batch.shape == (1, 20)
    assert env.single_observation_space.shape == (20, 16 + 360)
    assert other.batch.shape == (1, 2)
    assert other.single_observation_space.shape == (2, 16)
