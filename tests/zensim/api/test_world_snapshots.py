"""Snapshots and views of worlds in process."""

import pickle
import random
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from zensim import Invalid, NotFound, SpawnRefused, Unsupported, World
from zensim.proto.messages.fault_messages import TopicFaultKind
from zensim.proto.messages.standard_messages import LaserScan


@pytest.fixture
def world() -> Iterator[World]:
    with World(seed=3) as made:
        yield made


def _run(world: World, steps: int = 30) -> tuple[str, bytes]:
    """Go on, and describe all that a user can observe: states, odometry, joints."""
    world.step(steps)
    robots = [world.robots[name] for name in world.robots]
    telemetry = [(robot.odom, robot.joints.position, robot.twist) for robot in robots]
    return world.state_hash(), repr(telemetry).encode()


def test_run_goes_on_with_equal_bits_after_restore(world: World) -> None:
    fleet = world.spawn_fleet("box_bot", count=3)
    fleet.drive(0.3, [0.1, 0.2, 0.3])
    world.run_for(0.5)
    snapshot = world.snapshot()
    first = _run(world)

    for _ in range(3):
        world.restore(snapshot)
        assert _run(world) == first


def test_restored_world_has_time_orders_paths_twists_and_names(world: World) -> None:
    robot = world.spawn("box_bot", name="r1")
    robot.follow([(1.0, 0.0), (2.0, 1.0)])
    world.run_for(0.5)
    other = world.spawn("box_bot", name="r2", y=3.0)
    other.drive(0.2, 0.0)
    snapshot, time = world.snapshot(), world.time
    first = _run(world)

    robot.drive(0.0, 1.0)
    other.stop()
    world.run_for(0.5)
    world.restore(snapshot)

    assert (world.time, list(world.robots)) == (time, ["r1", "r2"])
    assert _run(world) == first


def _spawn(world: World, choose: random.Random) -> None:
    model = choose.choice(["box_bot", "omni_bot", "car_bot"])
    with suppress(SpawnRefused):
        world.spawn(model, x=choose.uniform(-4, 4), y=choose.uniform(-4, 4))


def _drive(world: World, choose: random.Random) -> None:
    for robot in world.robots.values():
        robot.drive(choose.uniform(-0.3, 0.3), choose.uniform(-1, 1))


def _delete(world: World, choose: random.Random) -> None:
    if names := list(world.robots):
        world.robots[choose.choice(names)].delete()


def _place(world: World, choose: random.Random) -> None:
    if names := list(world.robots):
        world.robots[choose.choice(names)].set_pose(choose.uniform(-4, 4), 0.0, yaw=1.0)


def _advance(world: World, choose: random.Random) -> None:
    world.step(choose.randint(1, 40))


MOVES = (_spawn, _drive, _drive, _delete, _place, _advance, _advance)


def _play(world: World, moves: Sequence[Callable[..., None]], seed: int) -> str:
    choose = random.Random(seed)
    for move in moves:
        move(world, choose)
    world.step(7)
    return world.state_hash()


@pytest.mark.parametrize("seed", range(6))
def test_random_histories_repeat_from_each_snapshot(seed: int) -> None:
    choose = random.Random(seed)
    with World() as world:
        saved: list[tuple[bytes, Sequence[Callable[..., None]], int, str]] = []
        for number in range(6):
            before = world.snapshot()
            moves: Sequence[Callable[..., None]] = choose.choices(MOVES, k=5)
            saved.append((before, moves, number, _play(world, moves, number)))
        choose.shuffle(saved)

        for snapshot, played, number, expected in saved:
            world.restore(snapshot)
            assert _play(world, played, number) == expected


BULLET_DIFFERENCE = 0.01
"""Most difference of poses and velocities [m, m/s, rad/s] within 30 steps after restoring."""


def test_pybullet_restores_the_state_exactly_and_the_run_nearly() -> None:
    with World(engine="pybullet") as world:
        fleet = world.spawn_fleet("box_bot", count=3)
        fleet.drive(0.3, [0.1, 0.2, 0.3])
        world.run_for(0.5)
        snapshot, saved = world.snapshot(), world.state_hash()
        states = []
        for _ in range(4):
            world.step(30)
            states.append(np.concatenate([fleet.poses(), fleet.twists()], axis=1))
            world.restore(snapshot)
            assert world.state_hash() == saved

        assert np.abs(states[1] - states[0]).max() < BULLET_DIFFERENCE
        assert np.array_equal(states[1], states[2])
        assert np.array_equal(states[1], states[3])


CRATE = """<sdf version="1.9"><model name="crate"><static>true</static><link name="l">
<collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>
</link></model></sdf>"""


@pytest.mark.parametrize("name", ["walls", "empty"])
def test_pybullet_restores_static_bodies_as_often_as_asked(name: str, tmp_path: Path) -> None:
    file = tmp_path / "crate.sdf"
    file.write_text(CRATE, encoding="utf-8")
    hashes = set()
    with World(name, engine="pybullet") as world:
        names = world.spawn_fleet("box_bot", count=3).names
        world.spawn(file, name="crate", x=3.0)
        snapshot = world.snapshot()
        for change in ("none", "deleted", "moved"):
            if change == "deleted":
                world.delete("crate")
            elif change == "moved":
                world.entities["crate"].set_pose(9.0, 9.0)
            world.fleet(names).drive(0.3, 0.1)
            world.run_for(1.0)
            world.restore(snapshot)
            world.fleet(names).drive(0.3, 0.2)
            world.run_for(1.0)
            hashes.add(world.state_hash())
            assert world.entities["crate"].pose.x == pytest.approx(3.0)
            world.restore(snapshot)

    assert len(hashes) == 1


def test_pybullet_refuses_to_restore_after_a_spawn_and_leaves_the_world_as_it_is() -> None:
    with World(engine="pybullet") as world:
        world.spawn("box_bot", name="r1")
        snapshot = world.snapshot()
        world.spawn("box_bot", name="r2", x=2.0)
        before = world.state_hash()

        with pytest.raises(Unsupported) as refused:
            world.restore(snapshot)

        assert refused.value.slug == "not_restorable"
        assert world.state_hash() == before
        assert _run(world)


def test_state_of_pybullet_does_not_go_to_another_world() -> None:
    with World(engine="pybullet") as world, World(engine="pybullet") as other:
        with pytest.raises(Invalid):
            other.restore(world.snapshot())
        with pytest.raises(Unsupported):
            world.fork()


def test_fork_goes_on_alone_with_equal_bits() -> None:
    with World(seed=3) as world:
        world.spawn_fleet("box_bot", count=3).drive(0.3, 0.2)
        world.run_for(0.3)

        with world.fork() as other:
            expected = _run(world)
            assert _run(other) == expected
            other.spawn("box_bot", name="only_here", x=5.0)
            with pytest.raises(NotFound):
                world.robots["only_here"]


def test_snapshot_goes_to_another_process() -> None:
    program = (
        "import sys, pickle, zensim\n"
        "world = zensim.World()\n"
        "world.restore(pickle.load(sys.stdin.buffer))\n"
        "world.step(30)\n"
        "print(world.state_hash())\n"
    )
    with World() as world:
        world.spawn_fleet("box_bot", count=2).drive(0.3, 0.2)
        world.run_for(0.3)
        snapshot = world.snapshot()
        world.step(30)
        done = subprocess.run(
            [sys.executable, "-c", program],
            input=pickle.dumps(snapshot),
            capture_output=True,
            check=True,
            timeout=60,
        )
        assert done.stdout.decode().strip() == world.state_hash()


def test_subscriptions_stay_and_get_the_messages_of_the_restored_run() -> None:
    with World() as world:
        robot = world.spawn("box_bot", name="r1")
        stamps: list[float] = []
        robot.on("odom")(lambda odom: stamps.append(odom.header.stamp.sec))
        robot.drive(0.2, 0.0)
        world.run_for(1.5)
        snapshot = world.snapshot()
        world.run_for(1.0)
        count = len(stamps)

        world.restore(snapshot)
        world.run_for(1.0)

        assert len(stamps) > count
        assert stamps[count] == 1


def test_messages_of_the_abandoned_future_are_gone_after_restore() -> None:
    with World() as world:
        robot = world.spawn("box_bot", name="r1")
        fleet = world.fleet(["r1"])
        fleet.odometry()
        world.run_for(0.5)
        snapshot = world.snapshot()
        odom, text = robot.topic("odom"), robot.topic("robot_description").latest
        odom.on(lambda _: None)
        world.run_for(1.0)
        fleet.odometry()

        world.restore(snapshot)

        assert odom.latest is None
        assert np.isnan(fleet.odometry().times).all()
        assert robot.topic("robot_description").latest is text
        world.run_for(0.1)
        assert odom.newest().header.stamp.sec == 0
        assert fleet.odometry().times[0] == pytest.approx(0.6, abs=0.05)


@pytest.mark.parametrize(
    "change", [lambda _: b"", lambda _: b"nonsense", lambda one: one[:-1], lambda one: one[::-1]]
)
def test_bytes_that_are_no_snapshot_are_refused(change: Callable[[bytes], bytes]) -> None:
    with World() as world:
        world.spawn("box_bot", name="r1")
        snapshot = world.snapshot()
        with pytest.raises(Invalid) as refused:
            world.restore(change(snapshot))
        assert refused.value.slug == "wrong_snapshot"
        assert np.isfinite(world.robots["r1"].pose.x)


def test_snapshot_of_another_engine_is_refused() -> None:
    with World(engine="pybullet") as other, World() as world, pytest.raises(Invalid):
        world.restore(other.snapshot())


def test_view_follows_the_world_and_sets_what_is_written() -> None:
    with World() as world:
        robot = world.spawn("box_bot", name="r1")
        view = world.view
        poses = view.poses
        robot.drive(0.3, 0.0)
        world.run_for(1.0)
        assert poses[0, 0] == robot.pose.x > 0.1

        poses[0, :2] = 3.0, 4.0
        world.step(3)

        assert world.view is view
        assert robot.pose.x == pytest.approx(3.0, abs=0.05)
        assert robot.pose.y == pytest.approx(4.0, abs=0.05)
        world.spawn("box_bot", name="r2")
        assert list(world.view.names) == ["r1", "r2"]


def test_view_sets_joints_and_velocities() -> None:
    with World() as world:
        world.spawn("box_bot", name="r1")
        view = world.view
        view.velocities[0, 2] = 3.0
        view.joint_positions[:] = 0.5
        world.step(1)
        assert view.velocities[0, 2] > 2.0
        assert view.joint_positions == pytest.approx(0.5, abs=0.1)


def test_view_with_numbers_that_are_not_finite_is_refused() -> None:
    with World() as world:
        world.spawn("box_bot", name="r1")
        world.view.poses[0, 0] = np.nan
        with pytest.raises(Invalid):
            world.step()


@pytest.mark.parametrize(
    ("kind", "value"),
    [("sensor_stuck", 0.0), ("sensor_slow", 3.0), ("sensor_delay", 0.25), ("sensor_noise", 0.1)],
)
def test_faults_go_on_as_before_after_restore(kind: TopicFaultKind, value: float) -> None:
    with World("walls", seed=3) as world:
        robot = world.spawn("box_bot_lidar", name="r1")
        scans: list[tuple[int, bytes]] = []

        @robot.on("scan", queue=100)
        def keep(scan: LaserScan) -> None:
            scans.append((scan.header.stamp.nanosec, np.asarray(scan.ranges).tobytes()))

        robot.drive(0.3, 0.1)
        world.inject("r1", kind, "lidar", value=value, seconds=1.2)
        world.inject("r1", "wheel_slip", "left_wheel_joint", value=0.05, seconds=1.0)
        world.run_for(0.65)
        snapshot = world.snapshot()
        runs = []
        for _ in range(3):
            scans.clear()
            world.run_for(1.2)
            runs.append((world.state_hash(), tuple(scans)))
            world.restore(snapshot)

        assert runs[0][1]
        assert runs[1] == runs[0]
        assert runs[2] == runs[0]


def test_fault_that_is_injected_after_a_snapshot_is_gone_after_restore() -> None:
    with World() as world:
        robot = world.spawn("box_bot", name="r1")
        robot.drive(0.3, 0.0)
        world.run_for(0.3)
        snapshot = world.snapshot()
        expected = _run(world, 200)
        world.restore(snapshot)
        world.inject("r1", "wheel_jam", "left_wheel_joint")
        assert _run(world, 200) != expected

        world.restore(snapshot)

        assert _run(world, 200) == expected


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_every_shipped_model_is_saved_and_restored(engine: str) -> None:
    with World(engine=engine) as world:
        for number, model in enumerate(world.models()):
            world.spawn(model, y=3.0 * number)
        for robot in world.robots.values():
            robot.drive(0.2, 0.1)
        world.run_for(0.3)
        snapshot, saved = world.snapshot(), world.state_hash()
        world.step(30)
        first = world.state_hash()
        hashes = []
        for _ in range(2):
            world.restore(snapshot)
            assert world.state_hash() == saved
            world.step(30)
            hashes.append(world.state_hash())

        assert hashes[0] == hashes[1]
        assert engine == "pybullet" or hashes[0] == first
