"""Sensors of worlds in process: their topics have what sensor processes publish."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.models import POLE_TOPICS, SENSOR_POLE
from zensim import Error, Robot, Sim, World, launch
from zensim.api.simulation import Simulation
from zensim.proto.messages.fault_messages import TopicFaultKind
from zensim.proto.messages.standard_messages import LaserScan, Odometry

STEPS = 150


@pytest.fixture(scope="module")
def server() -> Iterator[Sim]:
    with launch("walls", engine="mujoco", sensors=1, seed=3, timeout_s=120.0) as sim:
        yield sim


def _scan_for_a_while(sim: Simulation) -> list[tuple[int, int, bytes]]:
    robot = sim.spawn("box_bot_lidar", name="r1", x=0.5)
    found: list[tuple[int, int, bytes]] = []

    @robot.on("scan", queue=100)
    def keep(scan: LaserScan) -> None:
        stamp = scan.header.stamp
        found.append((stamp.sec, stamp.nanosec, np.asarray(scan.ranges).tobytes()))

    robot.drive(0.2, 0.4)
    sim.step(STEPS)
    return found


def test_scans_come_at_their_rate_and_repeat() -> None:
    with World("walls", seed=3) as world:
        first = _scan_for_a_while(world)
    with World("walls", seed=3) as world:
        second = _scan_for_a_while(world)

    times = [sec + 1e-9 * nanosec for sec, nanosec, _ in first]
    assert len(first) > 3
    assert np.ptp(np.diff(times)) < 0.02
    assert first == second


def test_scans_are_those_of_a_sensor_process(server: Sim) -> None:
    with World("walls", seed=3) as world:
        here = _scan_for_a_while(world)
    there = _scan_for_a_while(server)

    # A sensor process begins when it knows of the subscriber.
    assert there
    assert there == here[len(here) - len(there) :]


def test_scans_go_on_after_restore_and_with_new_robots() -> None:
    with World("walls", seed=3) as world:
        robot = world.spawn("box_bot_lidar", name="r1")
        topic = robot.topic("scan")
        topic.collect()
        world.run_for(0.5)
        snapshot = world.snapshot()
        world.run_for(0.5)
        first = topic.newest().ranges

        world.restore(snapshot)
        world.run_for(0.5)
        assert np.array_equal(topic.newest().ranges, first)
        other = world.spawn("box_bot_lidar", name="r2", x=1.0)
        other.topic("scan").collect()
        world.run_for(0.5)
        assert not np.array_equal(other.topic("scan").newest().ranges, topic.newest().ranges)


def test_camera_of_a_world_in_process_takes_pictures() -> None:
    with World("walls") as world:
        robot = world.spawn("box_bot_camera", name="r1")
        camera = next(iter(robot.sensors.values()))
        camera.collect()
        world.run_for(0.5)
        picture = camera.newest()
        assert len(picture.data) == picture.height * picture.step
        assert len(set(bytes(picture.data))) > 1


@pytest.mark.parametrize(
    ("kind", "sensor"), [("sensor_noise", "gps"), ("sensor_bias", "bump"), ("sensor_sector", "imu")]
)
def test_fault_that_changes_nothing_of_a_sensor_is_refused(
    kind: TopicFaultKind, sensor: str, tmp_path: Path
) -> None:
    model = tmp_path / "pole.urdf"
    model.write_text(SENSOR_POLE)
    with World() as world:
        world.spawn(model, name="r1")

        with pytest.raises(Error, match=kind):
            world.inject("r1", kind, sensor, value=0.5, low=-1.0, high=1.0)
        world.inject("r1", "sensor_off", sensor)


def test_subscription_before_the_robot_exists_gets_its_scans() -> None:
    with World("walls") as world:
        topic = world.topic("r1/scan")
        topic.collect()
        world.spawn("box_bot_lidar", name="r1")
        world.run_for(0.5)
        assert len(topic.newest().ranges)


def test_callback_that_drives_gives_the_same_run_each_time() -> None:
    hashes = set()
    for _ in range(3):
        with World("walls", seed=3) as world:
            robot = world.spawn("box_bot_lidar", name="r1")

            @robot.on("scan")
            def avoid(scan: LaserScan, robot: Robot = robot) -> None:
                robot.drive(0.3, 0.0 if np.min(scan.ranges) > 1.0 else 0.8)

            world.run_for(2.0)
            hashes.add(world.state_hash())

    assert len(hashes) == 1


def test_each_of_many_robots_publishes_from_the_step_after_its_subscription() -> None:
    with World() as world:
        fleet = world.spawn_fleet("box_bot", count=70)
        stamps: dict[str, list[int]] = {fleet.names[row]: [] for row in (0, 40, 69)}
        for name, found in stamps.items():

            @world.robots[name].on("odom", queue=100)
            def keep(odom: Odometry, found: list[int] = found) -> None:
                found.append(odom.header.stamp.nanosec)

            world.run_for(0.1)
        for found in stamps.values():
            found.clear()
        late = world.robots[fleet.names[35]]
        stamps["late"] = []
        late.on("odom", queue=100)(lambda odom: stamps["late"].append(odom.header.stamp.nanosec))
        stamps["late"].clear()

        world.run_for(0.4)

        first = stamps[fleet.names[0]]
        assert len(first) > 2
        assert [found[-len(first) :] for found in stamps.values()] == [first] * 4


def test_sensors_without_a_drive_and_static_topics_reach_callbacks(tmp_path: Path) -> None:
    model = tmp_path / "pole.urdf"
    model.write_text(SENSOR_POLE)
    received: dict[str, int] = dict.fromkeys(POLE_TOPICS, 0)

    def count(name: str, _: object) -> None:
        received[name] += 1

    with World("walls") as world:
        robot = world.spawn(str(model), name="pole")
        for name in POLE_TOPICS:
            robot.topic(name).on(partial(count, name))
        world.run_for(1.0)

    assert received == {
        "imu": 20,
        "fix": 5,
        "magnetic_field": 5,
        "altimeter": 5,
        "bumper_states": 20,
        "tf_static": 1,
        "robot_description": 1,
    }


def test_further_callback_of_a_static_topic_gets_its_message() -> None:
    received: list[object] = []
    with World("walls") as world:
        topic = world.spawn("box_bot", name="r1").topic("tf_static")
        topic.read()
        topic.on(received.append)
        topic.on(received.append)
        world.run_for(0.1)

    assert len(received) == 2
