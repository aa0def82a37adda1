"""Lidars and inertial units of a batch."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import zensim
from zensim.envs.batch import Batch
from zensim.sim_server.description.builtin_models import read_builtin_model

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


NOISE = "<noise><type>gaussian</type><mean>0</mean><stddev>0.01</stddev></noise>"
WALKING = NOISE.replace(
    "</noise>",
    "<dynamic_bias_stddev>0.05</dynamic_bias_stddev>"
    "<dynamic_bias_correlation_time>2</dynamic_bias_correlation_time></noise>",
)
LEVEL = '<sensor type="ray" name="lidar">'
LEANING = f"{LEVEL}<pose>0 0 0 0 0.3 0</pose>"


def write_model(folder: Path, old: str, new: str) -> Path:
    """Write a box_bot_lidar in which a text is replaced."""
    text = read_builtin_model(MODEL)
    assert old in text
    path = folder / "changed.urdf"
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new"),
    [("", ""), (NOISE, WALKING), (LEVEL, LEANING)],
    ids=["level", "walking bias", "leaning"],
)
def test_scan_of_a_world_does_not_depend_on_others(tmp_path: Path, old: str, new: str) -> None:
    twists = np.random.default_rng(1).normal(size=(5, 3, 3)) * (0.3, 0.0, 1.0)
    with zensim.World("maze", step_hz=10.0, control_hz=10.0) as own:
        model = write_model(tmp_path, old, new)
        own.spawn_fleet(model, count=3, spacing=0.6, dynamics="kinematic")
        many, alone = (Batch(own, worlds, sensors=["scan"]) for worlds in (5, 1))
    many.restart(seeds={world: world for world in range(5)})
    alone.restart(seeds={0: 4})

    for _ in range(10):
        many.step(twists)
        alone.step(twists[4:])

    assert (many.scans[4] == alone.scans[0]).all()
    assert (many.scans[3] != alone.scans[0]).any()


def test_robots_of_other_worlds_are_not_seen() -> None:
    with zensim.World(step_hz=10.0, control_hz=10.0) as own:
        own.spawn_fleet(MODEL, poses=[(0.0, 0.0), (0.8, 0.0)], dynamics="kinematic")
        batch = Batch(own, 2, sensors=["scan"])

    for _ in range(20):
        batch.step([[[0.0] * 3, [0.5, 0.0, 0.0]], [[0.0] * 3, [0.0] * 3]])

    assert batch.scans[0, 0].min() == pytest.approx(1.7, abs=0.1)
    assert batch.scans[1, 0].min() == pytest.approx(0.7, abs=0.1)
