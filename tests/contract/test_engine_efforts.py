"""Contract of `read_joint_efforts`."""

import math
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import REAL_ENGINES, STEP_NS, MakeEngine, advance, running
from tests.faulty_engines import FaultyEngine, make_culprit
from tests.models import a_box, a_box_bot, a_cart, a_fork, a_state, an_arm, box_bot_at, on_ground
from zensim.proto.messages.model_messages import Inertial, Model
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.isolating_engine import IsolatingEngine
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.physics.sleeping_engine import SleepingEngine

GRAVITY, ARM_M, TORQUE_NM = 9.81, 0.2, 0.2
STEERING = 3


@pytest.fixture(params=REAL_ENGINES, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def a_held_arm(mass_kg: float) -> Model:
    """A fork whose steered link points forward and turns about the y axis: gravity lowers it."""
    fork = a_fork(effort=20.0)
    steering = msgspec.structs.replace(fork.joints[STEERING], axis=(0.0, 1.0, 0.0))
    arm = Inertial(mass_kg, (ARM_M, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    link = msgspec.structs.replace(fork.links[STEERING + 1], inertial=arm)
    return msgspec.structs.replace(
        fork, links=(*fork.links[: STEERING + 1], link), joints=(*fork.joints[:STEERING], steering)
    )


def a_weak_cart() -> Model:
    """A cart whose wheels cannot slip: friction holds three times the torque of its motors."""
    cart = a_cart()
    assert cart.drive is not None
    return msgspec.structs.replace(
        cart, drive=msgspec.structs.replace(cart.drive, max_torque_nm=TORQUE_NM)
    )


@pytest.mark.parametrize("angle", [0.0, 0.5, -2.5])
def test_motor_that_holds_an_arm_exerts_its_moment(engine: Engine, angle: float) -> None:
    """The moment of gravity is m g l cos(angle) about +y, and the motor exerts the opposite."""
    arms = [engine.add(a_held_arm(mass), a_state((x, 0.0, 0.0))) for mass, x in ((1.0, 0), (2, 9))]
    engine.command(arms, np.array([0.0, angle] * 2))
    advance(engine, 480)

    efforts = engine.read_joint_efforts(arms)

    moment = GRAVITY * ARM_M * math.cos(angle)
    assert efforts[[STEERING, 4 + STEERING]] == pytest.approx([-moment, -2.0 * moment], rel=0.01)
    assert efforts[[0, 1, 2, 4, 5, 6]] == pytest.approx(np.zeros(6), abs=1e-3)
    assert engine.read_joint_efforts(arms[1:]) == pytest.approx(efforts[4:])


def test_wheels_that_push_against_a_wall_exert_their_limit(engine: Engine) -> None:
    engine.add(a_box(side_m=0.4, is_static=True), a_state((0.5, 0.0, 0.2)))
    cart = engine.add(a_weak_cart(), on_ground())
    engine.command((cart,), np.array([10.0, 10.0]))
    advance(engine, 480)

    pushing = engine.read_joint_efforts((cart,))
    engine.command((cart,), np.array([-10.0, -10.0]))
    advance(engine, 2)
    backing = engine.read_joint_efforts((cart,))

    assert pushing == pytest.approx([TORQUE_NM] * 2, rel=0.01)
    assert backing == pytest.approx([-TORQUE_NM] * 2, rel=0.01)


def test_wheels_at_their_speed_exert_little(engine: Engine) -> None:
    cart = engine.add(a_cart(), on_ground())
    engine.command((cart,), np.array([5.0, 5.0]))
    advance(engine, 480)

    efforts = np.array([(engine.step(), engine.read_joint_efforts((cart,)))[1] for _ in range(60)])

    assert engine.read((cart,)).joint_velocities == pytest.approx([5.0, 5.0], rel=0.01)
    if engine.tier_of(cart) == "full":
        assert efforts.mean(axis=0) == pytest.approx([0.0, 0.0], abs=0.02)


def test_friction_of_a_joint_without_a_motor_is_its_effort(engine: Engine) -> None:
    arm = engine.add(an_arm("continuous", friction=5.0), a_state())
    advance(engine, 240)

    assert engine.read_joint_efforts((arm,)) == pytest.approx([-GRAVITY * ARM_M], rel=0.01)


def test_spring_of_a_joint_is_its_effort(engine: Engine) -> None:
    arm = an_arm("revolute", damping=0.5)
    joint = msgspec.structs.replace(arm.joints[0], spring_stiffness=8.0)
    body = engine.add(msgspec.structs.replace(arm, joints=(joint,)), a_state())
    advance(engine, 960)

    angle = float(engine.read((body,)).joint_positions[0])

    assert 0.1 < angle < 0.4
    assert engine.read_joint_efforts((body,)) == pytest.approx([-8.0 * angle], rel=0.02)
    assert 8.0 * angle == pytest.approx(GRAVITY * ARM_M * math.cos(angle), rel=0.02)


def test_bodies_without_joints_have_no_efforts(engine: Engine) -> None:
    box = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
    engine.step()

    assert engine.read_joint_efforts((box,)).shape == (0,)
    assert engine.read_joint_efforts(()).shape == (0,)


def test_new_body_does_not_disturb_the_efforts_of_others(engine: Engine) -> None:
    arm = engine.add(a_held_arm(1.0), a_state())
    advance(engine, 240)
    engine.add(a_cart(), on_ground(5.0))
    engine.step()

    efforts = engine.read_joint_efforts((arm,))

    assert efforts[STEERING] == pytest.approx(-GRAVITY * ARM_M, rel=0.02)


def test_engine_that_fails_to_read_efforts_sets_that_body_aside_only() -> None:
    with running(lambda one: IsolatingEngine(FaultyEngine(PyBulletEngine(one)))) as engine:
        culprit = engine.add(make_culprit(a_cart(), "read_joint_efforts"), on_ground())
        arm = engine.add(a_held_arm(1.0), a_state((5.0, 0.0, 0.0)))
        engine.command((arm,), np.zeros(2))
        advance(engine, 240)

        for _ in range(2):
            efforts = engine.read_joint_efforts((culprit, arm))
            assert np.isnan(efforts[:2]).all()
            assert efforts[2 + STEERING] == pytest.approx(-GRAVITY * ARM_M, rel=0.01)
        assert list(engine.take_faults()) == [culprit]


def test_brake_of_a_sleeping_robot_keeps_its_effort() -> None:
    """On a slope of 2 m/s^2 the ground pushes back by m a, so each wheel bears m a r / 2."""
    slope = EngineConfig(STEP_NS, gravity=(2.0, 0.0, -GRAVITY))
    with running(lambda one: SleepingEngine(PyBulletEngine(one), one), slope) as engine:
        cart = engine.add(a_cart(), on_ground())
        advance(engine, 720)
        assert isinstance(engine, SleepingEngine)
        assert engine.asleep == (cart,)

        efforts = engine.read_joint_efforts((cart,))

    assert efforts == pytest.approx([-2.4 * 2.0 * 0.05 / 2.0] * 2, rel=0.1)


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine])
def test_efforts_of_kinematic_robots_are_unknown(make: MakeEngine) -> None:
    config = EngineConfig(STEP_NS)
    with running(lambda one: TieredEngine(make(one), one, "kinematic"), config) as engine:
        robot = engine.add(a_box_bot(), box_bot_at())
        arm = engine.add(a_held_arm(1.0), a_state((3.0, 0.0, 0.0)))
        engine.command((arm,), np.zeros(2))
        advance(engine, 240)
        joints = len(a_box_bot().joints)

        efforts = engine.read_joint_efforts((arm, robot))

        assert engine.tier_of(robot) == "kinematic"
        assert efforts[STEERING] == pytest.approx(-GRAVITY * ARM_M, rel=0.01)
        assert len(efforts) == 4 + joints
        assert np.isnan(efforts[4:]).all()
