"""Bullet's numbers of parts: each joint and link of a model is the one of its name."""

import random
from collections.abc import Iterator

import msgspec
import numpy as np
import pybullet
import pytest

from tests.engines import STEP_NS, advance
from tests.models import WHEEL_RADIUS_M, a_box, a_cart, a_state, on_ground
from tests.sim_server.physics.bullet_probe import client_of, dynamics_of, link_numbers, unique_id_of
from zensim.proto.forward_kinematics import compute_link_poses
from zensim.proto.messages.model_messages import Inertial, Joint, Link, Mimic, Model, Origin, Shape
from zensim.proto.rigid_transforms import from_rpy
from zensim.sim_server.physics.blueprint import make_blueprint, order_depth_first
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig

SEEDS = range(12)


def a_ball(friction: float) -> Shape:
    return Shape("sphere", (0.02, 0.0, 0.0), friction=friction)


def a_tree(seed: int, *, is_static: bool = True) -> Model:
    """A random tree of links with one to three surfaces; the mass [kg] of link i is i + 1."""
    dice = random.Random(seed)
    count = dice.randrange(3, 12)
    links = tuple(
        Link(
            f"l{i}",
            Inertial(i + 1.0, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1)),
            tuple(a_ball(0.1 * (i + 1) + 0.01 * k) for k in range(dice.randrange(1, 4))),
        )
        for i in range(count)
    )
    joints = tuple(
        Joint(
            f"j{i}",
            dice.choice(("continuous", "prismatic")),
            f"l{dice.randrange(i)}",
            f"l{i}",
            Origin((dice.uniform(-1, 1), dice.uniform(-1, 1), 0.5), from_rpy(dice.random(), 0, 1)),
            axis=(0.0, 0.6, 0.8),
            lower=-9.0,
            upper=9.0,
        )
        for i in range(1, count)
    )
    return Model("tree", links, joints, is_static=is_static)


@pytest.fixture
def engine() -> Iterator[PyBulletEngine]:
    made = PyBulletEngine(EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False))
    yield made
    made.close()


@pytest.mark.parametrize("seed", SEEDS)
def test_joint_moves_the_link_of_its_name(engine: PyBulletEngine, seed: int) -> None:
    model = a_tree(seed)
    body = engine.add(model, a_state())
    positions = np.linspace(-0.9, 0.8, len(model.joints))
    engine.set_at_rest(body, a_state(), positions)

    poses = compute_link_poses(model, a_state()[None, :7], positions[None])
    parts = dynamics_of(engine, body)
    for link, number in list(enumerate(link_numbers(engine, body)))[1:]:
        state = pybullet.getLinkState(
            unique_id_of(engine, body),
            number,
            computeForwardKinematics=1,
            physicsClientId=client_of(engine),
        )
        assert state[4] == pytest.approx(poses[f"l{link}"][0, :3], abs=1e-6)
        assert parts[number + 1].mass_kg == link + 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_effort_turns_the_joint_of_its_name(engine: PyBulletEngine, seed: int) -> None:
    model = a_tree(seed)
    for joint in range(len(model.joints)):
        body = engine.add(model, a_state())
        engine.apply_joint_effort(body, joint, 1.0)
        engine.step()
        # The inverse of the mass matrix is positive definite: the pushed joint yields.
        assert engine.read([body]).joint_velocities[joint] > 1e-6
        engine.remove(body)
        engine.forget_removed()


@pytest.mark.parametrize("seed", SEEDS)
def test_surfaces_have_the_friction_of_their_link(engine: PyBulletEngine, seed: int) -> None:
    model = a_tree(seed)
    body = engine.add(model, a_state())

    parts = order_depth_first(make_blueprint(model)).parts

    found = [part.friction for part in dynamics_of(engine, body)]
    assert found == pytest.approx([min(1.0, part.friction) for part in parts])


@pytest.mark.parametrize("seed", SEEDS)
def test_wrench_turns_the_link_that_is_named(engine: PyBulletEngine, seed: int) -> None:
    model = a_tree(seed)
    joints = tuple(
        msgspec.structs.replace(joint, kind="continuous", parent="l0", origin=Origin())
        for joint in model.joints
    )
    body = engine.add(msgspec.structs.replace(model, joints=joints), a_state())
    pushed = len(joints) // 2 + 1

    engine.apply_link_wrench(body, pushed, np.array([0.0, 0.0, 0.0, 0.0, 0.6, 0.8]))
    engine.step()

    speeds = engine.read([body]).joint_velocities
    assert np.flatnonzero(np.abs(speeds) > 1e-9).tolist() == [pushed - 1]


def test_parts_are_ordered_depth_first() -> None:
    found = order_depth_first(make_blueprint(a_tree(3)))

    for number, part in enumerate(found.parts):
        assert part.parent < number
        if part.parent >= 0:
            between = found.parts[part.parent + 1 : number]
            assert all(other.parent >= part.parent for other in between)


def test_mimic_joint_follows_its_leader_beside_links_with_surfaces(engine: PyBulletEngine) -> None:
    two = (a_ball(1.0), a_ball(0.0))
    links = tuple(
        Link(name, Inertial(1.0, inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01)), two) for name in "abcd"
    )
    joints = (
        Joint("ab", "continuous", "a", "b", Origin((1.0, 0.0, 0.0)), mimic=Mimic("ad", -2.0)),
        Joint("bc", "fixed", "b", "c", Origin((1.0, 0.0, 0.0))),
        Joint("ad", "continuous", "a", "d", Origin((0.0, 3.0, 0.0))),
    )
    body = engine.add(Model("m", links, joints, is_static=True), a_state())

    engine.apply_joint_effort(body, 2, 1.0)
    advance(engine, 60)

    follower, _, leader = engine.read([body]).joint_positions.tolist()
    assert abs(leader) > 0.01
    assert follower == pytest.approx(-2.0 * leader, abs=0.02 * abs(leader))


def test_cart_with_two_surfaces_on_a_wheel_drives_as_commanded() -> None:
    cart = a_cart()
    wheel = cart.links[1]
    rib = Shape("sphere", (0.02, 0.0, 0.0), friction=0.3)
    ribbed = msgspec.structs.replace(wheel, collisions=(*wheel.collisions, rib))
    model = msgspec.structs.replace(cart, links=(cart.links[0], ribbed, cart.links[2]))
    engine = PyBulletEngine(EngineConfig(STEP_NS))
    body = engine.add(model, on_ground())

    engine.command([body], np.array([4.0, 4.0]))
    advance(engine, 480)
    engine.command([body], np.array([-1.0, 1.0]))
    base, positions = engine.read([body]).base[0], engine.read([body]).joint_positions
    engine.close()

    assert base[0] == pytest.approx(4.0 * WHEEL_RADIUS_M * 2.0, rel=0.02)
    assert positions == pytest.approx([8.0, 8.0], rel=0.02)


def test_body_of_another_drive_is_not_reused() -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS))
    engine.remove(engine.add(a_cart(), on_ground()))
    without = msgspec.structs.replace(a_cart(), drive=None)

    inertia = dynamics_of(engine, engine.add(without, on_ground()))[1].inertia
    engine.remove(engine.add(a_box(), a_state((3.0, 0.0, 0.1))))
    engine.close()

    assert inertia == pytest.approx((2.5e-4,) * 3)
