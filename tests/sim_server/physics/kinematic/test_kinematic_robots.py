"""Motions of kinematic robots agree with closed forms and with full dynamics."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.models import a_body, a_box, a_box_bot, a_cart, a_fork, a_state, box_bot_at
from tests.sim_server.physics.kinematic.tiered_worlds import (
    heading,
    places,
    shipped,
    steps,
    two_tiers,
    with_dynamics,
)
from zensim.proto.messages.drive_messages import DiffDrive, JointTargetKind
from zensim.proto.messages.model_messages import Joint, JointController, Link, Mimic, Model, Shape
from zensim.sim_server.physics.engine import EngineRefused
from zensim.sim_server.physics.kinematic.kinematic_robots import (
    compute_rolling_speeds,
    compute_steered_twists,
    integrate_arcs,
)
from zensim.sim_server.physics.kinematic.planar_vehicle import (
    NotPlanar,
    PlanarVehicle,
    make_mesh_reader,
    make_planar_vehicle,
)

RADIUS_M = 0.09
"""Of the disc of a box_bot."""


def a_wall(length: float = 10.0, height: float = 1.0) -> Model:
    shape = Shape("box", (0.02, length, height))
    return Model("wall", (Link("base", collisions=(shape,)),), is_static=True)


def test_robot_drives_the_circle_of_its_wheel_speeds() -> None:
    with two_tiers("kinematic") as engine:
        body = engine.add(a_box_bot(), box_bot_at(1.0, 2.0, 0.4))
        engine.command((body,), np.array([8.0, 11.0]))
        steps(engine, 50)
        (x, y), yaw = places(engine, [body])[0], heading(engine, body)

        steps(engine, 300)

        ahead, turn = 9.5 * 0.035, 3.0 * 0.035 / 0.11
        end = yaw + turn * 3.0
        radius = ahead / turn
        assert places(engine, [body])[0] == pytest.approx(
            [
                x + radius * (math.sin(end) - math.sin(yaw)),
                y - radius * (math.cos(end) - math.cos(yaw)),
            ],
            abs=1e-9,
        )
        reading = engine.read((body,))
        assert reading.base[0, 7:9] == pytest.approx([ahead * math.cos(end), ahead * math.sin(end)])
        assert reading.joint_velocities.tolist() == [8.0, 11.0]


@pytest.mark.parametrize(
    ("name", "targets"),
    [
        ("box_bot", [10.0, 14.0]),
        ("skid_bot", [6.0, 9.0, 6.0, 9.0]),
        ("car_bot", [7.0, 9.0, 0.45, 0.35]),
        ("omni_bot", [0.4, 0.2, 0.5]),
    ],
)
def test_robot_moves_like_one_with_full_dynamics(name: str, targets: list[float]) -> None:
    model = shipped(name)
    with two_tiers("kinematic", step_ns=4_166_667) as engine:
        height = {"box_bot": 0.06, "skid_bot": 0.06, "car_bot": 0.05, "omni_bot": 0.05}[name]
        flat = engine.add(model, a_state((0.0, 0.0, height)))
        full = engine.add(with_dynamics(model, "full"), a_state((0.0, 50.0, height)))

        engine.command((flat, full), np.array([*targets, *targets]))
        steps(engine, 480)

        gone = places(engine, [flat, full]) - [[0.0, 0.0], [0.0, 50.0]]
        assert gone[0] == pytest.approx(gone[1], abs=0.05)
        assert heading(engine, flat) == pytest.approx(heading(engine, full), abs=0.12)


def test_robot_keeps_its_height_and_tilt() -> None:
    with two_tiers("kinematic") as engine:
        body = engine.add(a_box_bot(), a_state((0.0, 0.0, 3.0), turn=(0.1, 0.2, 0.3)))
        engine.command((body,), np.array([8.0, 8.0]))

        steps(engine, 100)

        assert engine.read((body,)).base[0, 2] == 3.0
        assert engine.read((body,)).base[0, 3:7] == pytest.approx(
            a_state(turn=(0.1, 0.2, 0.3))[3:7], abs=1e-12
        )


def test_motors_accelerate_within_their_limits() -> None:
    with two_tiers("kinematic") as engine:
        body = engine.add(a_box_bot(), box_bot_at())
        engine.command((body,), np.array([28.0, 28.0]))

        engine.step()

        speed = float(engine.read((body,)).base[0, 7])
        assert 0.0 < speed < 0.05 * 28.0 * 0.035


def test_robots_and_wheels_stop_before_a_collision() -> None:
    with two_tiers("kinematic") as engine:
        left = engine.add(a_box_bot(), box_bot_at(0.0))
        right = engine.add(a_box_bot(), box_bot_at(1.0, 0.0, math.pi))
        engine.command((left, right), np.full(4, 10.0))

        steps(engine, 400)

        gap = float(np.diff(places(engine, [left, right])[:, 0])[0])
        reading = engine.read((left, right))
        assert 2.0 * RADIUS_M <= gap < 2.0 * RADIUS_M + 0.003
        assert not reading.base[:, 7:].any()
        turned = reading.joint_positions
        steps(engine, 50)
        assert engine.read((left, right)).joint_positions == pytest.approx(turned, abs=1e-3)


def test_stopped_robot_can_reverse() -> None:
    with two_tiers("kinematic") as engine:
        engine.add(a_wall(), a_state((1.0, 0.0, 0.5)))
        body = engine.add(a_box_bot(), box_bot_at())
        engine.command((body,), np.full(2, 10.0))
        steps(engine, 400)
        stopped = places(engine, [body])[0, 0]

        engine.command((body,), np.full(2, -10.0))
        steps(engine, 200)

        assert stopped == pytest.approx(1.0 - 0.01 - RADIUS_M, abs=0.003)
        assert places(engine, [body])[0, 0] < stopped - 0.5


@pytest.mark.parametrize("speed", [1.0, 30.0, 1e3, 1e5])
@pytest.mark.parametrize("step_ns", [1_000_000, 20_000_000, 1_000_000_000])
def test_robot_does_not_pass_through_a_wall_or_robot_at_any_speed(
    speed: float, step_ns: int
) -> None:
    with two_tiers("kinematic", step_ns=step_ns) as engine:
        engine.add(a_wall(), a_state((3.0, 0.0, 0.5)))
        engine.add(a_box_bot(), box_bot_at(-3.0))
        driver = with_dynamics(shipped("omni_bot"), "kinematic")
        body = engine.add(driver, a_state((0.0, 0.0, 0.05)))

        for way in (speed, -speed):
            engine.command((body,), np.array([way, 0.0, 0.0]))
            for _ in range(60):
                engine.step()
                assert -3.0 < places(engine, [body])[0, 0] < 3.0


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_robots_of_a_crowd_never_overlap(seed: int) -> None:
    draw = np.random.default_rng(seed)
    with two_tiers("kinematic", step_ns=20_000_000) as engine:
        bodies = [
            engine.add(
                a_box_bot(), box_bot_at(0.25 * (i % 7), 0.25 * (i // 7), draw.uniform(-3, 3))
            )
            for i in range(42)
        ]
        one, other = np.triu_indices(len(bodies), 1)
        for _ in range(40):
            engine.command(tuple(bodies), draw.uniform(-30.0, 30.0, 2 * len(bodies)))
            steps(engine, 5)
            at = places(engine, bodies)
            assert np.hypot(*(at[one] - at[other]).T).min() >= 2.0 * RADIUS_M - 1e-6


@pytest.mark.parametrize("speed", [10.0, 30.0])
def test_robot_stops_before_bodies_of_the_full_engine(speed: float) -> None:
    with two_tiers("kinematic") as engine:
        box = engine.add(a_box(), a_state((1.0, 0.0, 0.1)))
        other = engine.add(with_dynamics(a_box_bot(), "full"), box_bot_at(0.0, 5.0, -math.pi / 2.0))
        bodies = [engine.add(a_box_bot(), box_bot_at(x)) for x in (0.0, -1.0)]
        engine.command((other, *bodies), np.array([speed, speed, speed, speed, -speed, -speed]))

        for _ in range(300):
            engine.step()
            at = places(engine, [box, other, *bodies])
            assert np.hypot(*(at[2] - at[0])) > 0.05 + 0.1

        assert engine.read((box,)).base[0, :3] == pytest.approx([1.0, 0.0, 0.1], abs=1e-3)
        assert not engine.read((bodies[0],)).base[0, 7:].any()
        assert places(engine, bodies)[1, 0] < -1.2


def test_robot_stays_behind_a_slower_full_robot() -> None:
    with two_tiers("kinematic") as engine:
        leader = engine.add(with_dynamics(a_box_bot(), "full"), box_bot_at(0.5))
        follower = engine.add(a_box_bot(), box_bot_at())
        engine.command((leader, follower), np.array([4.0, 4.0, 14.0, 14.0]))

        for _ in range(500):
            engine.step()
            gap = float(np.diff(places(engine, [follower, leader])[:, 0])[0])
            assert gap > 0.1

        assert places(engine, [follower])[0, 0] > 0.5


def test_robot_drives_over_low_and_under_high_obstacles() -> None:
    with two_tiers("kinematic") as engine:
        engine.add(a_wall(height=0.01), a_state((0.5, 0.0, 0.0)))
        engine.add(a_wall(), a_state((0.7, 0.0, 0.7)))
        body = engine.add(a_box_bot(), box_bot_at())
        engine.command((body,), np.full(2, 10.0))

        steps(engine, 500)

        assert places(engine, [body])[0, 0] > 1.2


def test_kinematic_model_without_a_drive_is_refused() -> None:
    with two_tiers("full") as engine:
        with pytest.raises(EngineRefused):
            engine.add(with_dynamics(a_box(), "kinematic"), a_state())
        halved = a_box_bot()
        assert isinstance(halved.drive, DiffDrive)

        first = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))

        assert first == 0


def test_models_without_a_drive_are_full_in_a_kinematic_world() -> None:
    with two_tiers("kinematic") as engine:
        box, robot = (
            engine.add(a_box(), a_state((0.0, 0.0, 1.0))),
            engine.add(a_box_bot(), box_bot_at(5.0)),
        )

        assert (engine.tier_of(box), engine.tier_of(robot)) == ("full", "kinematic")
        steps(engine, 200)
        assert engine.read((box,)).base[0, 2] == pytest.approx(0.1, abs=0.002)


speeds = st.floats(-3.0, 3.0)
turns = st.floats(-40.0, 40.0)
angles = st.floats(-math.pi, math.pi)


def vehicle(name: str) -> PlanarVehicle:
    return make_planar_vehicle(shipped(name), make_mesh_reader(""), 9.81)[0]


def an_arc(yaw: float, twist: tuple[float, float, float], dt_s: float) -> np.ndarray:
    heading = (np.array([math.cos(yaw)]), np.array([math.sin(yaw)]))
    return integrate_arcs(heading, np.array(twist)[:, None], dt_s)[:, 0]


@given(yaw=angles, ahead=speeds, left=speeds, turn=turns, dt_s=st.floats(0.001, 0.1))
def test_arc_is_the_limit_of_many_small_steps(
    yaw: float, ahead: float, left: float, turn: float, dt_s: float
) -> None:
    count = 20_000
    middles = yaw + turn * dt_s * (np.arange(count) + 0.5) / count
    x = np.sum(ahead * np.cos(middles) - left * np.sin(middles)) * dt_s / count
    y = np.sum(ahead * np.sin(middles) + left * np.cos(middles)) * dt_s / count

    found = an_arc(yaw, (ahead, left, turn), dt_s)

    assert found == pytest.approx([x, y, turn * dt_s], abs=1e-6)


@given(ahead=speeds, turn=st.floats(-1e-4, 1e-4))
def test_arc_is_continuous_at_zero_yaw_rate(ahead: float, turn: float) -> None:
    found = an_arc(0.0, (ahead, 0.0, turn), 0.02)

    assert found == pytest.approx(
        [ahead * 0.02, ahead * turn * 0.02**2 / 2.0, turn * 0.02], abs=1e-12
    )


def test_two_wheels_give_the_twist_of_a_differential_drive() -> None:
    model = make_planar_vehicle(a_cart(), make_mesh_reader(""), 9.81)[0]

    found = np.array(model.matrix).reshape(3, 2) @ [4.0, 6.0]

    assert found == pytest.approx([5.0 * 0.05, 0.0, 2.0 * 0.05 / 0.3], abs=1e-12)


def test_car_turns_about_the_intersection_of_its_axles() -> None:
    model = vehicle("car_bot")
    curvature, ahead, radius, base, half = 1.2, 0.5, 0.05, 0.3, 0.1
    inner = np.arctan2(base * curvature, 1.0 - curvature * half)
    outer = np.arctan2(base * curvature, 1.0 + curvature * half)
    rims = ahead * np.array([[1.0 - curvature * half, 1.0 + curvature * half]]) / radius

    twist = compute_steered_twists(model, rims, np.array([[inner, outer]]))
    rolling = compute_rolling_speeds(model, twist, np.array([[inner, outer]]))[0]

    turn = ahead * curvature
    assert twist[:, 0] == pytest.approx([ahead, turn * 0.15, turn], abs=1e-9)
    left, right = (math.hypot(base, 1.0 / curvature - y) * turn / radius for y in (half, -half))
    assert rolling == pytest.approx([left, right], rel=1e-9)


@given(angle=st.floats(-math.pi / 2.0, math.pi / 2.0), rim=st.floats(0.1, 2.0))
def test_tricycle_follows_its_front_wheel(angle: float, rim: float) -> None:
    model = vehicle("trike_bot")

    twist = compute_steered_twists(model, np.array([[rim / 0.05]]), np.array([[angle]]))[:, 0]

    turn = rim * math.sin(angle) / 0.3
    assert twist == pytest.approx([rim * math.cos(angle), turn * 0.1, turn], abs=1e-6)


def test_followers_of_a_mimic_follow_chains_of_joints() -> None:
    bot = a_box_bot()
    base = bot.links[0].name
    mimics = {"pan": None, "first": Mimic("pan", -0.5, 0.2), "second": Mimic("first", 2.0, 0.1)}
    joints = tuple(
        Joint(
            *(name, "revolute", base, f"{name}_link"),
            lower=-2.0,
            upper=2.0,
            effort=5.0,
            velocity=9.0,
            mimic=mimic,
        )
        for name, mimic in mimics.items()
    )
    model = msgspec.structs.replace(
        bot,
        links=(*bot.links, *(Link(joint.child, a_body(0.1)) for joint in joints)),
        joints=(*bot.joints, *joints),
        joint_controllers=(JointController("c", ("pan",)),),
    )
    with two_tiers("kinematic") as engine:
        body = engine.add(model, box_bot_at())
        engine.command((body,), np.array([0.0, 0.0, JointTargetKind.POSITION, 1.0]))
        steps(engine, 100)
        positions = engine.read((body,)).joint_positions

    assert positions[len(bot.joints) :] == pytest.approx([1.0, -0.3, -0.5])


@pytest.mark.parametrize("model", [a_box(), a_fork()], ids=["without a drive", "static"])
def test_model_that_cannot_drive_in_the_plane_has_no_vehicle(model: Model) -> None:
    with pytest.raises(NotPlanar):
        make_planar_vehicle(model, make_mesh_reader(""), 9.81)
