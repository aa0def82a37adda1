"""Lidars and inertial units of a batch."""

from collections.abc import Iterator

import numpy as np
import pytest

import zensim
from zensim.envs.batch import Batch

MODEL = "box_bot_lidar"
AHEAD = [0.3, 0.0, 0.0]


@pytest.fixture(scope="module")
def world() -> Iterator[zensim.World]:
    with zensim.World("walls") as found:
        found.spawn_fleet(MODEL, poses=[(0.0, 0.0), (1.0, 0.0)])
        yield found


def test_scan_sees_the_other_robot_and_walls(world: zensim.World) -> None:
    batch = Batch(world, 2, sensors=["scan"])

    scans = batch.scans

    assert scans.shape == (2, 2, 360)
    assert scans[:, 0, 180] == pytest.approx([1.0, 1.0], abs=0.15)
    assert (scans >= 0.06).all()
    assert (scans <= 10.0).all()


def test_scan_is_that_of_the_sensor_process_but_for_noise(world: zensim.World) -> None:
    with world.fork() as own:
        batch = Batch(own, 1, sensors=["scan"])
        topic = own.robots[batch.names[0]].topic("scan")
        with pytest.raises(zensim.NotFound):
            topic.newest()
        own.run_for(0.2)
        message = topic.newest()

    batch.step(np.zeros((1, 2, 3)), control_steps=16)

    ranges = np.minimum(np.asarray(message.ranges), 10.0)
    assert batch.scans[0, 0] == pytest.approx(ranges, abs=0.1)


def test_noise_depends_on_seed_and_step_alone(world: zensim.World) -> None:
    found = []
    for worlds in (1, 3):
        batch = Batch(world, worlds, sensors=["scan", "imu"])
        batch.restart(seeds={world: 5 + world for world in range(worlds)})
        batch.step(np.tile(AHEAD, (worlds, 2, 1)), control_steps=8)
        found.append((batch.scans[0], batch.imu[0]))

    assert (found[0][0] == found[1][0]).all()
    assert (found[0][1] == found[1][1]).all()
    assert (batch.scans[1] != batch.scans[2]).any()


def test_imu_measures_gravity_and_turn(world: zensim.World) -> None:
    batch = Batch(world, 1, sensors=["imu"])
    assert batch.imu[0, 0, 7:] == pytest.approx([0.0, 0.0, 9.81], abs=0.1)

    batch.step(np.tile([0.0, 0.0, 0.5], (1, 2, 1)), control_steps=80)

    assert batch.imu[0, :, 6] == pytest.approx([0.5, 0.5], abs=0.05)
    assert batch.imu[0, :, 9] == pytest.approx([9.81, 9.81], abs=0.5)


def test_restarted_world_measures_at_rest_again(world: zensim.World) -> None:
    batch = Batch(world, 2, sensors=["imu"])
    batch.step(np.tile([0.0, 0.0, 0.5], (2, 2, 1)), control_steps=80)

    batch.restart(np.array([True, False]))

    assert batch.imu[0, :, 6].tolist() == [0.0, 0.0]
    assert batch.imu[1, :, 6] == pytest.approx([0.5, 0.5], abs=0.05)


def test_robot_without_the_sensor_is_refused() -> None:
    with zensim.World() as own:
        own.spawn("box_bot", name="r1")
        with pytest.raises(zensim.NotFound):
            Batch(own, 1, sensors=["scan"])
        with pytest.raises(zensim.Invalid):
            Batch(own, 1, sensors=["radar"])  # type: ignore[list-item]
