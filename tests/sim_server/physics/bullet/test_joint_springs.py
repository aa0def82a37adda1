"""Springs of joints in Bullet: rest, period, damping, light links, several bodies."""

import math
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import a_box, a_cart, a_state, an_arm
from zensim.proto.messages.model_messages import Inertial, Model
from zensim.sim_server.physics.bullet.joint_springs import find_joint_springs
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig

G = 9.81
DT_S = STEP_NS * 1e-9


@pytest.fixture
def engine() -> Iterator[Engine]:
    made = PyBulletEngine(EngineConfig(STEP_NS))
    yield made
    made.close()


def a_sprung_arm(
    stiffness: float, *, rest: float = 0.0, damping: float = 0.0, mass_kg: float = 1.0
) -> Model:
    """A mass on a vertical spring."""
    model = an_arm("prismatic")
    joint = msgspec.structs.replace(
        model.joints[0],
        lower=-5.0,
        upper=5.0,
        spring_stiffness=stiffness,
        spring_reference=rest,
        damping=damping,
    )
    moment = 0.01 * mass_kg
    hanging = Inertial(mass_kg, inertia=(moment, 0.0, 0.0, moment, 0.0, moment))
    arm = msgspec.structs.replace(model.links[1], inertial=hanging)
    return msgspec.structs.replace(model, links=(model.links[0], arm), joints=(joint,))


def positions_of(engine: Engine, model: Model, steps: int) -> list[float]:
    body = engine.add(model, a_state((0.0, 0.0, 5.0)))
    found = []
    for _ in range(steps):
        engine.step()
        found.append(float(engine.read([body]).joint_positions[0]))
    return found


@pytest.mark.parametrize("mass_kg", [0.001, 0.1, 10.0])
@pytest.mark.parametrize("stiffness", [100.0, 4000.0])
def test_spring_carries_a_mass_at_its_deflection(
    engine: Engine, mass_kg: float, stiffness: float
) -> None:
    damping = 2.0 * math.sqrt(stiffness * mass_kg)
    model = a_sprung_arm(stiffness, rest=0.03, damping=damping, mass_kg=mass_kg)

    found = positions_of(engine, model, 1000)[-1]

    assert found == pytest.approx(0.03 - mass_kg * G / stiffness, rel=1e-3, abs=1e-4)


def test_undamped_spring_swings_with_its_period(engine: Engine) -> None:
    found = np.array(positions_of(engine, a_sprung_arm(40.0), 960))

    middle = -G / 40.0
    crossings = np.flatnonzero((found[:-1] > middle) & (found[1:] <= middle))
    period_s = float(np.diff(crossings).mean()) * DT_S
    assert period_s == pytest.approx(2.0 * math.pi * math.sqrt(1.0 / 40.0), rel=0.03)
    assert np.abs(found).max() < 2.1 * G / 40.0


@pytest.mark.parametrize("stiffness", [1e3, 1e6, 1e9])
def test_spring_of_any_stiffness_holds_a_feather_weight_link(
    engine: Engine, stiffness: float
) -> None:
    found = positions_of(engine, a_sprung_arm(stiffness, rest=0.1, mass_kg=1e-4), 240)

    assert found[-1] == pytest.approx(0.1, abs=1e-3)


def test_springs_of_several_bodies_act_independently(engine: Engine) -> None:
    soft, hard = a_sprung_arm(50.0, damping=15.0), a_sprung_arm(500.0, damping=45.0)
    bodies = [
        engine.add(model, a_state((3.0 * i, 0.0, 5.0)))
        for i, model in enumerate((soft, hard, a_box()))
    ]
    advance(engine, 600)
    engine.remove(bodies[0])
    again = engine.add(soft, a_state((9.0, 0.0, 5.0)))
    advance(engine, 900)

    found = engine.read([again, bodies[1]]).joint_positions

    assert found == pytest.approx([-G / 50.0, -G / 500.0], rel=0.01)


def test_joint_with_an_actuator_has_no_spring() -> None:
    cart = a_cart()
    joints = tuple(msgspec.structs.replace(joint, spring_stiffness=10.0) for joint in cart.joints)
    driven = msgspec.structs.replace(cart, joints=joints)

    assert find_joint_springs(driven, list(enumerate(joints))) is None
    assert find_joint_springs(msgspec.structs.replace(driven, drive=None), list(enumerate(joints)))
