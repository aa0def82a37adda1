"""The contract of `Simulation`: the same cases for a world in process and for a server."""

import inspect
import math
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zensim
from zensim.api.expectations import RobotExpectation
from zensim.proto.messages.standard_messages import Float64MultiArray, JointState, Odometry, Twist

NAN, INF = math.nan, math.inf
EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture(scope="module")
def world() -> Iterator[zensim.World]:
    with zensim.World() as made:
        yield made


@pytest.fixture(params=["world", "server"])
def simulation(request: pytest.FixtureRequest) -> zensim.Simulation:
    """A paused, empty simulation of each kind."""
    found: zensim.Simulation = request.getfixturevalue(request.param)
    if isinstance(found, zensim.Sim):
        found.pause()
    found.reset()
    return found


@pytest.fixture
def robot(simulation: zensim.Simulation) -> zensim.Robot:
    return simulation.spawn("box_bot", name="r1")


Act = Callable[[zensim.Simulation, zensim.Robot], object]
Case = tuple[str, Act, type[zensim.Error]]


def of_robot(method: str, *arguments: object, **keywords: object) -> Act:
    """Make the call of a method of the robot."""
    return lambda _, robot: getattr(robot, method)(*arguments, **keywords)


def of_simulation(method: str, *arguments: object, **keywords: object) -> Act:
    """Make the call of a method of the simulation; of an iterator the first item counts."""

    def act(sim: zensim.Simulation, _: zensim.Robot) -> object:
        found = getattr(sim, method)(*arguments, **keywords)
        return next(found, None) if isinstance(found, Iterator) else found

    return act


def look_up(mapping: str, name: str) -> Act:
    """Make the lookup of a name."""
    return lambda sim, _: getattr(sim, mapping)[name]


def list_wrong_twists() -> Iterator[Case]:
    for number in (NAN, INF, -INF):
        for place in ("v", "w", "left"):
            order = {place: number}
            yield (f"drive {place}={number}", of_robot("drive", **order), zensim.Invalid)


def list_wrong_poses() -> Iterator[Case]:
    for number in (NAN, INF, -INF):
        for place in range(3):
            row = [0.0, 0.0, 0.1]
            row[place] = number
            yield (f"set_pose {place}={number}", of_robot("set_pose", *row), zensim.Invalid)


def list_wrong_paths() -> Iterator[Case]:
    for points in ((), (1.0, 2.0), ((1.0,),), ((1.0, 2.0, 3.0),), ((NAN, 0.0),), ((0.0, INF),)):
        yield (f"follow {points}", of_robot("follow", points), zensim.Invalid)
    for speed in (0.0, -1.0, NAN, INF, 1e9):
        yield (
            f"follow speed={speed}",
            of_robot("follow", [(1.0, 0.0)], speed=speed),
            zensim.Invalid,
        )


def list_wrong_times() -> Iterator[Case]:
    for seconds in (NAN, -1.0, INF, 1e9):
        yield (f"run_for {seconds}", of_simulation("run_for", seconds), zensim.Invalid)
    for time in (NAN, -1.0, INF):
        yield f"run_to {time}", of_simulation("run_to", time), zensim.Invalid
    for count in (0, -1, -(10**9)):
        yield f"step {count}", of_simulation("step", count), zensim.Invalid
    for rate in (0.0, -1.0, 7.0, 1e9, NAN):
        yield (f"steps rate={rate}", of_simulation("steps", seconds=0.1, rate=rate), zensim.Invalid)


def list_wrong_rays() -> Iterator[Case]:
    rays = {
        "shapes": ([(0, 0, 1)], [(0, 0)]),
        "flat": ([0.0], [1.0]),
        "not a number": ([(NAN, 0, 1)], [(1, 0, 0)]),
        "infinite": ([(0, 0, 1)], [(INF, 0, 0)]),
        "no rows": ([(0, 0, 1)] * 2, [(1, 0, 0)]),
    }
    for name, (origins, directions) in rays.items():
        yield (f"cast_rays {name}", of_simulation("cast_rays", origins, directions), zensim.Invalid)


def list_unknown_names() -> Iterator[Case]:
    for name in ("r9", "", "R1", "r1 ", "r1/odom", "*", "é" * 40):
        yield f"robots[{name!r}]", look_up("robots", name), zensim.NotFound
        yield f"entities[{name!r}]", look_up("entities", name), zensim.NotFound
        yield f"delete({name!r})", of_simulation("delete", name), zensim.NotFound
        yield f"topic({name!r})", of_robot("topic", name), zensim.NotFound
    for model in ("no_such_robot.urdf", "./missing.sdf", "a/b/c.xacro"):
        yield f"spawn {model}", of_simulation("spawn", model), zensim.NotFound
        yield f"check {model}", of_simulation("check", model), zensim.NotFound


def list_wrong_new_names() -> Iterator[Case]:
    for name in ("a b", "/x", "a//b", "x" * 500, "9", "é"):
        yield (
            f"spawn name={name[:8]!r}",
            of_simulation("spawn", "box_bot", name=name),
            zensim.Invalid,
        )
    yield "spawn taken", of_simulation("spawn", "box_bot", name="r1"), zensim.SpawnRefused


def list_wrong_words() -> Iterator[Case]:
    for name, word in (("dynamics", "foo"), ("compat", "x"), ("dynamics", 3)):
        act = of_simulation("spawn", "box_bot", **{name: word})
        yield f"spawn {name}={word}", act, zensim.Invalid
    yield "spawn_fleet(2, model)", of_simulation("spawn_fleet", 2, "box_bot"), zensim.Invalid
    yield "on spawnd", of_simulation("on", "spawnd"), zensim.NotFound
    yield "on no function", lambda _, robot: robot.on("odom")(3), zensim.Invalid  # type: ignore[arg-type]
    yield "fleet text", of_simulation("fleet", "r1"), zensim.Invalid
    yield "robots[3]", lambda sim, _: sim.robots[3], zensim.NotFound  # type: ignore[index]
    yield "run_for text", of_simulation("run_for", "1"), zensim.Invalid


def list_waits_without_end() -> Iterator[Case]:
    never = of_simulation("wait_until", lambda: False, NAN)
    yield "wait_until within=nan", never, zensim.Invalid
    for timeout_s in (NAN, -1.0):
        wait = of_simulation("wait_until", lambda: False, timeout_s=timeout_s)
        yield f"wait_until timeout_s={timeout_s}", wait, zensim.Invalid
        yield f"read timeout_s={timeout_s}", read_odometry(timeout_s), zensim.Invalid


def expect_to(method: str, *arguments: object, **keywords: object) -> Act:
    return lambda sim, robot: getattr(RobotExpectation(sim, robot), method)(*arguments, **keywords)


def list_wrong_expectations() -> Iterator[Case]:
    for point in ((NAN, 0.0), (1.0,), "ab"):
        yield f"to_reach {point}", expect_to("to_reach", point), zensim.Invalid
    for number in (NAN, -1.0):
        limits = {"tolerance": number}
        yield f"to_reach {limits}", expect_to("to_reach", (9.0, 9.0), **limits), zensim.Invalid
        yield f"to_stop {number}", expect_to("to_stop", speed=number), zensim.Invalid


def read_odometry(timeout_s: float) -> Act:
    return lambda _, robot: robot.topic("odom").read(after=1e9, timeout_s=timeout_s)


CASES = tuple(
    case
    for listed in (
        list_wrong_twists,
        list_wrong_poses,
        list_wrong_paths,
        list_wrong_times,
        list_wrong_rays,
        list_unknown_names,
        list_wrong_new_names,
        list_wrong_words,
        list_waits_without_end,
        list_wrong_expectations,
    )
    for case in listed()
)


@pytest.mark.parametrize(("act", "kind"), [case[1:] for case in CASES], ids=[c[0] for c in CASES])
def test_a_wrong_argument_raises_its_error_and_changes_nothing(
    simulation: zensim.Simulation, robot: zensim.Robot, act: Act, kind: type[zensim.Error]
) -> None:
    before = simulation.state_hash()

    with pytest.raises(kind) as raised:
        act(simulation, robot)

    error = raised.value
    assert error.slug
    assert error.message
    assert pickle.loads(pickle.dumps(error)).slug == error.slug
    assert simulation.state_hash() == before


GONE: dict[str, Callable[[zensim.Robot], object]] = {
    "pose": lambda robot: robot.pose,
    "twist": lambda robot: robot.twist,
    "namespace": lambda robot: robot.namespace,
    "agent": lambda robot: robot.agent,
    "odom": lambda robot: robot.odom,
    "joints": lambda robot: robot.joints,
    "sensors": lambda robot: robot.sensors,
    "drive": lambda robot: robot.drive(0.1),
    "stop": lambda robot: robot.stop(),
    "follow": lambda robot: robot.follow([(1.0, 0.0)]),
    "set_pose": lambda robot: robot.set_pose(0.0, 0.0),
    "delete": lambda robot: robot.delete(),
    "topic": lambda robot: robot.topic("odom"),
}


@pytest.mark.parametrize("act", GONE.values(), ids=GONE)
def test_a_handle_of_a_deleted_robot_raises(
    simulation: zensim.Simulation, robot: zensim.Robot, act: Callable[[zensim.Robot], object]
) -> None:
    simulation.delete("r1")

    assert not robot.exists
    with pytest.raises(zensim.NotFound):
        act(robot)


VALUES: dict[str, tuple[Callable[[zensim.Simulation], Any], type]] = {
    "time": (lambda sim: sim.time, float),
    "epoch": (lambda sim: sim.epoch, int),
    "step_period": (lambda sim: sim.step_period, float),
    "control_period": (lambda sim: sim.control_period, float),
    "is_paused": (lambda sim: sim.is_paused, bool),
    "seed": (lambda sim: sim.seed, int),
    "state_hash": (lambda sim: sim.state_hash(), str),
    "models": (lambda sim: sim.models(), tuple),
    "worlds": (lambda sim: sim.worlds(), tuple),
    "html": (lambda sim: sim._repr_html_(), str),
}


@pytest.mark.parametrize(("read", "kind"), VALUES.values(), ids=VALUES)
def test_a_property_has_its_type(
    simulation: zensim.Simulation, read: Callable[[zensim.Simulation], Any], kind: type
) -> None:
    assert isinstance(read(simulation), kind)


def test_time_moves_only_by_steps(simulation: zensim.Simulation, robot: zensim.Robot) -> None:
    assert robot.exists
    assert simulation.is_paused

    simulation.step(5)
    simulation.run_for(0.5)
    simulation.run_to(1.0)

    assert simulation.time == pytest.approx(1.0, abs=simulation.step_period)


def test_an_interrupted_run_can_go_on(simulation: zensim.Simulation, robot: zensim.Robot) -> None:
    robot.drive(0.2)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        simulation.run_for(1e5)
    timer.join()
    before = simulation.time

    simulation.run_for(0.5)

    assert simulation.time >= before + 0.5 - simulation.step_period
    assert robot.twist.v == pytest.approx(0.2, abs=0.05)


def test_an_order_holds_until_stop(simulation: zensim.Simulation, robot: zensim.Robot) -> None:
    robot.drive(0.3)
    simulation.run_for(3.0)
    driven = robot.pose.x
    robot.stop()
    simulation.run_for(1.0)

    assert driven == pytest.approx(0.9, abs=0.06)
    assert robot.twist.speed < 1e-3


def test_a_fleet_has_rows_that_stay(simulation: zensim.Simulation) -> None:
    fleet = simulation.spawn_fleet("box_bot", count=4)

    fleet.drive(v=0.2, w=np.linspace(0.0, 0.3, 4))
    simulation.run_for(1.0)
    simulation.delete(fleet.names[1])

    assert fleet.alive.tolist() == [True, False, True, True]
    assert np.isnan(fleet.poses()[1]).all()
    assert np.isfinite(fleet.poses()[[0, 2, 3]]).all()
    with pytest.raises(ValueError, match="read-only"):
        fleet.poses()[0] = 0.0


def test_a_fleet_has_the_odometry_of_all_its_robots(simulation: zensim.Simulation) -> None:
    fleet = simulation.spawn_fleet("box_bot", count=4, spacing=2.0)
    before = fleet.odometry()

    fleet.drive(v=0.2, w=np.linspace(0.0, 0.3, 4))
    simulation.run_for(1.0)
    seen = fleet.odometry()

    assert np.isnan(before.times).all()
    assert seen.times == pytest.approx(np.full(4, simulation.time), abs=0.1)
    assert seen.twists[:, 0] == pytest.approx(np.full(4, 0.2), abs=0.02)
    assert seen.twists[:, 5] == pytest.approx(np.linspace(0.0, 0.3, 4), abs=0.03)
    one = fleet[2].odom
    assert seen.poses[2, :2] == pytest.approx(
        (one.pose.pose.position.x, one.pose.pose.position.y), abs=0.05
    )
    assert np.isnan(fleet[:0].odometry().poses).sum() == 0
    with pytest.raises(ValueError, match="read-only"):
        seen.poses[0] = 0.0


@pytest.mark.parametrize("shape", [(3,), (5,), (4, 2), (2, 4)])
def test_a_wrong_shape_of_a_fleet_is_invalid(
    simulation: zensim.Simulation, shape: tuple[int, ...]
) -> None:
    fleet = simulation.spawn_fleet("box_bot", count=4)

    with pytest.raises(zensim.Invalid):
        fleet.drive(v=np.zeros(shape))


def test_wait_until_returns_at_the_time_or_raises_with_it(
    simulation: zensim.Simulation, robot: zensim.Robot
) -> None:
    robot.drive(0.3)

    at = simulation.wait_until(lambda: robot.pose.x > 0.2, within=5.0)
    with pytest.raises(zensim.Timeout):
        simulation.wait_until(lambda: False, within=0.1)

    assert 0.5 < at < 2.0


def test_reset_deletes_what_was_spawned_and_starts_an_epoch(
    simulation: zensim.Simulation, robot: zensim.Robot
) -> None:
    before = simulation.epoch
    simulation.run_for(0.1)

    simulation.reset()

    assert (simulation.time, len(simulation.entities)) == (0.0, 0)
    assert simulation.epoch > before
    assert not robot.exists


def test_odometry_is_that_of_the_last_step(
    simulation: zensim.Simulation, robot: zensim.Robot
) -> None:
    robot.drive(0.3)
    simulation.run_for(1.0)

    assert robot.odom.twist.twist.linear.x == pytest.approx(0.3, abs=0.02)


def test_topics_of_a_robot_are_those_below_its_namespace(
    simulation: zensim.Simulation, robot: zensim.Robot
) -> None:
    for name in ("tf", "tf_static", "robot_description"):
        assert robot.topic(name).key == simulation.topic(f"{robot.name}/{name}").key


def test_callbacks_run_while_the_caller_steps(
    simulation: zensim.Simulation, robot: zensim.Robot
) -> None:
    stamps = []
    callback = robot.topic("odom").on(lambda message: stamps.append(message.header.stamp))

    simulation.run_for(0.5)
    callback.cancel()
    count = len(stamps)
    simulation.run_for(0.5)

    assert count >= 5
    assert len(stamps) == count


def test_a_fault_acts_and_ends_by_itself(
    simulation: zensim.Simulation, robot: zensim.Robot
) -> None:
    robot.drive(0.3)
    simulation.run_for(0.5)

    simulation.inject("r1", "wheel_jam", "left_wheel_joint", seconds=0.5)
    simulation.run_for(0.4)
    turned = robot.twist.w
    simulation.run_for(1.5)

    assert abs(turned) > 0.2
    assert robot.twist.v == pytest.approx(0.3, abs=0.03)
    assert abs(robot.twist.w) < 0.05


FAULTS: dict[str, tuple[tuple[str, str, str], type[zensim.Error]]] = {
    "entity": (("r9", "wheel_jam", "left_wheel_joint"), zensim.NotFound),
    "part": (("r1", "wheel_jam", "wheel"), zensim.NotFound),
    "sensor": (("r1", "sensor_off", "lidar"), zensim.NotFound),
    "kind": (("r1", "wheel_fell_off", "left_wheel_joint"), zensim.Invalid),
}


@pytest.mark.parametrize(("words", "kind"), FAULTS.values(), ids=FAULTS)
@pytest.mark.usefixtures("robot")
def test_a_fault_of_what_is_not_there_is_refused(
    simulation: zensim.Simulation, words: tuple[str, Any, str], kind: type[zensim.Error]
) -> None:
    with pytest.raises(kind):
        simulation.inject(*words)


def test_events_say_what_happened_since_their_first_use(simulation: zensim.Simulation) -> None:
    events = simulation.events
    simulation.spawn("box_bot", name="r7")
    simulation.delete("r7")

    found: list[tuple[str, str]] = []
    while not found or found[-1] != ("deleted", "r7"):
        event = events.read(timeout_s=10.0)
        found.append((event.kind, event.entity))

    assert ("spawned", "r7") in found


def test_functions_are_called_with_events_of_a_kind(simulation: zensim.Simulation) -> None:
    seen: list[tuple[str, str]] = []
    simulation.on("spawned")(lambda event: seen.append((event.kind, event.entity)))

    with simulation.temporary():
        simulation.spawn("box_bot", name="r7")
        simulation.wait_until(lambda: seen)
        assert "r7/odom" in simulation.topics()

    assert seen == [("spawned", "r7")]
    assert not simulation.entities


def test_every_listed_world_is_loaded_by_its_name(simulation: zensim.Simulation) -> None:
    names = simulation.worlds()

    assert "empty" in names
    for name in (*names, "empty"):
        simulation.load(name)


def test_a_second_fleet_of_a_model_needs_a_prefix(simulation: zensim.Simulation) -> None:
    simulation.spawn_fleet("box_bot", count=2)

    with pytest.raises(zensim.SpawnRefused) as refused:
        simulation.spawn_fleet("box_bot", poses=[[0.0, 9.0]])

    assert refused.value.slug == "name.taken"
    assert "prefix" in str(refused.value)
    assert len(simulation.entities) == 2


def test_steps_make_as_many_rounds_as_fit(simulation: zensim.Simulation) -> None:
    begin = simulation.time

    assert list(simulation.steps(0.0)) == []
    assert len(list(simulation.steps(0.1, rate=20.0))) == 2
    assert simulation.time - begin == pytest.approx(0.1)


def test_names_that_are_left_out_are_counted(simulation: zensim.Simulation) -> None:
    simulation.spawn_fleet("box_bot_lidar", count=12, prefix="own")

    with pytest.raises(zensim.NotFound, match="more"):
        simulation.robots["zzz"]


def test_check_spawns_nothing(simulation: zensim.Simulation) -> None:
    report = simulation.check("box_bot")

    assert report.drive == "diff_drive"
    assert len(simulation.entities) == 0


def test_another_world_is_loaded_and_stays_paused(simulation: zensim.Simulation) -> None:
    simulation.load("walls")
    loaded = len(simulation.entities)
    simulation.load("empty")

    assert loaded > 1
    assert simulation.is_paused


def test_a_ray_hits_a_robot(simulation: zensim.Simulation) -> None:
    simulation.spawn("box_bot", name="r1", x=2.0)

    ranges, names = simulation.cast_rays(
        [(0.0, 0.0, 0.1), (0.0, 0.0, 0.1)], [(1, 0, 0), (-1, 0, 0)]
    )

    assert 1.0 < ranges[0] < 2.0
    assert ranges[1] == INF
    assert names[0] == "r1"


def run_formation(sim: zensim.Simulation, seconds: float) -> str:
    """Drive three robots in a formation: each order depends on the state before."""
    sim.reset()
    offsets = np.array([[0.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]])
    fleet = sim.spawn_fleet("box_bot", poses=offsets)
    for now in sim.steps(seconds=seconds, rate=20):
        x, y, yaw = fleet.poses2d().T
        dx, dy = x[0] + offsets[:, 0] - x, y[0] + offsets[:, 1] - y
        fleet.drive(v=np.hypot(dx, dy).clip(0, 0.5), w=2 * np.sin(np.arctan2(dy, dx) - yaw))
        fleet[0].drive(0.2, 0.1 * np.sin(now))
    return sim.state_hash()


def test_a_world_in_process_equals_a_server_in_lockstep_after_1000_steps() -> None:
    steps = 1000
    with zensim.World(seed=1) as world:
        here = [run_formation(world, steps * world.step_period) for _ in range(2)]
    with zensim.launch(seed=1, engine="mujoco", timeout_s=120.0) as sim:
        there = run_formation(sim, steps * sim.step_period)

    assert {*here, there} == {there}


@pytest.mark.parametrize("kind", [zensim.World, zensim.Sim])
def test_every_method_of_a_simulation_has_a_docstring(kind: type[zensim.Simulation]) -> None:
    public = [
        member
        for name, member in inspect.getmembers(kind)
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, property))
    ]

    assert len(public) > 25
    assert all(inspect.getdoc(member) for member in public)


def test_a_world_in_process_does_not_run_by_itself(world: zensim.World) -> None:
    with pytest.raises(zensim.Unsupported):
        world.play()


def test_a_closed_world_refuses() -> None:
    world = zensim.World()
    robot = world.spawn("box_bot", name="r1")
    world.close()
    world.close()

    for act in (lambda: world.time, lambda: robot.pose, world.step, world.state_hash):
        with pytest.raises(zensim.Closed):
            act()


def test_joints_of_an_arm_go_where_they_are_commanded(simulation: zensim.Simulation) -> None:
    arm = simulation.spawn(EXAMPLES / "arm" / "arm_bot.urdf", name="arm")
    wanted = JointState(name=("shoulder", "elbow"), position=(0.4, -0.6))

    assert isinstance(simulation.robots["arm"], zensim.Robot)
    # An agent that has just claimed the arm may subscribe after the first command.
    for _ in range(3):
        arm.topic("joint_commands").put(wanted)
        simulation.run_for(1.0)

    found = dict(zip(arm.joints.name, arm.joints.position, strict=True))
    assert (found["shoulder"], found["elbow"]) == pytest.approx((0.4, -0.6), abs=0.01)


def test_joints_follow_numbers_for_the_controllers_of_an_arm(simulation: zensim.Simulation) -> None:
    arm = simulation.spawn(EXAMPLES / "arm" / "arm_bot.urdf", name="numbers")

    for _ in range(3):
        arm.topic("joint_commands").put(Float64MultiArray(data=(0.4, -0.6)))
        arm.topic("gripper_controller/commands").put(Float64MultiArray(data=(0.02,)))
        simulation.run_for(1.0)

    found = dict(zip(arm.joints.name, arm.joints.position, strict=True))
    assert (found["shoulder"], found["elbow"]) == pytest.approx((0.4, -0.6), abs=0.01)
    assert found["gripper"] == pytest.approx(0.02, abs=0.002)
    with pytest.raises(zensim.Invalid):
        arm.topic("gripper_controller/commands").put(JointState())


def test_topics_that_the_simulation_publishes_are_not_published(
    simulation: zensim.Simulation,
) -> None:
    robot = simulation.spawn("box_bot_lidar", name="r1")

    for name in ("odom", "joint_states", "scan"):
        topic = robot.topic(name)
        for _ in range(2):
            with pytest.raises(zensim.Invalid) as refused:
                topic.put(topic.kind())
            assert "cmd_vel" in str(refused.value)

    robot.topic("cmd_vel").put(Twist())
    simulation.topic("r1/filtered/odom").put(Odometry())
    simulation.topic("elsewhere/odom").put(Odometry())
