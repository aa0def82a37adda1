"""Efforts of motors and couplings: which joints, within which limits, by which equations."""

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.contract.test_engine_chains import a_long_arm, a_mast, find_loads, hold
from tests.engines import STEP_NS, advance
from tests.models import a_box_bot, a_cart, a_state, box_bot_at
from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import Joint, Link, Mimic, Model
from zensim.sim_server.physics.actuation import JointMotor
from zensim.sim_server.physics.bullet.joint_servos import (
    find_couplings,
    limit_efforts,
    make_free_mass,
    make_servo_targets,
)
from zensim.sim_server.physics.bullet.pybullet_engine import MAX_REMOVED_MODELS, PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig

POSITION = float(JointTargetKind.POSITION)
MASS = np.array([[2.0, 1.0], [1.0, 1.0]])


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    made = PyBulletEngine(EngineConfig(STEP_NS))
    yield made
    made.close()


def a_joint(name: str, mimic: Mimic | None = None) -> Joint:
    return Joint(name, "revolute", "base", name, mimic=mimic)


def two_motors(effort: float) -> list[JointMotor]:
    return [JointMotor(i, 2 * i, effort, 1.0, 0.0) for i in range(2)]


def test_joints_that_nothing_controls_have_no_servos() -> None:
    moving = [(0, a_joint("a")), (1, a_joint("b"))]

    assert find_couplings(moving, (), ()) is None


def test_chain_of_followers_has_the_product_of_its_multipliers() -> None:
    moving = [
        (3, a_joint("c", Mimic("b", 2.0, 0.5))),
        (5, a_joint("a")),
        (8, a_joint("b", Mimic("a", -3.0, 0.1))),
    ]

    found = find_couplings(moving, [JointMotor(5, 0, 1.0, 1.0, 0.0)], ())

    assert found is not None
    assert found.joints == (3, 5, 8)
    assert found.ratios.tolist() == [[-6.0], [1.0], [-3.0]]
    assert dict(zip(found.followers.tolist(), found.offsets.tolist(), strict=True)) == (
        pytest.approx({0: 0.7, 2: 0.1})
    )


def test_wheels_of_the_drive_and_their_followers_are_left_to_the_solver() -> None:
    moving = [(0, a_joint("wheel")), (1, a_joint("rear", Mimic("wheel"))), (2, a_joint("lift"))]

    found = find_couplings(moving, [JointMotor(2, 0, 1.0, 1.0, 0.0)], (0,))

    assert found is not None
    assert found.applied_joints == [2]


def test_motor_at_its_limit_moves_as_its_limit_lets_it() -> None:
    targets = make_servo_targets(two_motors(10.0), [POSITION, 0.0] * 2, 0.01)

    efforts, change = limit_efforts(MASS, np.array([30.0, 5.0]), targets)

    assert efforts[0] == pytest.approx(9.99)
    assert abs(efforts[1]) <= 9.99
    assert MASS @ change == pytest.approx(efforts - [30.0, 5.0])


def test_efforts_within_limits_stay() -> None:
    targets = make_servo_targets(two_motors(10.0), [POSITION, 0.0] * 2, 0.01)

    efforts, change = limit_efforts(MASS, np.array([-3.0, 5.0]), targets)

    assert efforts.tolist() == [-3.0, 5.0]
    assert not change.any()


def test_free_joint_exerts_nothing_beside_a_held_one() -> None:
    targets = make_servo_targets(two_motors(10.0), [POSITION, 0.0, 0.0, 0.0], 0.01)

    efforts, change = limit_efforts(MASS, np.array([3.0, 5.0]), targets)

    assert efforts[1] == pytest.approx(0.0)
    assert change == pytest.approx([0.0, -5.0])


def test_free_root_takes_its_share_of_the_mass() -> None:
    """Two masses that a joint pushes apart have the reduced mass."""
    matrix = np.diag([1.0, 1.0, 1.0, 7.0, 7.0, 7.0, 3.0])
    matrix[3, 6] = matrix[6, 3] = 3.0

    assert make_free_mass(matrix) == pytest.approx(np.array([[3.0 * 4.0 / 7.0]]))


def test_each_model_has_its_own_equations_after_many_were_removed(engine: PyBulletEngine) -> None:
    for number in range(MAX_REMOVED_MODELS + 8):
        count, payload = 1 + number % 3, float(number % 5)
        arm = engine.add(a_long_arm(count, payload), a_state((0.0, 0.0, 2.0)))
        hold(engine, arm, [0.0] * count)
        advance(engine, 2)
        efforts = engine.read_joint_efforts((arm,))
        engine.remove(arm)
        engine.forget_removed()

        assert efforts == pytest.approx(find_loads(count, payload), rel=1e-3)


def test_turned_root_turns_gravity(engine: PyBulletEngine) -> None:
    arm = engine.add(a_long_arm(2, 3.0), a_state((0.0, 0.0, 2.0), turn=(0.3, -np.pi / 2.0, 0.7)))
    hold(engine, arm, [0.0, 0.0])

    advance(engine, 24)

    assert engine.read_joint_efforts((arm,)) == pytest.approx([0.0, 0.0], abs=1e-3)
    assert engine.read((arm,)).joint_positions == pytest.approx([0.0, 0.0], abs=1e-6)


def test_links_without_gravity_need_no_effort(engine: PyBulletEngine) -> None:
    arm = a_long_arm(3, 5.0)
    links = tuple(msgspec.structs.replace(one, weightless=one.inertial) for one in arm.links)
    body = engine.add(msgspec.structs.replace(arm, links=links), a_state((0.0, 0.0, 2.0)))
    hold(engine, body, [0.0] * 3)

    advance(engine, 240)

    assert engine.read((body,)).joint_positions == pytest.approx(np.zeros(3), abs=1e-3)
    assert engine.read_joint_efforts((body,)) == pytest.approx(np.zeros(3), abs=0.01)


def test_robots_keep_their_bits_after_an_arm_has_left(engine: PyBulletEngine) -> None:
    arm = engine.add(a_long_arm(2), a_state((9.0, 0.0, 2.0)))
    engine.remove(arm)
    engine.forget_removed()
    alone = PyBulletEngine(EngineConfig(STEP_NS))
    states = []
    for one in (engine, alone):
        robot = one.add(a_box_bot(), box_bot_at())
        one.command((robot,), np.array([5.0, 3.0]))
        advance(one, 240)
        states.append(one.read((robot,)).base.tobytes())
    alone.close()

    assert states[0] == states[1]


def test_rear_wheels_that_mimic_driven_ones_turn_with_them(engine: PyBulletEngine) -> None:
    cart = a_cart()
    rear = tuple(
        msgspec.structs.replace(
            joint,
            name=f"rear_{joint.name}",
            child=f"rear_{joint.child}",
            origin=msgspec.structs.replace(
                joint.origin, position=(-0.3, joint.origin.position[1], 0.0)
            ),
            mimic=Mimic(joint.name),
        )
        for joint in cart.joints
    )
    wheels = tuple(_copy_wheel(cart, one.child) for one in rear)
    model = msgspec.structs.replace(
        cart, links=(*cart.links, *wheels), joints=(*cart.joints, *rear)
    )
    body = engine.add(model, a_state((0.0, 0.0, 0.05)))
    engine.command((body,), np.array([5.0, 5.0]))

    advance(engine, 480)

    right, left, rear_right, rear_left = engine.read((body,)).joint_positions
    assert right > 5.0
    assert (rear_right, rear_left) == pytest.approx((right, left), abs=2e-3)


def _copy_wheel(cart: Model, name: str) -> Link:
    wheel = next(link for link in cart.links if f"rear_{link.name}" == name)
    return msgspec.structs.replace(wheel, name=name)


def test_mast_holds_where_it_was_placed(engine: PyBulletEngine) -> None:
    mast = engine.add(a_mast(1, 20.0), a_state())
    hold(engine, mast, [0.2])

    advance(engine, 480)
    engine.set_at_rest(mast, a_state(), np.array([0.1, 0.1]))
    hold(engine, mast, [0.1])
    advance(engine, 240)

    assert engine.read((mast,)).joint_positions == pytest.approx([0.1, 0.1], abs=2e-3)
