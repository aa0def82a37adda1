"""Motion of links by their joints."""

import numpy as np
import pybullet
import pytest

from tests.engines import STEP_NS
from tests.models import a_body, a_state, angle_between
from tests.sim_server.physics.bullet_probe import client_of, unique_id_of
from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.model_messages import Frame, Joint, Link, Model, Origin
from zensim.robot_agent.link_motion import LinkState, find_link_chain
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig

TILTED = Origin((0.3, -0.1, 0.2), (0.5, 0.5, -0.5, 0.5))
CRANE = Model(
    "crane",
    tuple(Link(name, a_body()) for name in ("base", "turret", "slide", "foot", "hook")),
    (
        Joint("turn", "revolute", "base", "turret", TILTED, (0.0, 0.0, 1.0), -3.0, 3.0),
        Joint("reach", "prismatic", "turret", "slide", TILTED, (1.0, 0.0, 0.0), -3.0, 3.0),
        Joint("bolt", "fixed", "slide", "foot", TILTED),
        Joint("swing", "continuous", "foot", "hook", TILTED, (0.6, 0.8, 0.0)),
    ),
    (Frame("tip", "hook", TILTED),),
)
ROOT = a_state((1.0, 2.0, 3.0), turn=(0.3, 0.2, 0.1), linear=(1.0, 0.5, 0.2), angular=(0.3, 2, 1))
POSITIONS = (0.4, -0.3, 0.0, 1.2)
VELOCITIES = (0.7, 0.5, 0.0, -0.9)


def find_motion(name: str) -> LinkState[float]:
    chain = find_link_chain(CRANE, name)
    return chain.motion(ROOT.tolist(), POSITIONS, VELOCITIES, FLOAT_MATH)


@pytest.mark.parametrize(("link", "name"), [(0, "turret"), (1, "slide"), (2, "foot"), (3, "hook")])
def test_link_is_where_bullet_has_it_and_moves_so(link: int, name: str) -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False))
    body, client = unique_id_of(engine, engine.add(CRANE, ROOT)), client_of(engine)
    for joint, (position, velocity) in enumerate(zip(POSITIONS, VELOCITIES, strict=True)):
        pybullet.resetJointState(body, joint, position, velocity, physicsClientId=client)
    state = pybullet.getLinkState(
        body, link, computeLinkVelocity=1, computeForwardKinematics=1, physicsClientId=client
    )
    engine.close()

    found = find_motion(name)

    assert found.position == pytest.approx(state[4], abs=1e-6)
    assert angle_between(np.array(found.orientation), np.array(state[5])) < 1e-3
    assert found.linear == pytest.approx(state[6], abs=1e-5)
    assert found.angular == pytest.approx(state[7], abs=1e-5)


def test_merged_link_moves_with_its_parent() -> None:
    hook, tip = (find_motion(name) for name in ("hook", "tip"))

    away = np.array(tip.position) - np.array(hook.position)
    assert float(np.linalg.norm(away)) == pytest.approx(np.linalg.norm(TILTED.position))
    assert tip.angular == hook.angular
    assert np.array(tip.linear) - np.array(hook.linear) == pytest.approx(
        np.cross(hook.angular, away)
    )


@pytest.mark.parametrize("name", ["base", "nothing"])
def test_root_link_has_its_own_pose(name: str) -> None:
    found = find_motion(name)

    assert (*found.position, *found.orientation) == pytest.approx(ROOT[:7])
    assert (*found.linear, *found.angular) == pytest.approx(ROOT[7:])


@pytest.mark.parametrize("name", ["base", "turret", "slide", "hook", "tip"])
def test_motion_of_many_links_in_arrays_is_that_of_each(name: str) -> None:
    base = np.stack([ROOT, ROOT[::-1], np.roll(ROOT, 3)])
    positions, velocities = np.random.default_rng(1).normal(size=(2, 3, 4))
    chain = find_link_chain(CRANE, name)

    found = chain.motion(tuple(base.T), tuple(positions.T), tuple(velocities.T), ARRAY_MATH)

    for row in range(3):
        one = chain.motion(
            base[row].tolist(), positions[row].tolist(), velocities[row].tolist(), FLOAT_MATH
        )
        assert [column[row] for column in found.position] == pytest.approx(one.position)
        assert [column[row] for column in found.orientation] == pytest.approx(one.orientation)
        assert [column[row] for column in found.linear] == pytest.approx(one.linear)
        assert [column[row] for column in found.angular] == pytest.approx(one.angular)


def test_chain_may_end_at_a_pose_in_the_link() -> None:
    hook, tip = find_link_chain(CRANE, "hook"), find_link_chain(CRANE, "tip")

    assert hook.extend(TILTED) == tip
