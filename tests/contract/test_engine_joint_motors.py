"""Contract of motors of controlled joints: free, position, velocity, effort."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import REAL_ENGINES, STEP_NS, advance, running
from tests.models import a_box, a_cart, a_controlled_arm, a_state, on_ground
from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import Link, Model, Origin
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine

FREE, POSITION, VELOCITY, EFFORT = JointTargetKind
MOMENT_NM = 1.0 * 9.81 * 0.2
"""Of gravity about the joint of `a_controlled_arm` at 0."""
STEPS_S = 240


@pytest.fixture(params=REAL_ENGINES, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def command(engine: Engine, body: int, kind: JointTargetKind, number: float = 0.0) -> None:
    engine.command((body,), np.array([float(kind), number]))


def angle_of(engine: Engine, body: int) -> float:
    return float(engine.read((body,)).joint_positions[0])


def speed_of(engine: Engine, body: int) -> float:
    return float(engine.read((body,)).joint_velocities[0])


def test_joint_is_free_until_its_first_command(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(), a_state((0.0, 0.0, 0.0)))

    advance(engine, STEPS_S)

    assert angle_of(engine, arm) == pytest.approx(0.5, abs=0.02)


def test_position_is_reached_and_held_against_gravity(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(), a_state((0.0, 0.0, 0.0)))
    command(engine, arm, POSITION, -0.3)

    advance(engine, 2 * STEPS_S)

    assert angle_of(engine, arm) == pytest.approx(-0.3, abs=0.005)
    held_nm = -MOMENT_NM * np.cos(-0.3)
    assert engine.read_joint_efforts((arm,)) == pytest.approx([held_nm], rel=0.02)


def test_position_is_approached_at_the_greatest_velocity(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(velocity=0.5), a_state((0.0, 0.0, 0.0)))
    command(engine, arm, POSITION, -0.4)

    advance(engine, STEPS_S // 4)

    assert speed_of(engine, arm) == pytest.approx(-0.5, rel=0.02)
    assert angle_of(engine, arm) == pytest.approx(-0.125, abs=0.01)


def test_velocity_is_kept_against_gravity(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(), a_state((0.0, 0.0, 0.0)))
    command(engine, arm, VELOCITY, -0.4)

    advance(engine, STEPS_S // 2)

    assert speed_of(engine, arm) == pytest.approx(-0.4, rel=0.02)


def test_motor_is_no_stronger_than_its_effort(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(effort=0.5), a_state((0.0, 0.0, 0.0)))
    command(engine, arm, POSITION, -0.4)

    advance(engine, STEPS_S)

    assert angle_of(engine, arm) == pytest.approx(0.5, abs=0.02)


def test_effort_that_balances_gravity_keeps_the_joint(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(), a_state((0.0, 0.0, 0.0)))
    command(engine, arm, EFFORT, -MOMENT_NM)

    advance(engine, STEPS_S // 2)

    assert angle_of(engine, arm) == pytest.approx(0.0, abs=0.01)
    assert engine.read_joint_efforts((arm,)) == pytest.approx([-MOMENT_NM], rel=0.01)


def test_effort_is_limited(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(effort=MOMENT_NM), a_state((0.0, 0.0, 0.0)))
    command(engine, arm, EFFORT, -100.0)

    advance(engine, STEPS_S // 2)

    assert angle_of(engine, arm) == pytest.approx(0.0, abs=0.01)


def test_kinds_may_follow_each_other_and_free_lets_go(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(), a_state((0.0, 0.0, 0.0)))
    for kind, number in ((POSITION, -0.4), (EFFORT, -MOMENT_NM), (VELOCITY, 0.3)):
        command(engine, arm, kind, number)
        advance(engine, STEPS_S)
    assert angle_of(engine, arm) > -0.25

    command(engine, arm, FREE)
    advance(engine, STEPS_S)

    assert angle_of(engine, arm) == pytest.approx(0.5, abs=0.02)
    assert engine.read_joint_efforts((arm,)) == pytest.approx([0.0], abs=0.01)


def test_rest_frees_the_joint(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(), a_state((0.0, 0.0, 0.0)))
    command(engine, arm, EFFORT, -5.0)
    advance(engine, 10)

    engine.set_at_rest(arm, a_state((0.0, 0.0, 0.0)))
    advance(engine, STEPS_S)

    assert angle_of(engine, arm) == pytest.approx(0.5, abs=0.02)


def test_position_holds_while_other_bodies_come_and_go(engine: Engine) -> None:
    arm = engine.add(a_controlled_arm(), a_state((0.0, 0.0, 0.0)))
    command(engine, arm, POSITION, -0.3)
    advance(engine, STEPS_S)

    others = [engine.add(a_box(), a_state((5.0 + x, 0.0, 0.5))) for x in range(4)]
    advance(engine, STEPS_S // 2)
    engine.remove(others[1])
    advance(engine, STEPS_S // 2)

    assert angle_of(engine, arm) == pytest.approx(-0.3, abs=0.005)


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine], ids=lambda make: make.name)
def test_state_that_is_restored_keeps_its_motors(make: type[Engine]) -> None:
    from zensim.api.world_snapshots import SnapshotPlace, read_snapshot, write_snapshot  # noqa: PLC0415

    with running(make) as engine:
        arm = engine.add(a_controlled_arm(), a_state((0.0, 0.0, 0.0)))
        command(engine, arm, EFFORT, -MOMENT_NM)
        advance(engine, 20)
        saved = write_snapshot(SnapshotPlace(engine.name, {}, ""), engine)
        command(engine, arm, FREE)
        advance(engine, 20)
        other = read_snapshot(SnapshotPlace(engine.name, {}, ""), saved)
        assert isinstance(other, Engine)
        other.resume()
        advance(other, STEPS_S // 2)

        assert angle_of(other, arm) == pytest.approx(0.0, abs=0.01)


def a_cart_with_a_mast() -> Model:
    """A cart that the kinematic tier can drive, with a turning mast."""
    cart, arm = a_cart(), a_controlled_arm()
    mast = msgspec.structs.replace(
        arm.joints[0], parent="base", origin=Origin((0.0, 0.0, 0.1)), axis=(0.0, 0.0, 1.0)
    )
    return msgspec.structs.replace(
        cart,
        links=(*cart.links, Link("arm", arm.links[1].inertial)),
        joints=(*cart.joints, mast),
        joint_controllers=arm.joint_controllers,
        dynamics="kinematic",
    )


@pytest.mark.parametrize(
    ("kind", "number", "angle", "speed"),
    [
        (POSITION, 0.3, 0.3, 0.0),
        (POSITION, 9.0, 0.5, 0.0),
        (VELOCITY, 0.2, 0.2, 0.2),
        (EFFORT, 5.0, 0.0, 0.0),
        (FREE, 0.0, 0.0, 0.0),
    ],
)
def test_kinematic_robot_moves_its_joints_as_commanded(
    kind: JointTargetKind, number: float, angle: float, speed: float
) -> None:
    config = EngineConfig(STEP_NS)
    engine = TieredEngine(PyBulletEngine(config), config, "kinematic")
    robot = engine.add(a_cart_with_a_mast(), on_ground())
    engine.command((robot,), np.array([1.0, 1.0, float(kind), number]))

    advance(engine, STEPS_S)

    found = engine.read((robot,))
    assert engine.tier_of(robot) == "kinematic"
    assert found.joint_positions[2] == pytest.approx(angle, abs=1e-3)
    assert found.joint_velocities[2] == pytest.approx(speed, abs=1e-6)
    assert found.base[0, 0] > 0.04
    engine.close()


@pytest.mark.parametrize("period", [1, 3])
def test_kinematic_joint_has_the_speed_of_its_targets_between_commands(period: int) -> None:
    config = EngineConfig(STEP_NS)
    engine = TieredEngine(PyBulletEngine(config), config, "kinematic", period)
    robot = engine.add(a_cart_with_a_mast(), on_ground())
    speed = 0.2
    for number in range(1, 6):
        target = speed * number * period * STEP_NS * 1e-9
        engine.command((robot,), np.array([1.0, 1.0, float(POSITION), target]))
        for step in range(1, period + 1):
            engine.step()
            found = engine.read((robot,))
            passed = (number - 1) * period + step
            assert found.joint_velocities[2] == pytest.approx(speed)
            assert found.joint_positions[2] == pytest.approx(speed * passed * STEP_NS * 1e-9)
    engine.step()
    assert engine.read((robot,)).joint_velocities[2] == pytest.approx(0.0, abs=1e-6)
    engine.close()


def test_kinematic_joint_that_was_set_reaches_its_old_target() -> None:
    config = EngineConfig(STEP_NS)
    engine = TieredEngine(PyBulletEngine(config), config, "kinematic", 3)
    robot = engine.add(a_cart_with_a_mast(), on_ground())
    engine.command((robot,), np.array([0.0, 0.0, float(POSITION), 1e-4]))
    advance(engine, 24)
    engine.set_state(robot, on_ground(), np.array([0.0, 0.0, 0.3]), np.zeros(3))
    advance(engine, STEPS_S)

    assert engine.read((robot,)).joint_positions[2] == pytest.approx(1e-4)
    engine.close()
