"""Batches of kinematic robots: the bits of a world and of a server, stops, restarts."""

from collections.abc import Callable

import numpy as np
import pytest

import zensim
from zensim.envs.batch import Batch

HZ = 10.0
WORLDS = 5
LAST = WORLDS - 1


def open_world(world: str = "empty") -> zensim.World:
    return zensim.World(world, step_hz=HZ, control_hz=HZ)


def draw_twists(steps: int, worlds: int, robots: int) -> np.ndarray:
    """Commands (steps, worlds, robots, 3) that change every third step; the last world's are equal
    whatever the number of worlds."""
    found = []
    for world in range(worlds):
        draw = np.random.default_rng(worlds - world).normal(size=(steps, robots, 3))
        found.append(draw[np.arange(steps) // 3 * 3] * (0.5, 0.1, 1.0) + (0.4, 0.0, 0.0))
    return np.stack(found, axis=1)


def run_in_batch(batch: Batch, twists: np.ndarray) -> list[str]:
    """Hash the states of the last world after each step."""
    found = []
    for one in twists:
        batch.step(one)
        found.append(batch.digest(len(one) - 1))
    return found


def drive(sim: zensim.Simulation, twists: np.ndarray) -> list[str]:
    """Hash the states after each step; twists (steps, robots, 3)."""
    fleet = sim.robots
    names = list(fleet)
    found = []
    for one in twists:
        for name, (v, left, w) in zip(names, one.tolist(), strict=True):
            fleet[name].drive(v, w, left=left)
        sim.step(1)
        found.append(sim.state_hash())
    return found


def test_episode_has_the_bits_of_a_world_and_of_a_server_in_lockstep() -> None:
    twists = draw_twists(60, WORLDS, 8)
    found = []
    with open_world("walls") as world:
        world.spawn_fleet("box_bot", count=8, spacing=0.4, dynamics="kinematic")
        batch = Batch(world, WORLDS)
        found.append(run_in_batch(batch, twists))
        found.append(drive(world, twists[:, LAST]))
    with zensim.launch("walls", step_hz=HZ, control_hz=HZ, engine="mujoco", timeout_s=120.0) as sim:
        sim.spawn_fleet("box_bot", count=8, spacing=0.4, dynamics="kinematic")
        found.append(drive(sim, twists[:, LAST]))

    assert batch.is_touching.any()
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize(
    ("model", "world", "robots"),
    [
        ("omni_bot", "empty", 6),
        ("car_bot", "empty", 6),
        ("trike_bot", "empty", 4),
        ("skid_bot", "maze", 4),
        ("box_bot", "warehouse", 30),
    ],
)
def test_copy_has_the_bits_of_its_world(model: str, world: str, robots: int) -> None:
    twists = draw_twists(40, WORLDS, robots)
    with open_world(world) as own:
        own.spawn_fleet(model, count=robots, spacing=0.5, dynamics="kinematic")
        batch = Batch(own, WORLDS)

        assert run_in_batch(batch, twists) == drive(own, twists[:, LAST])


def test_world_does_not_depend_on_the_number_of_worlds_and_threads() -> None:
    with open_world() as own:
        own.spawn_fleet("box_bot", count=3, spacing=0.4, dynamics="kinematic")
        runs = [
            run_in_batch(Batch(own, worlds, threads=threads), draw_twists(40, worlds, 3))
            for worlds, threads in ((1, 1), (40, 2))
        ]

    assert runs[0] == runs[1]


def test_restarted_world_repeats_its_bits_while_others_go_on() -> None:
    twists = draw_twists(30, WORLDS, 6)
    with open_world("walls") as own:
        own.spawn_fleet("box_bot", count=6, spacing=0.4, dynamics="kinematic")
        batch = Batch(own, WORLDS)
    start = batch.digest(LAST)
    first = run_in_batch(batch, twists)
    other = batch.digest(0)

    batch.restart(np.arange(WORLDS) == LAST)

    assert batch.digest(LAST) == start
    assert batch.digest(0) == other
    assert run_in_batch(batch, twists) == first


def test_robots_that_are_stopped_touch_what_stops_them() -> None:
    with open_world("walls") as own:
        poses = [(0.0, 0.0, 0.0), (0.5, 0.0, np.pi), (0.0, 1.5, 0.0)]
        own.spawn_fleet("box_bot", poses=poses, dynamics="kinematic")
        batch = Batch(own, 2)
    ahead, still = [0.3, 0.0, 0.0], [0.0, 0.0, 0.0]

    for _ in range(20):
        batch.step([[ahead, still, still], [still, still, still]])

    assert batch.is_touching.tolist() == [[True, True, False], [False, False, False]]
    batch.restart(np.array([True, False]))
    assert not batch.is_touching.any()


def test_robot_that_a_wall_stops_touches_it_until_it_turns_away() -> None:
    with open_world("walls") as own:
        own.spawn("box_bot", name="r1", dynamics="kinematic")
        batch = Batch(own, 1)

    for _ in range(200):
        batch.step([[[-0.5, 0.0, 0.0]]])
        if batch.is_touching.any():
            break

    assert batch.is_touching.tolist() == [[True]]
    batch.step([[[0.5, 0.0, 0.0]]])
    assert not batch.is_touching.any()


@pytest.mark.parametrize(
    "add",
    [
        lambda world: world.spawn("box_bot", name="full", x=3.0),
        lambda world: world.spawn("box_bot", name="auto", x=3.0, dynamics="auto"),
    ],
    ids=["full", "auto"],
)
def test_kinematic_robots_beside_others_are_refused(add: Callable[[zensim.World], None]) -> None:
    with open_world() as own:
        own.spawn("box_bot", name="r1", dynamics="kinematic")
        add(own)
        with pytest.raises(zensim.Unsupported) as refused:
            Batch(own, 1)

    assert refused.value.slug == "not_replicable"


def test_robot_turns_along_an_exact_arc_in_one_step() -> None:
    with open_world() as own:
        own.spawn("omni_bot", name="r1", dynamics="kinematic")
        batch = Batch(own, 1)
    before = batch.poses2d[0, 0]
    for _ in range(10):
        batch.step([[[0.5, 0.0, 1.0]]])

    x, y, yaw = batch.poses2d[0, 0] - before
    assert yaw == pytest.approx(1.0)
    assert (x, y) == pytest.approx((0.5 * np.sin(1.0), 0.5 * (1.0 - np.cos(1.0))))
