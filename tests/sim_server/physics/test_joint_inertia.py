"""Mobilities of joints, against Bullet's mass matrix."""

import numpy as np
import pybullet
import pytest

from tests.engines import STEP_NS
from tests.models import a_cart, a_state, an_arm
from tests.sim_server.physics.bullet.test_part_numbers import a_tree
from tests.sim_server.physics.bullet_probe import client_of, unique_id_of
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.joint_inertia import find_joint_mobilities


@pytest.mark.parametrize("is_static", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_mobilities_are_those_of_bullets_mass_matrix(seed: int, *, is_static: bool) -> None:
    model = a_tree(seed, is_static=is_static)
    engine = PyBulletEngine(EngineConfig(STEP_NS, has_ground=False))
    body = unique_id_of(engine, engine.add(model, a_state()))
    client = client_of(engine)
    zeros = [0.0] * len(model.joints)
    matrix = np.array(pybullet.calculateMassMatrix(body, zeros, physicsClientId=client))
    expected = np.diag(np.linalg.inv(matrix))[-len(zeros) :]
    names = [
        pybullet.getJointInfo(body, number, physicsClientId=client)[3] >= 0
        for number in range(pybullet.getNumJoints(body, physicsClientId=client))
    ]
    engine.close()

    found = find_joint_mobilities(make_blueprint(model).parts, is_static=is_static)

    assert sum(names) == len(found)
    assert sorted(found.values()) == pytest.approx(sorted(expected.tolist()), rel=1e-6)


def test_mobility_of_a_driven_wheel_counts_its_reflected_inertia() -> None:
    parts = make_blueprint(a_cart()).parts

    found = find_joint_mobilities(parts, is_static=True)

    expected = 1.0 / max(parts[1].inertia[1], parts[1].reflected_inertia)
    assert found == pytest.approx({"right_joint": expected, "left_joint": expected})


def test_prismatic_joint_yields_by_its_mass() -> None:
    found = find_joint_mobilities(make_blueprint(an_arm("prismatic")).parts, is_static=True)

    assert found == pytest.approx({"swing": 1.0})


def test_body_without_moving_joints_has_no_mobilities() -> None:
    assert find_joint_mobilities(make_blueprint(an_arm("fixed")).parts, is_static=False) == {}
