"""Where a link is and how it moves, against Bullet's own account."""

import numpy as np
import pybullet
import pytest

from tests.engines import STEP_NS
from tests.models import a_body, a_state, angle_between
from tests.sim_server.physics.bullet import client_of
from zensim.proto.messages.model_messages import Frame, Joint, Link, Model, Origin
from zensim.robot_agent.kinematics import Chain
from zensim.robot_agent.reading import Reading
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
READING = Reading(0, tuple(ROOT.tolist()), POSITIONS, VELOCITIES)


@pytest.mark.parametrize(("link", "name"), [(0, "turret"), (1, "slide"), (2, "foot"), (3, "hook")])
def test_link_is_where_bullet_has_it_and_moves_so(link: int, name: str) -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False))
    body, client = engine.add(CRANE, ROOT), client_of(engine)
    for joint, (position, velocity) in enumerate(zip(POSITIONS, VELOCITIES, strict=True)):
        pybullet.resetJointState(body, joint, position, velocity, physicsClientId=client)
    state = pybullet.getLinkState(
        body, link, computeLinkVelocity=1, computeForwardKinematics=1, physicsClientId=client
    )
    engine.close()

    found = Chain(CRANE, name).motion(READING)

    assert found.position == pytest.approx(state[4], abs=1e-6)
    assert angle_between(np.array(found.orientation), np.array(state[5])) < 1e-3
    assert found.linear == pytest.approx(state[6], abs=1e-5)
    assert found.angular == pytest.approx(state[7], abs=1e-5)


def test_merged_link_goes_with_the_link_that_holds_it() -> None:
    hook, tip = (Chain(CRANE, name).motion(READING) for name in ("hook", "tip"))

    away = np.array(tip.position) - np.array(hook.position)
    assert float(np.linalg.norm(away)) == pytest.approx(np.linalg.norm(TILTED.position))
    assert tip.angular == hook.angular
    assert np.array(tip.linear) - np.array(hook.linear) == pytest.approx(
        np.cross(hook.angular, away)
    )


@pytest.mark.parametrize("name", ["base", "nothing"])
def test_root_link_is_where_it_is(name: str) -> None:
    found = Chain(CRANE, name).motion(READING)

    assert (*found.position, *found.orientation) == pytest.approx(ROOT[:7])
    assert (*found.linear, *found.angular) == pytest.approx(ROOT[7:])
