"""Batch: copies of a world in arrays."""

import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy

import numpy as np
import pytest

import zensim
from zensim.api.in_process_world import get_server
from zensim.envs.batch import Batch
from zensim.proto.messages.model_messages import Dynamics
from zensim.sim_server.physics.mujoco.mujoco_replicas import MujocoReplicas
from zensim.sim_server.world.applied_forces import LinkWrench, TimeSpan

ROBOTS = 3


@pytest.fixture(scope="module")
def world() -> Iterator[zensim.World]:
    with zensim.World() as found:
        found.spawn_fleet("box_bot", count=ROBOTS)
        yield found


def twists_at(step: int, worlds: int) -> np.ndarray:
    """Twists that differ by world, robot and step."""
    world, robot = np.arange(worlds)[:, None], np.arange(ROBOTS)
    turn = 0.5 * np.sin(0.1 * step + world + 2.0 * robot)
    return np.stack([0.3 + 0.1 * np.cos(turn), 0.0 * turn, turn], axis=-1)


def run(batch: Batch, steps: int) -> list[str]:
    for step in range(steps):
        batch.step(twists_at(step, batch.shape[0]))
    return [batch.digest(at) for at in range(batch.shape[0])]


def break_copy(batch: Batch, world: int) -> None:
    """Give the bodies of a copy speeds that no engine can step."""
    replicas = batch._replicas  # noqa: SLF001
    assert isinstance(replicas, MujocoReplicas)
    replicas.worlds[world].data.qvel[:] = np.inf


def drive_world(model: str, twists: Sequence[tuple[float, float, float]]) -> tuple[str, str]:
    """Drive two robots in a world and in a batch; return both hashes."""
    with zensim.World() as own:
        fleet = own.spawn_fleet(model, count=2)
        batch = Batch(own, 2)
        for v, left, w in twists:
            fleet.drive([v, v / 2.0], [w, -w], left=left)
            own.step(3)
            one = [[v, left, w], [v / 2.0, left, -w]]
            batch.step([one, one])
        assert batch.digest(0) == batch.digest(1)
        return own.state_hash(), batch.digest(1)


def test_steps_keep_nothing(world: zensim.World) -> None:
    batch = Batch(world, 8)
    run(batch, 20)
    tracemalloc.start()
    try:
        run(batch, 200)
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert grown < 200 * 8 * ROBOTS * 8  # one number a robot and step


@pytest.mark.parametrize("model", ["box_bot", "omni_bot", "car_bot", "trike_bot", "skid_bot"])
def test_copy_has_the_bits_of_its_world(model: str) -> None:
    twists = [(0.4, 0.05, 0.6 * np.sin(0.2 * step)) for step in range(60)]

    expected, found = drive_world(model, twists)

    assert found == expected


def test_world_does_not_depend_on_the_number_of_worlds_and_threads(world: zensim.World) -> None:
    alone = run(Batch(world, 1), 40)
    many = run(Batch(world, 16), 40)
    threaded = run(Batch(world, 16, threads=3), 40)

    assert many[0] == alone[0]
    assert threaded == many
    assert len(set(many)) == len(many)


def test_restarted_world_repeats_its_bits_while_others_go_on(world: zensim.World) -> None:
    batch = Batch(world, 3)
    start = batch.digest(1)
    first = run(batch, 20)

    batch.restart(np.array([False, True, False]))

    assert batch.digest(1) == batch.digest(-2) == start
    assert batch.digest(0) == first[0]
    assert batch.times.tolist() == pytest.approx([0.25, 0.0, 0.25])
    assert run(batch, 20)[1] == first[1]


def test_restart_of_all_repeats_a_run_after_other_commands(world: zensim.World) -> None:
    batch = Batch(world, 2)
    first = run(batch, 20)
    batch.step(np.full((2, ROBOTS, 3), 0.5), control_steps=7)

    batch.restart()

    assert run(batch, 20) == first


def test_batch_outlives_its_world() -> None:
    with zensim.World() as own:
        own.spawn("box_bot", name="r1")
        batch = Batch(own, 2)
        own.spawn("box_bot", name="r2", x=1.0)
    batch.step(np.tile([0.3, 0.0, 0.0], (2, 1, 1)), control_steps=80)

    assert batch.names == ("r1",)
    assert batch.poses2d[:, 0, 0] == pytest.approx([0.3, 0.3], abs=0.05)


def test_arrays_have_a_row_for_each_world_and_robot(world: zensim.World) -> None:
    batch = Batch(world, 2)
    batch.step(np.tile([0.3, 0.0, 0.5], (2, ROBOTS, 1)), control_steps=80)

    assert batch.states.shape == (2, ROBOTS, 13)
    assert batch.poses2d.shape == (2, ROBOTS, 3)
    assert batch.twists[..., 0] == pytest.approx(np.full((2, ROBOTS), 0.3), abs=0.03)
    assert batch.twists[..., 5] == pytest.approx(np.full((2, ROBOTS), 0.5), abs=0.08)
    assert batch.poses2d[..., 2] == pytest.approx(np.full((2, ROBOTS), 0.5), abs=0.08)


def test_touching_robots_are_found_and_the_ground_is_not() -> None:
    with zensim.World("walls") as own:
        own.spawn_fleet("box_bot", poses=[(0.0, 0.0, 0.0), (0.3, 0.0, np.pi), (0.0, 1.0, 0.0)])
        batch = Batch(own, 2)
    still, ahead = [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]

    batch.step([[ahead, ahead, still], [still, still, still]], control_steps=80)

    assert batch.is_touching.tolist() == [[True, True, False], [False, False, False]]


def test_robot_that_drives_against_a_wall_touches_it() -> None:
    with zensim.World("walls") as own:
        own.spawn("box_bot", name="r1")
        batch = Batch(own, 1)

    for _ in range(40):
        batch.step([[[-0.5, 0.0, 0.0]]], control_steps=40)
        if batch.is_touching.any():
            break

    assert batch.is_touching.tolist() == [[True]]


def test_restarted_world_touches_what_it_touched_at_its_start() -> None:
    with zensim.World() as own:
        own.spawn_fleet("box_bot", poses=[(0.0, 0.0, 0.0), (0.5, 0.0, np.pi)])
        batch = Batch(own, 2)
    batch.step(np.tile([0.5, 0.0, 0.0], (2, 2, 1)), control_steps=80)
    assert batch.is_touching.all()
    assert deepcopy(batch).is_touching.all()

    batch.restart(np.array([True, False]))

    assert batch.is_touching.tolist() == [[False, False], [True, True]]


def test_diverged_world_rests_until_its_restart(world: zensim.World) -> None:
    batch = Batch(world, 2)
    healthy = Batch(world, 2)
    break_copy(batch, 1)

    for step in range(3):
        batch.step(twists_at(step, 2))
        healthy.step(twists_at(step, 2))

    assert batch.is_diverged.tolist() == [False, True]
    assert np.isnan(batch.states[1]).all()
    assert batch.digest(0) == healthy.digest(0)
    batch = deepcopy(batch)
    batch.step(twists_at(3, 2))
    healthy.step(twists_at(3, 2))
    assert batch.is_diverged.tolist() == [False, True]
    batch.restart(batch.is_diverged)
    healthy.restart(np.array([False, True]))
    assert not batch.is_diverged.any()
    assert run(batch, 5) == run(healthy, 5)


def test_wrong_arguments_are_refused(world: zensim.World) -> None:
    batch = Batch(world, 2)

    for twists in (np.zeros((2, ROBOTS, 2)), np.full((2, ROBOTS, 3), np.nan)):
        with pytest.raises(zensim.Invalid):
            batch.step(twists)
    for mask in (np.ones(3, np.bool_), np.zeros(2)):
        with pytest.raises(zensim.Invalid):
            batch.restart(mask)
    for worlds, threads in ((0, 1), (10**7, 1), (1, 0), (1, 10**7)):
        with pytest.raises(zensim.Invalid):
            Batch(world, worlds, threads=threads)
    with pytest.raises(zensim.Invalid):
        batch.step(np.zeros((2, ROBOTS, 3)), control_steps=0)
    with pytest.raises(zensim.Invalid):
        batch.restart(np.array([True, False]), seeds={1: 7})
    with pytest.raises(IndexError):
        batch.digest(2)
    with pytest.raises(zensim.Invalid):
        batch.scans  # noqa: B018
    with pytest.raises(zensim.Invalid):
        batch.imu  # noqa: B018


def test_world_without_robots_is_refused() -> None:
    with zensim.World() as own, pytest.raises(zensim.Invalid):
        Batch(own, 1)


@pytest.mark.parametrize(
    ("engine", "model", "dynamics"), [("pybullet", "box_bot", ""), ("mujoco", "box_bot", "auto")]
)
def test_world_that_cannot_be_copied_is_refused(
    engine: str, model: str, dynamics: Dynamics
) -> None:
    with zensim.World(engine=engine) as own:
        own.spawn(model, name="r1", dynamics=dynamics)
        with pytest.raises(zensim.Unsupported) as refused:
            Batch(own, 1)

    assert refused.value.slug == "not_replicable"


def pull(world: zensim.World, end_ns: int | None) -> None:
    simulated = get_server(world).world
    span = TimeSpan(simulated.clock.time_ns, end_ns)
    simulated.applied_forces.add(LinkWrench("r1", 0, np.ones(6), span))


@pytest.mark.parametrize(
    "act",
    [
        lambda world: pull(world, None),
        lambda world: world.inject("r1", "sensor_off", "lidar"),
        lambda world: world.inject("r1", "wheel_slip", "left_wheel_joint", seconds=1.0),
    ],
    ids=["wrench", "fault of a topic", "fault that ends"],
)
def test_forces_and_faults_that_copies_cannot_have_are_refused(
    act: Callable[[zensim.World], None],
) -> None:
    with zensim.World(engine="mujoco") as own:
        own.spawn("box_bot_lidar", name="r1")
        act(own)
        with pytest.raises(zensim.Unsupported) as refused:
            Batch(own, 1)

    assert refused.value.slug == "not_replicable"


def test_forces_that_are_over_and_faults_without_end_can_be_copied() -> None:
    with zensim.World(engine="mujoco") as own:
        own.spawn("box_bot", name="r1")
        own.inject("r1", "motor_weak", "left_wheel_joint", value=0.5)
        pull(own, 0)

        with Batch(own, 2) as batch:
            batch.step(np.zeros((2, 1, 3)))

    assert batch.times.tolist() == [batch.control_period] * 2


@pytest.mark.parametrize("threads", [1, 2])
def test_closed_batch_does_not_step(world: zensim.World, threads: int) -> None:
    with Batch(world, 2, threads=threads) as batch:
        batch.step(twists_at(0, 2))
        before = batch.digest(1)
    batch.close()

    with pytest.raises(zensim.Closed):
        batch.step(twists_at(1, 2))
    assert batch.digest(1) == before
